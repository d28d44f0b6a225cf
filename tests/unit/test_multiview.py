"""Consistency of views: full marks for objects that turn as commanded, chance for views in any order."""

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from pipeline.errors import DataError
from pipeline.evaluation.artifacts import Reconstructions, Snapshot
from pipeline.evaluation.multiview import (
    MultiviewConfig,
    azimuth_figures,
    evaluate_views,
    multiview_figures,
    read_azimuths,
    render_views,
    student_figures,
)
from pipeline.networks.full_model import FullModel
from pipeline.seeding import generator
from tests.tiny_full_model import base_mesh, tiny_extractor, tiny_model

COUNT = 24
CONFIG = MultiviewConfig(objects=COUNT, step=50, elevation=10.0, ridge=0.1, examples=2)


@pytest.fixture(scope="module")
def views() -> Tensor:
    """Show a bright spot that goes round the picture, on objects of different colours."""
    turns = CONFIG.azimuths()
    rows, columns = torch.meshgrid(torch.linspace(-1, 1, 32), torch.linspace(-1, 1, 32), indexing="ij")
    distance = (columns - 0.6 * turns.sin()[:, None, None]) ** 2 + (rows - 0.6 * turns.cos()[:, None, None]) ** 2
    spots = torch.exp(-8 * distance)[None, :, None]
    colors = torch.rand(COUNT, 1, 3, 1, 1, generator=generator(0))
    return (0.6 * colors + 0.4 * spots).clamp(0, 1)


def test_objects_that_turn_as_commanded_get_full_marks(views: Tensor) -> None:
    figures = multiview_figures(views, tiny_extractor(), CONFIG, 50)
    assert figures["acc_pi6"] == 1
    assert figures["error_degrees"]["value"] < 5
    assert figures["identity_drift"]["value"] < 0.2
    stiffer = multiview_figures(views, tiny_extractor(), replace(CONFIG, ridge=10.0), 50)
    assert stiffer["error_degrees"]["value"] > 1.3 * figures["error_degrees"]["value"]
    assert figures["n"] == figures["identity_drift"]["n"] == COUNT
    assert figures["chance"]["identity_drift"]["value"] == pytest.approx(1, abs=0.1)
    assert figures["chance"]["acc_pi6"] == pytest.approx(1 / 6)


def test_views_in_any_order_are_read_no_better_than_chance(views: Tensor) -> None:
    order = torch.rand(views.shape[:2], generator=generator(1)).argsort(dim=1)
    figures = multiview_figures(views[torch.arange(COUNT)[:, None], order], tiny_extractor(), CONFIG, 50)
    assert abs(figures["acc_pi6"] - 1 / 6) < 4 * figures["standard_error"]
    assert figures["error_degrees"]["value"] == pytest.approx(90, abs=20)


def test_objects_that_change_identity_drift(views: Tensor) -> None:
    """The k-th view of an object is the k-th view of the k-th next object."""
    count, turns = views.shape[:2]
    other = (torch.arange(count)[:, None] + torch.arange(turns)) % count
    figures = multiview_figures(views[other, torch.arange(turns)], tiny_extractor(), CONFIG, 50)
    assert figures["identity_drift"]["value"] > 0.8
    assert figures["acc_pi6"] == 1, "each picture still shows its azimuth"


def test_halves_of_the_objects_read_each_other() -> None:
    """A code that only the other half shares cannot be learned: nothing leaks from an object to itself."""
    azimuths = CONFIG.azimuths().expand(COUNT, -1)
    turns = torch.stack([azimuths.sin(), azimuths.cos()], dim=2)
    hidden = torch.zeros(COUNT, azimuths.shape[1], 4)
    hidden[0::2, :, :2], hidden[1::2, :, 2:] = turns[0::2], turns[1::2]
    shared = azimuth_figures(azimuths, read_azimuths(turns, azimuths, 0.1))
    assert shared["acc_pi6"] == 1
    assert azimuth_figures(azimuths, read_azimuths(hidden, azimuths, 0.1))["acc_pi6"] < 0.5


def test_azimuths_are_read_by_ridge_regression() -> None:
    azimuths = CONFIG.azimuths().expand(COUNT, -1)
    features = torch.randn(COUNT, azimuths.shape[1], 6, generator=generator(0)).double()
    known = features[0::2].flatten(0, 1)
    spread, middle = torch.std_mean(known, dim=0)
    known, asked = (known - middle) / spread, (features[1::2].flatten(0, 1) - middle) / spread
    turns = azimuths[0::2].flatten().double()
    targets = torch.stack([turns.sin(), turns.cos()], 1)
    strength = 0.1 * known.square().sum(dim=1).mean()
    moments = known.T @ known + strength * torch.eye(6)
    slopes = torch.linalg.solve(moments, known.T @ (targets - targets.mean(0)))
    sine, cosine = (asked @ slopes + targets.mean(0)).unbind(1)
    read = read_azimuths(features, azimuths, 0.1)[1::2].flatten()
    torch.testing.assert_close(read, torch.atan2(sine, cosine).float())


