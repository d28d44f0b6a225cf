"""HoloGAN: the turn of its volume, its styles, its gradients, and a training that resumes."""

import json
import math
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.nn import functional

from pipeline.errors import DataError, TrainingDiverged
from pipeline.networks.hologan import (
    AdaptiveNormalization,
    HoloDiscriminator,
    HoloGANConfig,
    HoloGenerator,
    draw_views,
    load_hologan,
    rotate_volume,
    save_hologan,
)
from pipeline.seeding import generator, initialised
from pipeline.tensor_files import save_tensors
from pipeline.training import hologan
from pipeline.training.checkpoint import Checkpoint
from pipeline.training.hologan import HoloGANTrainer, HoloGANTrainingConfig, train_hologan
from pipeline.training.viewpoints import AngleConfig, ViewpointConfig

NETWORK = HoloGANConfig(latent_size=6, width=2, discriminator_width=4, image_size=32)
TRAINING = HoloGANTrainingConfig(
    iterations=6,
    batch_size=3,
    learning_rate=1e-3,
    betas=(0.5, 0.999),
    generator_steps=2,
    identity=1.0,
    network=NETWORK,
    viewpoint=ViewpointConfig(AngleConfig(0.0, 360.0, 1.0), AngleConfig(0.0, 35.0, 1.0), mirrored=False),
    curve_every=3,
    checkpoint_every=2,
)
PHOTOGRAPHS = torch.randint(256, (5, 3, 32, 32), generator=generator(0), dtype=torch.uint8)


def _generator() -> HoloGenerator:
    with initialised(0):
        return HoloGenerator(NETWORK)


def _turned(volume: Tensor, azimuth: float, elevation: float = 0.0) -> Tensor:
    return rotate_volume(volume, torch.tensor([azimuth]), torch.tensor([elevation]))


@pytest.mark.parametrize("quarters", [0, 1, 2, 3])
def test_quarter_turns_move_voxels(quarters: int) -> None:
    """From +x (azimuth 90) the old +x is nearest to the viewer, in the last slice of depth."""
    volume = torch.rand(1, 2, 8, 8, 8, generator=generator(1))
    expected = np.rot90(volume.numpy(), -quarters, axes=(2, 4)).copy()
    turned = _turned(volume, quarters * math.pi / 2)
    torch.testing.assert_close(turned, torch.from_numpy(expected), atol=1e-5, rtol=0)


def test_a_camera_overhead_sees_the_top() -> None:
    volume = torch.zeros(1, 1, 4, 4, 4)
    volume[:, :, :, 0] = 1
    torch.testing.assert_close(_turned(volume, 0.0, math.pi / 2)[0, 0, -1], torch.ones(4, 4), atol=1e-5, rtol=0)


def test_styles_set_mean_and_deviation() -> None:
    with initialised(0):
        style = AdaptiveNormalization(3, 4)
    latent = torch.rand(2, 3, generator=generator(0))
    styled = style(5 + 3 * torch.rand(2, 4, 6, 6, 6, generator=generator(1)), latent)
    scale, shift = style.style(latent).chunk(2, dim=1)
    torch.testing.assert_close(styled.mean((2, 3, 4)), shift, atol=1e-4, rtol=0)
    torch.testing.assert_close(styled.std((2, 3, 4)), (1 + scale).abs(), atol=1e-2, rtol=0)


@pytest.mark.parametrize("size", [32, 64])
def test_gradients_reach_the_constant(size: int) -> None:
    config = replace(NETWORK, image_size=size)
    with initialised(0):
        network, discriminator = HoloGenerator(config), HoloDiscriminator(config)
    images = network(network.sample_latent(2, generator(0)), torch.zeros(2), torch.zeros(2))
    assert images.shape == (2, 3, size, size)
    score, latent = discriminator(images)
    assert latent.shape == (2, NETWORK.latent_size)
    score.sum().backward()
    assert all(parameter.grad is not None and bool(parameter.grad.any()) for parameter in network.parameters())


def test_views_of_a_saved_generator_are_its_own(tmp_path: Path) -> None:
    network = _generator().eval()
    save_hologan(tmp_path / "hologan.safetensors", network)
    latent, azimuths = network.sample_latent(3, generator(0)), torch.tensor([0.0, 2 * math.pi, 1.0])
    views = draw_views(load_hologan(tmp_path / "hologan.safetensors", torch.device("cpu")), latent, azimuths, 10.0)
    torch.testing.assert_close(views, draw_views(network, latent, azimuths, 10.0))
    torch.testing.assert_close(views[:, 0], views[:, 1], atol=1e-4, rtol=0)
    assert not torch.allclose(views[:, 0], views[:, 2], atol=1e-4)


def test_a_generator_of_another_width_is_no_generator_of_this_code(tmp_path: Path) -> None:
    path = tmp_path / "hologan.safetensors"
    save_tensors(path, _generator().state_dict(), {"config": json.dumps(asdict(replace(NETWORK, width=4)))})
    with pytest.raises(DataError, match=r"hologan\.safetensors holds other weights than this code's networks have"):
        load_hologan(path, torch.device("cpu"))


