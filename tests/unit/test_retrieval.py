"""The baseline that retrieves training photographs by their colours."""

import torch

from pipeline.evaluation.retrieval import histograms, retrieve
from pipeline.seeding import generator


def test_histograms_are_shares_of_colours() -> None:
    red_and_white = torch.ones(1, 3, 4, 4)
    red_and_white[:, 1:, :1] = 0
    histogram = histograms(red_and_white)[0]
    assert histogram.shape == (64,)
    assert histogram[48] == 0.25
    assert histogram[63] == 0.75


def test_the_same_colours_elsewhere_are_retrieved() -> None:
    training = torch.rand(5, 3, 8, 8, generator=generator(0)) * torch.linspace(51, 255, 5)[:, None, None, None]
    training = training.to(torch.uint8)
    expected = training[[3, 0]].float() / 255
    torch.testing.assert_close(retrieve(expected.flip(-1), training), expected)
