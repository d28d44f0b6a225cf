"""The toybox is repeatable, its ground truth is true, and its pictures are not easy."""

import os
import signal
from itertools import product
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
import torch
from jaxtyping import Bool, Float

from pipeline.datasets.prepared import write_images, write_truth
from pipeline.datasets.toybox import aeroplane, car, chair, horse, toybox
from pipeline.datasets.toybox.lighting import Lighting, choose_lighting
from pipeline.datasets.toybox.model import Specimens
from pipeline.datasets.toybox.photograph import PhotographConfig, photograph
from pipeline.datasets.toybox.solids import Solid
from pipeline.datasets.toybox.toybox import CATEGORIES, ToyboxConfig, make_toybox
from pipeline.datasets.toybox.views import ViewRange, choose_poses
from pipeline.datasets.truth import GroundTruth
from pipeline.errors import ConfigError, ProcessKilled, UserError
from pipeline.files import sha256
from pipeline.geometry.camera import CameraConfig, Pose, project
from pipeline.geometry.icosphere import icosphere
from pipeline.rendering.rasterize import rasterize
from pipeline.seeding import generator

CAMERA = CameraConfig(distance=2.7, field_of_view=30)
CONFIG = PhotographConfig(size=32, supersampling=4, camera=CAMERA)


def take(category: str, count: int) -> tuple[np.ndarray, GroundTruth]:
    build, viewpoints, setting = CATEGORIES[category]
    rng = np.random.default_rng(0)
    return photograph(build(count, rng), viewpoints, setting, CONFIG, rng)


def parts_of(faces: np.ndarray, count: int) -> np.ndarray:
    """Return the number of the connected part that each vertex belongs to."""
    label = np.arange(count)
    while True:
        lowest = label[faces].min(axis=1)
        updated = label.copy()
        for corner in range(3):
            np.minimum.at(updated, faces[:, corner], lowest)
        if (updated == label).all():
            return label
        label = updated


@pytest.mark.parametrize("category", CATEGORIES)
def test_parts_are_closed_and_face_outwards(category: str) -> None:
    solid = CATEGORIES[category].build(8, np.random.default_rng(0)).solid
    edges = np.concatenate([solid.faces[:, [0, 1]], solid.faces[:, [1, 2]], solid.faces[:, [2, 0]]])
    assert len({tuple(edge) for edge in edges}) == len(edges)
    assert {tuple(edge) for edge in edges} == {tuple(edge) for edge in edges[:, ::-1]}
    corners = solid.vertices[:, solid.faces]
    volumes = np.linalg.det(corners) / 6
    parts = parts_of(solid.faces, solid.vertices.shape[1])[solid.faces[:, 0]]
    for part in np.unique(parts):
        assert (volumes[:, parts == part].sum(axis=1) > -1e-9).all()


@pytest.mark.parametrize("category", ["aeroplane", "car", "chair"])
def test_made_things_are_symmetric(category: str) -> None:
    vertices = torch.from_numpy(CATEGORIES[category].build(4, np.random.default_rng(0)).solid.vertices)
    to_mirror_image = torch.cdist(vertices, vertices * torch.tensor([-1.0, 1.0, 1.0]))
    assert to_mirror_image.amin(dim=2).max() < 1e-6


@pytest.mark.parametrize(
    ("category", "front", "rear"),
    [
        ("car", car.HEAD_LIGHT, car.TAIL_LIGHT),
        ("chair", chair.SEAT, chair.BACK),
        ("aeroplane", aeroplane.NOSE, aeroplane.FIN),
        ("horse", horse.MUZZLE, horse.COAT),
    ],
)
def test_the_front_faces_positive_z(category: str, front: int, rear: int) -> None:
    solid = CATEGORIES[category].build(16, np.random.default_rng(0)).solid
    depth = solid.vertices[:, solid.faces].mean(axis=2)[..., 2]
    ahead, behind = (depth[:, solid.materials == material].mean(axis=1) for material in (front, rear))
    present = behind != 0  # some chairs have slats instead of a panel; it is then in the origin
    assert present.sum() > 4
    assert (ahead > behind)[present].all()


