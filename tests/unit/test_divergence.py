"""Losses and states that are no longer finite end a training."""

import pytest
import torch

from pipeline.errors import TrainingDiverged
from pipeline.training.divergence import read_losses, require_finite


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_loss_that_is_not_finite_stops_the_training(value: float) -> None:
    losses = [{"loss": torch.tensor(number)} for number in (1.0, value, 2.0)]
    assert read_losses(losses[:1], 15, "full training") == [{"loss": 1.0}]
    with pytest.raises(TrainingDiverged, match=r"full training became .* at iteration 17; look at the inputs,"):
        read_losses(losses, 17, "full training")


@pytest.mark.parametrize("value", [float("nan"), float("-inf")])
def test_a_state_that_is_not_finite_stops_the_training(value: float) -> None:
    weights, visits = torch.ones(3), torch.ones(3).long()
    require_finite({"model.weights": weights, "visits": visits}, 4, "full training")
    weights[1] = value
    with pytest.raises(TrainingDiverged, match=r"^model.weights is no longer finite after iteration 4 of full"):
        require_finite({"model.weights": weights, "visits": visits}, 4, "full training")
