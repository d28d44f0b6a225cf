"""Learning rates."""

import pytest
import torch

from pipeline.training.optimization import adam, falling, set_learning_rate


def test_a_rate_falls_to_zero_over_the_cool_down() -> None:
    rates = [falling(0.4, iteration, 10, 0.4) for iteration in range(10)]
    assert rates == pytest.approx([0.4] * 7 + [0.3, 0.2, 0.1])
    assert {falling(0.4, iteration, 10, 0) for iteration in range(10)} == {0.4}


def test_all_parameters_of_all_optimisers_get_the_rate() -> None:
    first, second, third = (torch.nn.Parameter(torch.ones(1)) for _ in range(3))
    optimizers = [torch.optim.SGD([{"params": [first]}, {"params": [second]}], lr=1.0), torch.optim.SGD([third], 1.0)]
    set_learning_rate(0.25, *optimizers)
    for parameter in (first, second, third):
        parameter.sum().backward()
    for optimizer in optimizers:
        optimizer.step()
    assert [parameter.item() for parameter in (first, second, third)] == [0.75] * 3


def test_adam_takes_the_betas_it_is_given() -> None:
    assert adam([torch.nn.Parameter(torch.ones(1))], 0.1, (0.5, 0.99)).defaults["betas"] == (0.5, 0.99)