@pytest.mark.parametrize("category", CATEGORIES)
def test_the_truth_draws_the_masks(category: str) -> None:
    _, truth = take(category, 16)
    pose = Pose(*(torch.from_numpy(getattr(truth, name)) for name in Pose._fields))
    vertices_ndc = project(torch.from_numpy(truth.vertices), pose, CAMERA)
    fragments = rasterize(vertices_ndc, torch.from_numpy(truth.faces), 32 * 8)
    cover = (fragments.face_index >= 0).float().unflatten(2, (32, 8)).unflatten(1, (32, 8)).mean(dim=(2, 4)).numpy()
    certain = np.abs(cover - 0.5) > 0.1
    assert (truth.masks[certain] == (cover[certain] > 0.5)).mean() > 0.995
    assert np.abs(truth.vertices).max() <= 0.5 + 1e-6
    np.testing.assert_allclose(np.ptp(truth.vertices, axis=1).max(axis=1), 1.0, atol=1e-5)


ELEVATIONS = {"car": (0, 30), "chair": (0, 30), "horse": (-10, 10), "aeroplane": (-60, 60)}


@pytest.mark.parametrize("category", CATEGORIES)
def test_viewpoints_follow_the_paper(category: str) -> None:
    cube = torch.rand(512, 8, 3) - 0.5
    pose = choose_poses(CATEGORIES[category].viewpoints, cube, CAMERA, np.random.default_rng(0))
    low, high = ELEVATIONS[category]
    degrees = pose.elevation.rad2deg()
    assert low <= degrees.min() < low + 1
    assert high - 1 < degrees.max() <= high
    sides = pose.azimuth.sin().abs().mean()
    expected = 2 / np.pi if category in ("car", "chair") else 0.75
    assert sides == pytest.approx(expected, abs=0.05)
    assert abs(pose.azimuth.sin().mean()) < 0.1


def test_the_same_seed_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("first", "second"):
        dataset = make_toybox(ToyboxConfig(seed=0, train_count=3, test_count=2, photograph=CONFIG))
        write_images(tmp_path / name / "prepared", dataset.images)
        write_truth(tmp_path / name / "truth", dataset.truth)
    assert sha256(tmp_path / "first") == sha256(tmp_path / "second")


def test_processes_take_the_photographs_that_one_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    config = ToyboxConfig(seed=0, train_count=3, test_count=2, photograph=CONFIG)
    alone = make_toybox(config)
    monkeypatch.setattr(torch, "get_num_threads", lambda: 2)
    monkeypatch.setattr(toybox, "_CHUNKS_WORTH_A_PROCESS", 1)
    with patch.object(toybox, "process_pool", wraps=toybox.process_pool) as pool:
        shared = make_toybox(config)
    pool.assert_called_once()
    for split, category in product(("train", "test"), CATEGORIES):
        np.testing.assert_array_equal(shared.images[split][category], alone.images[split][category])
        ours, theirs = shared.truth[split][category], alone.truth[split][category]
        assert isinstance(ours, GroundTruth)
        assert isinstance(theirs, GroundTruth)
        for value, expected in zip(ours, theirs, strict=True):
            np.testing.assert_array_equal(value, expected)


def be_killed(*_: object) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_killed_process_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch, "get_num_threads", lambda: 2)
    monkeypatch.setattr(toybox, "_CHUNKS_WORTH_A_PROCESS", 1)
    monkeypatch.setattr(toybox, "_photograph_chunk", be_killed)
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(ProcessKilled, match="a process that made the toybox was killed"):
        make_toybox(ToyboxConfig(seed=0, train_count=3, test_count=2, photograph=CONFIG))
    assert signal.getsignal(signal.SIGINT) == before


def tell_how_interrupts_are_taken(*_: object) -> None:
    raise UserError(repr(signal.getsignal(signal.SIGINT)))


def test_interrupts_are_left_to_the_one_that_started_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch, "get_num_threads", lambda: 2)
    monkeypatch.setattr(toybox, "_CHUNKS_WORTH_A_PROCESS", 1)
    monkeypatch.setattr(toybox, "_photograph_chunk", tell_how_interrupts_are_taken)
    with pytest.raises(UserError, match="SIG_IGN"):
        make_toybox(ToyboxConfig(seed=0, train_count=1, test_count=1, photograph=CONFIG))


