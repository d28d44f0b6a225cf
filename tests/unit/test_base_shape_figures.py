import math

import pytest
import torch

from pipeline.evaluation.alignment import turn_vertices
from pipeline.evaluation.artifacts import TrueObjects
from pipeline.evaluation.base_shape import base_shape_figures
from pipeline.geometry.icosphere import icosphere
from pipeline.geometry.normalize import fit_unit_cube
from stages.evaluate_base_shape import seed_names

DIRECTIONS, FACES = icosphere(2)
LONG = DIRECTIONS * torch.tensor([0.25, 0.2, 0.5])


def cars(count: int) -> TrueObjects:
    widths = 1 + torch.linspace(-0.1, 0.1, count)[:, None, None] * torch.tensor([1.0, 0, 0])
    return TrueObjects(torch.zeros(count, 4, 4, dtype=torch.bool), LONG * widths, FACES)


def horned() -> TrueObjects:
    """Return balls with a horn ahead: above, below, on the left or on the right, so that no two are in one place."""
    horns = torch.tensor([[0.0, 0.6, 0.8], [0, -0.6, 0.8], [0.6, 0, 0.8], [-0.6, 0, 0.8]])
    lengths = 1 + (DIRECTIONS @ horns.T > 0.9)
    return TrueObjects(torch.zeros(4, 4, 4, dtype=torch.bool), 0.25 * DIRECTIONS * lengths.T[..., None], FACES)


def test_every_seed_is_compared_in_its_best_turn() -> None:
    seeds = torch.stack([DIRECTIONS / 2, turn_vertices(LONG, math.radians(60))])
    figures = base_shape_figures(seeds, FACES, 0, cars(6), cars(4), 16)
    sphere, long = figures["seeds"].values()
    assert long > 0.8 > 0.5 > sphere
    assert figures["voxel_iou"]["value"] == pytest.approx((sphere + long) / 2)
    assert figures["voxel_iou"]["n"] == 2
    assert figures["chosen"]["voxel_iou"]["value"] == pytest.approx(sphere)
    assert figures["chosen"]["voxel_iou"]["n"] == 4


def test_turns_are_of_15_degrees_and_fill_the_unit_cube_again() -> None:
    true = TrueObjects(torch.zeros(1, 4, 4, dtype=torch.bool), LONG[None], FACES)
    seeds = torch.cat([fit_unit_cube(turn_vertices(LONG[None], math.radians(degrees))) for degrees in (45, 105)])
    figures = base_shape_figures(seeds, FACES, 0, true, true, 16)
    assert min(figures["seeds"].values()) > 0.95


def test_shapes_of_the_training_split_alone_tell_the_turn() -> None:
    training, test = cars(6), cars(4)
    across = test._replace(vertices=turn_vertices(test.vertices, math.radians(90)))
    turned = turn_vertices(LONG, math.radians(60))[None]
    assert base_shape_figures(turned, FACES, 0, training, across, 16)["voxel_iou"]["value"] < 0.5


def test_what_few_shapes_have_in_one_place_tells_the_turn_too() -> None:
    true = horned()
    figures = [
        base_shape_figures(turn_vertices(true.vertices, angle), FACES, 0, true, true, 16)["seeds"]
        for angle in (0, math.pi)
    ]
    assert list(figures[1].values()) == pytest.approx(list(figures[0].values()), abs=0.02)


def test_the_seed_that_was_chosen_is_named() -> None:
    assert seed_names(torch.tensor([0.5, 0.25]), 1) == ["seed 0, score 0.50", "seed 1, score 0.25, chosen"]