def test_steps_that_do_not_divide_the_circle_are_read_exactly() -> None:
    azimuths = CONFIG.azimuths().expand(COUNT, -1)
    turns = torch.stack([azimuths.sin(), azimuths.cos()], dim=2)
    assert azimuth_figures(azimuths, read_azimuths(turns, azimuths, 1e-6))["error_degrees"]["value"] < 1e-3


def test_objects_that_are_all_the_same_have_no_drift() -> None:
    one = torch.rand(8, 3, 32, 32, generator=generator(0))
    with pytest.raises(DataError, match="exactly alike"):
        multiview_figures(one.expand(COUNT, -1, -1, -1, -1), tiny_extractor(), CONFIG, 50)


def test_errors_know_that_angles_close_the_circle() -> None:
    azimuths = torch.tensor([[0.0, math.radians(350)]]).expand(2, 2)
    read = torch.tensor([[math.radians(355), math.radians(-15)], [math.pi, math.radians(30)]])
    figures = azimuth_figures(azimuths, read)
    assert (figures["acc_pi6"], figures["n"]) == (0.5, 2)
    assert figures["error_degrees"]["value"] == pytest.approx((5 + 5 + 180 + 40) / 4)


def _reconstructions(model: FullModel) -> Reconstructions:
    pose = model.poses(model.poses.draw(3, generator(0)), model.base_vertices.expand(3, -1, -1))
    mesh, shades = base_mesh(), torch.linspace(0.2, 0.8, 3)[:, None, None, None]
    one = Snapshot(pose, mesh.vertices.expand(3, -1, -1), torch.zeros(3, 3, 32, 32), torch.zeros(3, 3, 32, 32))
    return Reconstructions(one, one, shades.expand(-1, 3, 8, 8), mesh.faces, mesh.directions, torch.arange(3))


def test_views_from_above_show_the_upper_side() -> None:
    model = tiny_model().eval()
    found = _reconstructions(model)
    upper = torch.cat([torch.ones(3, 3, 4, 8), torch.zeros(3, 3, 4, 8)], dim=2)
    above, below = (
        render_views(found._replace(textures=upper), model, replace(CONFIG, elevation=elevation)).mean()
        for elevation in (50.0, -50.0)
    )
    assert above > 2 * below


def _aspect(covered: Tensor) -> float:
    return covered.any(0).sum().item() / covered.any(1).sum().item()


@pytest.mark.parametrize("framing", ["free", "box"])
def test_reconstructions_are_measured_from_all_around(framing: str) -> None:
    model = tiny_model(framing=framing).eval()
    found, config = _reconstructions(model), replace(CONFIG, objects=2)
    views = render_views(found, model, config)
    assert views.shape == (2, 8, 3, 32, 32)
    end, side = ((view.amax(0) > 0) for view in (views[0, 0], views[0, 2]))
    assert _aspect(side) > 1.3 * _aspect(end), "a long body is longer from its side (100 degrees) than from its end"
    figures = evaluate_views(found, model, tiny_extractor(), config, 5)
    assert figures["own_network"]["n"] == figures["n"] == 2


def test_one_object_is_too_few(views: Tensor) -> None:
    with pytest.raises(DataError, match="compares objects"):
        multiview_figures(views[:1], tiny_extractor(), CONFIG, 50)


def test_views_of_changing_objects_drift_as_far_as_chance(views: Tensor) -> None:
    count, turns = views.shape[:2]
    other = (torch.arange(count)[:, None] + torch.arange(turns)) % count
    shown = views, views[other, torch.arange(turns)]
    straight, changing = (multiview_figures(pictures, tiny_extractor(), CONFIG, 50) for pictures in shown)
    expected = straight["chance"]["identity_drift"]["value"]
    assert changing["identity_drift"]["value"] == pytest.approx(expected, rel=0.05)


def test_a_network_in_a_frame_of_its_own_is_right_up_to_one_angle(monkeypatch: pytest.MonkeyPatch) -> None:
    def read(images: Tensor) -> Tensor:
        azimuth = images[:, 0, 0, 0] + 1
        return torch.stack([azimuth.cos(), azimuth.sin()], 1)

    model = tiny_model()
    monkeypatch.setattr(model, "read_poses", read)
    shown = CONFIG.azimuths().expand(5, -1)[..., None, None, None].expand(5, -1, 3, 4, 4)
    assert student_figures(shown, model, CONFIG)["error_degrees"]["value"] < 1
