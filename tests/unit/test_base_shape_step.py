"""One step of base-shape learning: what is drawn, and what is summed (paper section 3.1)."""

from dataclasses import replace
from typing import Any
from unittest.mock import patch

import pytest
import torch
from torch import Tensor

from pipeline.geometry.camera import project
from pipeline.geometry.sphere import build_sphere
from pipeline.networks.batch_normalization import BatchNorm2d
from pipeline.seeding import generator
from pipeline.training import base_shape
from pipeline.training.base_shape import SeedTrainer
from pipeline.training.photographs import Photographs
from tests.learning.test_base_shape import CONFIG
from tests.tiny_full_model import photographs, tiny_extractor


def trainer_of(index: int = 0, **changes: object) -> SeedTrainer:
    config = replace(CONFIG, **changes)  # pyright: ignore[reportArgumentType]
    extractor, sphere = tiny_extractor(), build_sphere(config.subdivisions, torch.device("cpu"))
    pictures = photographs(8)[0][..., ::2, ::2]
    return SeedTrainer(config, sphere, Photographs(pictures, extractor, 4, 2**30), 0, index)


def test_both_distances_are_balanced_and_smoothness_is_added(monkeypatch: pytest.MonkeyPatch) -> None:
    totals: list[Tensor] = []
    monkeypatch.setattr(base_shape, "take_step", lambda loss, _: totals.append(loss.detach()))
    losses = trainer_of(reconstruction_balance=0.3).step(0)
    pictures = 0.3 * losses["chamfer"] + 0.7 * losses["feature_matching"]
    torch.testing.assert_close(totals[0], pictures + losses["smoothness"])
    assert losses["smoothness"] > 1e-2


def test_lit_objects_fill_the_picture_in_front_of_their_backgrounds(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[tuple[Any, ...]] = []
    render = base_shape.render
    monkeypatch.setattr(base_shape, "render", lambda *given: (drawn.append(given), render(*given))[1])
    scene, _ = trainer_of(framing="box").generate(4, generator(0))
    [(_, _, pose, backgrounds, light, config)] = drawn
    assert (light.ambient.tolist(), light.directional.tolist()) == ([0.5] * 4, [0.5] * 4)
    assert torch.equal(backgrounds, scene.backgrounds)
    seen = project(scene.vertices, pose, config.camera)[..., :2]
    torch.testing.assert_close(seen.abs().amax(dim=(1, 2)), torch.ones(4))


def test_shapes_start_from_the_ellipsoid_of_the_settings() -> None:
    vertices = trainer_of().scene.initial_vertices
    size = 2 * vertices.flatten(0, -2).amax(0)
    torch.testing.assert_close(size / size.max(), torch.tensor([0.5, 0.5, 1.0]), atol=0.05, rtol=0)


def test_the_rate_of_base_shape_learning_cools_down() -> None:
    trainer, rates = trainer_of(), []
    for iteration in range(4):
        trainer.step(iteration)
        rates.append(trainer.optimizer.param_groups[0]["lr"])
    assert rates == pytest.approx([1e-3, 1e-3, 1e-3, 5e-4])


def test_seeds_draw_different_photographs() -> None:
    first, second = (trainer_of(index).rng for index in (0, 1))
    assert not torch.equal(torch.rand(8, generator=first), torch.rand(8, generator=second))


def test_renderings_are_compared_with_all_photographs() -> None:
    trainer, images = trainer_of(), torch.rand(4, 3, 16, 16, generator=generator(0))
    with patch.object(trainer.photographs, "batch", wraps=trainer.photographs.batch) as batch:
        for _ in range(30):
            trainer.reconstruction_loss(images, trainer.rng)
    assert torch.cat([call.args[0] for call in batch.call_args_list]).unique().tolist() == list(range(8))


def test_a_seeds_shape_is_the_mean_of_many() -> None:
    def spread(batch_size: int) -> float:
        trainer = trainer_of(batch_size=batch_size, generator=replace(CONFIG.generator, offset_scale=100.0))
        return torch.stack([trainer.shape() for _ in range(20)]).std(dim=0).mean().item()

    assert spread(16) < 0.5 * spread(1)


def test_a_score_is_of_fresh_batches_that_normalise_their_textures() -> None:
    trainer = trainer_of(score_batches=3)
    trainer.step(0)
    layer = next(part for part in trainer.scene.modules() if isinstance(part, BatchNorm2d))
    assert layer.num_batches_tracked is not None
    before = layer.num_batches_tracked.item()
    trainer.score()
    assert layer.num_batches_tracked.item() == before + 3


def test_base_shapes_of_other_seeds_start_from_other_weights_and_draws() -> None:
    extractor, sphere = tiny_extractor(), build_sphere(1, torch.device("cpu"))
    pictures = Photographs(photographs(8)[0][..., ::2, ::2], extractor, 4, 2**30)
    first, second = (SeedTrainer(CONFIG, sphere, pictures, seed, 0) for seed in (0, 1))
    assert not torch.equal(first.scene.sample_noise(4, first.rng), second.scene.sample_noise(4, second.rng))
    noise = first.scene.sample_noise(4, generator(0))
    assert not torch.equal(first.scene.texture(noise), second.scene.texture(noise))


def test_base_shape_learning_takes_the_betas_of_its_settings() -> None:
    assert trainer_of(betas=(0.3, 0.7)).optimizer.defaults["betas"] == (0.3, 0.7)
