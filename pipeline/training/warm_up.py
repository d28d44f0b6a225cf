"""Warm up the full model on the base shape's own renderings, whose shape, pose and background are known (ours).

Base-shape learning has matched the distribution of such renderings to that of the photographs. A model that has
learned to read them starts full training with poses near the truth instead of random ones, which the search of paper
3.2.2 would have to find while textures still mean nothing.
"""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from tqdm import tqdm

from pipeline.networks.full_model import FullModel, Reconstruction
from pipeline.networks.scene_generator import SceneGenerator
from pipeline.rendering.renderer import Mesh, render
from pipeline.training.checkpoint import read_losses
from pipeline.training.viewpoints import LightConfig, sample_lights


@dataclass(frozen=True)
class WarmUpConfig:
    """Settings of the warm-up.

    Attributes:
        iterations: 0 starts full training from scratch, as the paper does.
        shape_spread: standard deviation of the shapes around the base shape, in shape parameters.
        noise: largest standard deviation of the pixel noise, so that the encoders do not rely on clean edges.
    """

    iterations: int
    batch_size: int
    learning_rate: float
    betas: tuple[float, float]
    light: LightConfig
    shape_spread: float
    noise: float


class Sample(NamedTuple):
    """A batch of renderings and what they show."""

    images: Float[Tensor, "B 3 H W"]
    pose: Float[Tensor, "B 7"]
    shape: Float[Tensor, "B K"]


def warm_up(model: FullModel, scenes: SceneGenerator, config: WarmUpConfig, rng: torch.Generator) -> None:
    """Train every encoder and decoder of the model on renderings. Raises TrainingDiverged as full training does."""
    optimizer = torch.optim.Adam(model.parameters(), lr=config.learning_rate, betas=config.betas)
    losses: list[dict[str, Tensor]] = []
    for _ in tqdm(range(config.iterations), "warm-up", disable=None):
        loss = warm_up_loss(model, draw_sample(model, scenes, config, rng))
        losses.append({"loss": loss.detach()})
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        optimizer.step()
    read_losses(losses, config.iterations - 1)


def draw_sample(model: FullModel, scenes: SceneGenerator, config: WarmUpConfig, rng: torch.Generator) -> Sample:
    """Render deformed base shapes from random poses."""
    return render_sample(model, scenes, model.poses.draw(config.batch_size, rng), config, rng)


@torch.no_grad()
def render_sample(
    model: FullModel, scenes: SceneGenerator, pose: Float[Tensor, "B 7"], config: WarmUpConfig, rng: torch.Generator
) -> Sample:
    """Render deformed base shapes with generated textures and backgrounds and random lights."""
    count = len(pose)
    noise = scenes.sample_noise(count, rng)
    shape = model.shapes.draw(count, config.shape_spread, rng)
    vertices = model.shapes(shape)
    images = render(
        Mesh(vertices, model.faces, model.directions),
        scenes.texture(noise),
        model.poses(pose, vertices),
        scenes.background(noise),
        sample_lights(config.light, count, rng),
        model.config.renderer,
    ).images
    size = config.noise * torch.rand(count, 1, 1, 1, generator=rng, device=rng.device)
    images = images + size * torch.randn(images.shape, generator=rng, device=rng.device)
    return Sample(images.clamp(0, 1), pose, shape)


def warm_up_loss(model: FullModel, sample: Sample) -> Float[Tensor, ""]:
    """Return the mean absolute errors of poses (student and every head), of shapes, and of the picture drawn again.

    The picture is drawn with the true pose and shape: its error trains the texture and the background.
    """
    images, pose, shape = sample
    code = model.pose_encoder(images)
    heads = (model.pose_decoder.ensemble(code) - pose[:, None]).abs().mean()
    student = (model.pose_decoder(code) - pose).abs().mean()
    shapes = (model.shape_decoder(model.shape_encoder(images)) - shape).abs().mean()
    vertices = model.shapes(shape)
    drawn = model.render(
        Reconstruction(
            vertices,
            model.texture_decoder(model.texture_encoder(images)),
            model.poses(pose, vertices),
            model.background_decoder(model.background_encoder(images)),
        )
    )
    return heads + student + shapes + (drawn - images).abs().mean()