def test_a_larger_toybox_begins_with_the_smaller() -> None:
    small = make_toybox(ToyboxConfig(seed=0, train_count=2, test_count=1, photograph=CONFIG))
    large = make_toybox(ToyboxConfig(seed=0, train_count=34, test_count=2, photograph=CONFIG))
    for category in CATEGORIES:
        np.testing.assert_array_equal(small.images["train"][category], large.images["train"][category][:2])
        assert large.images["train"][category].shape == (34, 32, 32, 3)
        truth = large.truth["train"][category]
        assert isinstance(truth, GroundTruth)
        assert truth.masks.shape == (34, 32, 32)
        assert not np.array_equal(large.images["train"][category][:2], large.images["test"][category])


def test_a_mirror_that_lies_flat_shows_the_sky(monkeypatch: pytest.MonkeyPatch) -> None:
    directions, faces = icosphere(2)
    plates = np.tile(directions.numpy() * np.array([1.0, 0.02, 1.0]), (4, 1, 1))
    solid = Solid(plates, faces.numpy(), np.zeros(len(faces), dtype=np.int64))
    mirrors = Specimens(solid, np.zeros((4, 1, 3)), np.ones(1))
    from_above = ViewRange(elevation=(50.0, 60.0), side_views=False, roll=0.0, fill=0.9)

    def green_sky_and_red_floor(*chosen: Any) -> Lighting:
        sky, floor = np.tile([0.0, 1.0, 0.0], (4, 1)), np.tile([1.0, 0.0, 0.0], (4, 1))
        return choose_lighting(*chosen)._replace(sky=sky, floor=floor)

    monkeypatch.setattr("pipeline.datasets.toybox.photograph.choose_lighting", green_sky_and_red_floor)
    images, truth = photograph(mirrors, from_above, CATEGORIES["car"].setting, CONFIG, np.random.default_rng(0))
    red, green, _ = images[truth.masks.astype(bool)].mean(axis=0)
    assert green > 1.5 * red


def test_odd_supersampling_is_refused() -> None:
    with pytest.raises(ConfigError, match="supersampling is 3; expected a positive even number"):
        PhotographConfig(size=32, supersampling=3, camera=CAMERA)


def iou(first: Bool[np.ndarray, "B H W"], second: Bool[np.ndarray, "B H W"]) -> Float[np.ndarray, "B"]:
    return (first & second).sum(axis=(1, 2)) / np.maximum((first | second).sum(axis=(1, 2)), 1)


@pytest.mark.parametrize("category", CATEGORIES)
def test_no_background_colour_solves_the_mask(category: str) -> None:
    images, truth = take(category, 64)
    colors, masks = images / 255.0, truth.masks.astype(bool)
    border = np.concatenate([colors[:, 0], colors[:, -1], colors[:, :, 0], colors[:, :, -1]], axis=1)
    distance = np.linalg.norm(colors - border.mean(axis=1)[:, None, None], axis=-1)
    best = max(iou(distance > threshold, masks).mean() for threshold in np.linspace(0.05, 0.6, 12))
    assert best < 0.5
    assert (border.std(axis=1).mean(axis=1) < 0.05).mean() < 0.15


def test_toyboxes_of_other_seeds_are_others() -> None:

    first, second = (make_toybox(ToyboxConfig(seed, 1, 1, CONFIG)) for seed in (0, 1))
    for split in ("train", "test"):
        assert not any(np.array_equal(first.images[split][name], second.images[split][name]) for name in CATEGORIES)


def test_objects_are_rolled_and_fill_the_picture_as_their_category_says() -> None:

    cube = torch.rand(2000, 8, 3, generator=generator(0)) - 0.5
    for category in CATEGORIES.values():
        viewpoints = category.viewpoints
        found = choose_poses(viewpoints, cube, CAMERA, np.random.default_rng(0))
        assert found.roll.rad2deg().std().item() == pytest.approx(viewpoints.roll, rel=0.1)
        seen = project(cube, found, CAMERA)[..., :2]
        lower, upper = seen.amin(dim=1), seen.amax(dim=1)
        assert (upper - lower).amax(dim=1).mean().item() / 2 == pytest.approx(viewpoints.fill, abs=0.02)
        assert ((lower + upper) / 2).std().item() == pytest.approx(0.07, rel=0.1)
