"""The warm-up on renderings of the base shape."""

from dataclasses import replace
from typing import Any

import pytest
import torch

from pipeline.errors import TrainingDiverged
from pipeline.seeding import generator
from pipeline.training import warm_up as warm_up_module
from pipeline.training.optimization import adam
from pipeline.training.warm_up import draw_sample, warm_up, warm_up_loss
from tests.tiny_full_model import TRAINING, tiny_model, tiny_scenes

CONFIG = replace(TRAINING.warm_up, iterations=300, batch_size=16, learning_rate=3e-3)


@pytest.mark.slow
def test_warm_up_teaches_where_objects_are_in_unseen_renderings() -> None:
    model, scenes = tiny_model(), tiny_scenes().generators[0]
    # Easier than a real one, so that so few iterations teach something whatever the processor rounds.
    config = replace(CONFIG, iterations=500, learning_rate=2e-3, paint=0.0, noise=0.02)
    images, pose, _ = draw_sample(model, scenes, replace(config, batch_size=64), generator(1))

    def error_of_box() -> float:
        with torch.no_grad():
            said = model.pose_decoder(model.pose_encoder(images)).coordinates
            return (said - pose)[:, 4:].abs().mean().item()

    before = error_of_box()
    warm_up(model, scenes, config, generator(0))
    assert error_of_box() < 0.7 * before
    torch.testing.assert_close(model.shapes.base(), model.base_vertices)  # its own renderings cannot say it is wrong


def test_a_last_step_that_breaks_the_weights_is_an_error() -> None:
    config = replace(CONFIG, iterations=1, learning_rate=1e39)
    with pytest.raises(TrainingDiverged, match="no longer finite after iteration 1 of warm-up"):
        warm_up(tiny_model(), tiny_scenes().generators[0], config, generator(0))


def test_paint_changes_colors_alone() -> None:
    model, scenes = tiny_model(), tiny_scenes().generators[0]
    plain, painted = (
        draw_sample(model, scenes, replace(CONFIG, paint=paint, noise=0.0), generator(2)) for paint in (0.0, 0.3)
    )
    assert torch.equal(plain.shape, painted.shape)
    factors = torch.where(plain.images > 0.05, painted.images / plain.images, torch.nan).flatten(2)
    smallest, largest = (extreme(factors.nan_to_num(1)) for extreme in (torch.amin, torch.amax))
    assert smallest >= 0.7 - 1e-3
    assert largest <= 1.3 + 1e-3
    of_channels = factors.nanmedian(dim=2).values
    assert of_channels.std(dim=1).mean() > 0.05  # each channel has its own,
    within = (factors - factors.nanmean(dim=2, keepdim=True)).square().nanmean(dim=2).sqrt()
    assert within.nanmedian() > 0.05  # and so have texture and background


def test_renderings_stay_in_range_and_differ() -> None:
    images, _, shape = draw_sample(tiny_model(), tiny_scenes().generators[0], CONFIG, generator(2))
    assert images.min() >= 0
    assert images.max() <= 1
    assert images.std(dim=0).mean() > 0.01
    assert shape.std() > 0


def test_scenes_are_lit_their_shapes_differ_and_noise_is_added(monkeypatch: pytest.MonkeyPatch) -> None:
    model, scenes = tiny_model(), tiny_scenes().generators[0]
    drawn: list[tuple[Any, ...]] = []
    render = warm_up_module.render
    monkeypatch.setattr(warm_up_module, "render", lambda *given: (drawn.append(given), render(*given))[1])
    config = replace(TRAINING.warm_up, batch_size=200, paint=0.0, noise=0.1)
    sample = draw_sample(model, scenes, config, generator(2))
    assert drawn[0][4].directional.unique().tolist() == [config.light.directional]
    assert sample.shape.std().item() == pytest.approx(config.shape_spread, abs=0.02)
    plain = draw_sample(model, scenes, replace(config, noise=0.0), generator(2))
    deviation = (sample.images - plain.images).flatten(1).std(dim=1)
    assert 0.06 < deviation.max() <= 0.105
    assert deviation.min() < 0.01


def test_every_encoder_and_decoder_of_pictures_and_poses_learns() -> None:
    model, scenes = tiny_model(), tiny_scenes().generators[0]
    warm_up_loss(model, draw_sample(model, scenes, TRAINING.warm_up, generator(0))).backward()
    for part in ("texture", "background", "pose"):
        for network in (getattr(model, f"{part}_encoder"), getattr(model, f"{part}_decoder")):
            assert any(weight.grad is not None and weight.grad.any() for weight in network.parameters()), part


def test_the_warm_up_takes_the_betas_of_its_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[Any] = []
    monkeypatch.setattr(warm_up_module, "adam", lambda *words: (given.append(words[1:]), adam(*words))[1])
    config = replace(TRAINING.warm_up, iterations=1, betas=(0.3, 0.7))
    warm_up_module.warm_up(tiny_model(), tiny_scenes().generators[0], config, generator(0))
    assert given == [(config.learning_rate, (0.3, 0.7))]
