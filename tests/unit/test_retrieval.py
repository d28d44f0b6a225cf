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


def test_one_large_difference_counts_less_than_many_small_ones_of_a_greater_sum() -> None:
    colours = torch.cartesian_prod(*[torch.tensor([0, 255], dtype=torch.uint8)] * 3)
    wanted, one_colour, all_colours = (
        colours[torch.tensor(pixels)].T[:, None]
        for pixels in (
            [0, 0, 0, 0, 0, 0, 1, 1, 2, 2],
            [0, 3, 3, 3, 3, 3, 1, 1, 2, 2],
            [0, 0, 0, 0, 4, 4, 5, 5, 6, 6],
        )
    )
    found = retrieve(wanted[None].float() / 255, torch.stack([all_colours, one_colour]))
    assert torch.equal(found[0], one_colour.float() / 255)


def test_the_same_colours_elsewhere_are_retrieved() -> None:
    training = torch.rand(5, 3, 8, 8, generator=generator(0)) * torch.linspace(51, 255, 5)[:, None, None, None]
    training = training.to(torch.uint8)
    expected = training[[3, 0]].float() / 255
    torch.testing.assert_close(retrieve(expected.flip(-1), training), expected)