def test_the_discriminator_learns_to_tell_dark_photographs() -> None:
    trainer = HoloGANTrainer(replace(TRAINING, learning_rate=1e-2), PHOTOGRAPHS // 8, 0)
    latent = trainer.generator.sample_latent(3, generator(0))
    with torch.no_grad():
        generated = trainer.generator(latent, torch.zeros(3), torch.zeros(3))
    losses = [trainer._improve_discriminator(generated, latent).item() for _ in range(12)]
    assert losses[-1] < 0.5 * losses[0]


def test_a_resumed_training_ends_with_the_same_bits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole, rows = train_hologan(TRAINING, PHOTOGRAPHS, 0, Checkpoint(tmp_path / "whole", "key"))
    step = HoloGANTrainer.step

    def killed(trainer: HoloGANTrainer, iteration: int) -> dict[str, torch.Tensor]:
        if iteration == 5:
            raise KeyboardInterrupt
        return step(trainer, iteration)

    monkeypatch.setattr(HoloGANTrainer, "step", killed)
    with pytest.raises(KeyboardInterrupt):
        train_hologan(TRAINING, PHOTOGRAPHS, 0, Checkpoint(tmp_path / "stopped", "key"))
    monkeypatch.setattr(HoloGANTrainer, "step", step)
    resumed, again = train_hologan(TRAINING, PHOTOGRAPHS, 0, Checkpoint(tmp_path / "stopped", "key"))
    assert rows.rows == again.rows
    assert [row["iteration"] for row in rows.rows] == [3, 6]
    for name, tensor in whole.state_dict().items():
        assert torch.equal(tensor, resumed.state_dict()[name]), name


def test_what_cannot_be_trained_is_said(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="image_size is 32; photographs are 16 pixels wide"):
        train_hologan(TRAINING, PHOTOGRAPHS[..., ::2, ::2], 0, Checkpoint(tmp_path, "key"))
    with pytest.raises(TrainingDiverged, match="at iteration"):
        train_hologan(replace(TRAINING, learning_rate=1e30), PHOTOGRAPHS, 0, Checkpoint(tmp_path, "key"))


def test_the_generator_gains_by_passing_for_photographs_and_showing_its_latent(monkeypatch: pytest.MonkeyPatch) -> None:
    totals: list[Tensor] = []
    monkeypatch.setattr(hologan, "take_step", lambda loss, _: totals.append(loss.detach()))
    trainer = HoloGANTrainer(replace(TRAINING, identity=3.0), PHOTOGRAPHS, 0)
    trainer.discriminator.eval()  # spectral normalisation stands still
    draw = (trainer.generator.sample_latent(3, generator(0)), torch.zeros(3), torch.zeros(3))
    trainer._improve_generator(*draw)
    with torch.no_grad():
        trainer.discriminator.score.bias.add_(5)
        score, read = trainer.discriminator(trainer.generator(*draw))
    trainer._improve_generator(*draw)
    assert totals[1] < totals[0]
    expected = functional.softplus(-score).mean() + 3 * (read - draw[0]).square().mean()
    torch.testing.assert_close(totals[1], expected)


def test_the_discriminator_gains_by_telling_photographs_and_reading_the_latent(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    totals: list[Tensor] = []
    monkeypatch.setattr(hologan, "take_step", lambda loss, _: totals.append(loss.detach()))
    trainer = HoloGANTrainer(replace(TRAINING, identity=3.0), PHOTOGRAPHS[:1], 0)
    trainer.discriminator.eval()  # spectral normalisation stands still
    latent = trainer.generator.sample_latent(3, generator(0))
    with torch.no_grad():
        generated = trainer.generator(latent, torch.zeros(3), torch.zeros(3))
        score, read = trainer.discriminator(generated)
        real, _ = trainer.discriminator(2 * (PHOTOGRAPHS[:1] / 255) - 1)
    trainer._improve_discriminator(generated, latent)
    expected = functional.softplus(-real).mean() + functional.softplus(score).mean()
    torch.testing.assert_close(totals, [expected + 3 * (read - latent).square().mean()])


def test_a_step_is_as_the_settings_say(monkeypatch: pytest.MonkeyPatch) -> None:
    trainer, stepped, views = HoloGANTrainer(replace(TRAINING, generator_steps=3), PHOTOGRAPHS, 0), [], list[Tensor]()
    monkeypatch.setattr(hologan, "take_step", lambda _, optimizer: stepped.append(optimizer))
    trainer.generator.register_forward_pre_hook(lambda _, arguments: views.append(torch.stack(arguments[1:])))
    rates = []
    for iteration in range(6):
        trainer.step(iteration)
        rates.append(trainer.generator_optimizer.param_groups[0]["lr"])
    assert rates == pytest.approx([1e-3] * 4 + [2e-3 / 3, 1e-3 / 3])
    assert stepped == [trainer.discriminator_optimizer, *[trainer.generator_optimizer] * 3] * 6
    assert all(torch.equal(views[0], seen) for seen in views[:4])
    azimuth, elevation = torch.stack(views[::4]).transpose(0, 1).flatten(1)
    assert len(azimuth.unique()) == len(elevation.unique()) == 18
    assert azimuth.max() > math.pi
    assert 0 <= elevation.min() < elevation.max() <= math.radians(35)


def test_seeds_of_hologan_differ() -> None:
    first, second = (HoloGANTrainer(TRAINING, PHOTOGRAPHS, seed) for seed in (0, 1))
    assert not torch.equal(first.generator.output.weight, second.generator.output.weight)
    latents = [trainer.generator.sample_latent(3, trainer.rng) for trainer in (first, second)]
    assert not torch.equal(*latents)


def test_elevations_of_views_are_degrees() -> None:
    network = _generator().eval()
    latent, azimuths = network.sample_latent(2, generator(0)), torch.tensor([0.0, 1.0])
    drawn = network(latent, azimuths[1:].expand(2), torch.full((2,), math.radians(10)))
    torch.testing.assert_close(draw_views(network, latent, azimuths, 10.0)[:, 1], (drawn.detach() + 1) / 2)
