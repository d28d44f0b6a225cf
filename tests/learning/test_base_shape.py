"""Base-shape learning: resuming, determinism, divergence and that the loss falls."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from pipeline.errors import ConfigError, TrainingDiverged
from pipeline.geometry.camera import CameraConfig, Pose
from pipeline.geometry.sphere import build_sphere
from pipeline.losses.smoothness import SmoothnessConfig
from pipeline.networks.feature_extractor import FeatureExtractor
from pipeline.networks.scene_generator import ConstraintConfig, GeneratorConfig, Scene
from pipeline.networks.wide_resnet import WideResNet
from pipeline.rendering.renderer import Mesh, RendererConfig, Rendering, render
from pipeline.seeding import initialised
from pipeline.training import base_shape
from pipeline.training.base_shape import BaseShapeConfig, BaseShapes, SeedTrainer, learn_base_shape
from pipeline.training.checkpoint import Checkpoint
from pipeline.training.photographs import Photographs
from pipeline.training.viewpoints import AngleConfig, LightConfig, ViewpointConfig

CONFIG = BaseShapeConfig(
    iterations=4,
    batch_size=4,
    seeds=2,
    learning_rate=1e-3,
    betas=(0.5, 0.99),
    cool_down=0.5,
    reconstruction_balance=0.9,
    colors=2,
    initial_dimensions=(0.5, 0.5, 1.0),
    subdivisions=1,
    framing="free",
    front_scale=1.0,
    generator=GeneratorConfig(8, 16, 1.0, 4, 8, 8, True),
    constraints=ConstraintConfig(True, True, True, True),
    viewpoint=ViewpointConfig(AngleConfig(0.0, 360.0, 1.0), AngleConfig(0.0, 30.0, 1.0), mirrored=False),
    light=LightConfig(0.5, 0.5),
    renderer=RendererConfig(CameraConfig(2.7, 30.0), 16, 1),
    smoothness=SmoothnessConfig(1.0, 0.0, 0.0, 0.01, 0.0, 0.0),
    score_batches=1,
    curve_every=2,
    checkpoint_every=2,
)

MEMORY = 2**30


@pytest.fixture(scope="module")
def extractor() -> FeatureExtractor:
    with initialised(0):
        return FeatureExtractor(WideResNet(10, 1, 2), 2.0)


@pytest.fixture(scope="module")
def images() -> torch.Tensor:
    """Photographs of a grey disk on green."""
    rows, columns = torch.meshgrid(torch.arange(16), torch.arange(16), indexing="ij")
    disk = ((rows - 8) ** 2 + (columns - 8) ** 2 < 30).to(torch.uint8)
    green = torch.tensor([40, 160, 40], dtype=torch.uint8)[:, None, None]
    return torch.where(disk.bool(), torch.full_like(green, 128), green).repeat(8, 1, 1, 1)


def learn(folder: Path, images: torch.Tensor, extractor: FeatureExtractor, config: BaseShapeConfig) -> BaseShapes:
    photographs = Photographs(images, extractor, config.batch_size, MEMORY)
    return learn_base_shape(config, photographs, 0, Checkpoint(folder, "key"))


def test_a_killed_run_resumes_to_the_same_bytes(
    tmp_path: Path, images: torch.Tensor, extractor: FeatureExtractor, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = learn(tmp_path / "whole", images, extractor, CONFIG)
    step, taken = SeedTrainer.step, list[int]()

    def killed(trainer: SeedTrainer, iteration: int) -> dict[str, torch.Tensor]:
        taken.append(iteration)
        if taken == [0, 1, 2, 3, 0, 1, 2, 3]:
            raise KeyboardInterrupt
        return step(trainer, iteration)

    monkeypatch.setattr(SeedTrainer, "step", killed)
    with pytest.raises(KeyboardInterrupt):
        learn(tmp_path / "killed", images, extractor, CONFIG)
    taken.clear()
    resumed = learn(tmp_path / "killed", images, extractor, CONFIG)
    assert taken == [2, 3]
    assert torch.equal(resumed.vertices, whole.vertices)
    assert torch.equal(resumed.scores, whole.scores)
    assert resumed.curve.rows == whole.curve.rows
    for ours, theirs in zip(resumed.generators, whole.generators, strict=True):
        weights = ours.state_dict()
        assert all(torch.equal(weights[name], value) for name, value in theirs.state_dict().items())


def test_seeds_differ_and_the_lowest_score_wins(
    tmp_path: Path, images: torch.Tensor, extractor: FeatureExtractor
) -> None:
    shapes = learn(tmp_path, images, extractor, CONFIG)
    assert not torch.equal(shapes.vertices[0], shapes.vertices[1])
    assert shapes.scores[shapes.best] == shapes.scores.min()


def test_seeds_are_scored_on_the_same_batches(images: torch.Tensor, extractor: FeatureExtractor) -> None:
    sphere = build_sphere(CONFIG.subdivisions, torch.device("cpu"))
    photographs = Photographs(images, extractor, CONFIG.batch_size, MEMORY)
    first, second = (SeedTrainer(CONFIG, sphere, photographs, 0, index) for index in range(2))
    assert first.score() != second.score()
    second.scene.load_state_dict(first.scene.state_dict())
    assert first.score() == second.score()


def test_training_lowers_the_score(tmp_path: Path, images: torch.Tensor, extractor: FeatureExtractor) -> None:
    before = learn(tmp_path / "before", images, extractor, replace(CONFIG, seeds=1, iterations=0))
    after = learn(tmp_path / "after", images, extractor, replace(CONFIG, seeds=1, iterations=60, learning_rate=3e-3))
    assert after.scores[0] < 0.9 * before.scores[0]


def test_a_loss_that_is_not_a_number_keeps_the_state_before_it(
    tmp_path: Path, images: torch.Tensor, extractor: FeatureExtractor, monkeypatch: pytest.MonkeyPatch
) -> None:
    generate = SeedTrainer.generate
    calls = 0

    def broken(trainer: SeedTrainer, count: int, rng: torch.Generator) -> tuple[Scene, torch.Tensor]:
        nonlocal calls
        calls += 1
        scene, rendered = generate(trainer, count, rng)
        return scene, rendered * float("nan") if calls == 4 else rendered

    monkeypatch.setattr(SeedTrainer, "generate", broken)
    with pytest.raises(TrainingDiverged, match="iteration 4;"):
        learn(tmp_path, images, extractor, CONFIG)
    state = Checkpoint(tmp_path, "key").part("0").load()
    assert state is not None
    assert state[1]["iteration"] == 2


def test_the_same_seed_repeats_exactly(images: torch.Tensor, extractor: FeatureExtractor, tmp_path: Path) -> None:
    first = learn(tmp_path / "first", images, extractor, replace(CONFIG, seeds=1))
    second = learn(tmp_path / "second", images, extractor, replace(CONFIG, seeds=1))
    assert torch.equal(first.vertices, second.vertices)


def test_fronts_are_drawn_larger(
    images: torch.Tensor, extractor: FeatureExtractor, monkeypatch: pytest.MonkeyPatch
) -> None:
    ahead = replace(CONFIG, viewpoint=replace(CONFIG.viewpoint, azimuth=AngleConfig(0.0, 0.0, 1.0)), front_scale=1.4)
    drawn = list[Pose]()

    def watched(mesh: Mesh, textures: torch.Tensor, pose: Pose, *rest: Any) -> Rendering:
        drawn.append(pose)
        return render(mesh, textures, pose, *rest)

    monkeypatch.setattr(base_shape, "render", watched)
    sphere = build_sphere(CONFIG.subdivisions, torch.device("cpu"))
    photographs = Photographs(images, extractor, CONFIG.batch_size, MEMORY)
    SeedTrainer(ahead, sphere, photographs, 0, 0).step(0)
    torch.testing.assert_close(drawn[0].scale, torch.full((CONFIG.batch_size,), 1.4))


def test_a_scale_that_filling_the_picture_would_override_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"front_scale is 1\.4 at framing box; expected 1"):
        replace(CONFIG, framing="box", front_scale=1.4)
