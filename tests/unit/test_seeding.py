"""Named streams of random numbers are independent and repeat."""

import numpy as np
import torch
from torch import nn

from pipeline.seeding import generator, initialised, numpy_generator


def _draw(*stream: str | int) -> float:
    seed, *names = stream
    assert isinstance(seed, int)
    return torch.rand((), generator=generator(seed, *names)).item()


def test_streams_differ_by_seed_and_by_every_name() -> None:
    draws = [_draw(0), _draw(1), _draw(0, "light"), _draw(0, "pose"), _draw(0, "pose", 1), _draw(0, "pose", "1")]
    assert len(set(draws)) == len(draws)


def test_a_stream_repeats_on_every_machine() -> None:
    assert generator(7, "viewpoints").initial_seed() == 7372045334059587603
    assert _draw(3, "light") == _draw(3, "light")


def test_numpy_streams_repeat() -> None:
    first, second, other = numpy_generator(0, "a"), numpy_generator(0, "a"), numpy_generator(0, "b")
    drawn = first.random(4)
    assert np.array_equal(drawn, second.random(4))
    assert not np.array_equal(drawn, other.random(4))


def test_initial_weights_repeat_and_the_global_state_is_untouched() -> None:
    before = torch.random.get_rng_state()
    layers = []
    for stream in ("shape", "shape", "texture"):
        with initialised(0, stream):
            layers.append(nn.Linear(3, 3).weight)
    assert torch.equal(layers[0], layers[1])
    assert not torch.equal(layers[0], layers[2])
    assert torch.equal(before, torch.random.get_rng_state())
