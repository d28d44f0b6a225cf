"""Warm up the full model on the base shape's own renderings, whose shape and pose are known (ours).

Base-shape learning has matched the distribution of such renderings to that of the photographs. A model that has
learned to read them starts full training with poses near the truth instead of random ones, which the search of paper
3.2.2 would have to find while textures still mean nothing.
"""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.distributed import average, share
from pipeline.networks.full_model import FullModel, Reconstruction
from pipeline.networks.scene_generator import SceneGenerator
from pipeline.ranges import Count, Momentum, Natural, NonNegative, Positive
from pipeline.rendering.lighting import Light
from pipeline.rendering.renderer import Mesh, render
from pipeline.training.cuda_graph import GraphedStep
from pipeline.training.divergence import require_finite
from pipeline.training.loop import take_steps
from pipeline.training.optimization import adam, take_step
from pipeline.training.viewpoints import LightConfig, sample_lights


@dataclass(frozen=True)
class WarmUpConfig:
    """Settings of the warm-up."""

    iterations: Natural
    """0 starts full training from scratch, as the paper does."""
    batch_size: Count
    learning_rate: Positive
    betas: tuple[Momentum, Momentum]
    light: LightConfig
    shape_spread: NonNegative
    """Standard deviation of the shapes around the base shape, in shape parameters."""
    paint: NonNegative
    """Largest part by which each colour channel of a texture or background is made brighter or darker, so that the
    encoders meet colours that the generators seldom paint in."""
    noise: NonNegative
    """Largest standard deviation of the pixel noise, so that the encoders do not rely on clean edges."""


class Draw(NamedTuple):
    """Everything random about a batch of renderings."""

    pose: Float[Tensor, "B 7"]
    latent: Float[Tensor, "B latent"]
    """Of the generators of textures and backgrounds."""
    shape: Float[Tensor, "B K"]
    light: Light
    texture_paint: Float[Tensor, "B 3 1 1"]
    """Multiplies the colours of textures."""
    background_paint: Float[Tensor, "B 3 1 1"]
    grain: Float[Tensor, "B 3 H W"]
    """Added to the pictures."""


class Sample(NamedTuple):
    """A batch of renderings and what they show."""

    images: Float[Tensor, "B 3 H W"]
    pose: Float[Tensor, "B 7"]
    shape: Float[Tensor, "B K"]


def warm_up(model: FullModel, scenes: SceneGenerator, config: WarmUpConfig, rng: torch.Generator) -> None:
    """Train the encoders and decoders of poses, textures and backgrounds on renderings.

    Raises TrainingDiverged as full training does.
    """
    optimizer = adam(model.parameters(), config.learning_rate, config.betas)

    def learn() -> dict[str, Float[Tensor, ""]]:
        loss = warm_up_loss(model, draw_sample(model, scenes, config, rng))
        take_step(loss, optimizer)
        return {"loss": average(loss.detach())}

    step = GraphedStep(learn, rng.device, rng)
    take_steps(lambda _iteration: step(), config.iterations, "warm-up")
    require_finite(model.state_dict(), config.iterations, "warm-up")


def draw_sample(model: FullModel, scenes: SceneGenerator, config: WarmUpConfig, rng: torch.Generator) -> Sample:
    """Render deformed base shapes with generated textures and backgrounds: this process's share of the batch."""
    return _render(model, scenes, share(_draw(model, scenes, config, rng)))


def warm_up_loss(model: FullModel, sample: Sample) -> Float[Tensor, ""]:
    """Return the errors of poses (student and every head), and of the picture drawn again.

    The picture is drawn with the true pose and shape: its error trains the texture and the background. Shapes are left
    to full training: how a small picture differs for an object's shape is learned too late to be a lesson here, and
    until then the only answer is the base shape (docs/decisions/shapes-and-hues.md).
    """
    images, pose, shape = sample
    poses = model.pose_decoder.known_error(model.pose_encoder(images), pose)
    vertices = model.shapes.around_fixed_base(shape)
    drawn = model.render(
        Reconstruction(
            vertices,
            model.read_textures(images),
            model.poses(pose, vertices),
            model.read_backgrounds(images),
        )
    )
    return poses + (drawn - images).abs().mean()


def _draw(model: FullModel, scenes: SceneGenerator, config: WarmUpConfig, rng: torch.Generator) -> Draw:
    count, size = config.batch_size, model.config.renderer.size
    pose = model.poses.draw(count, rng)
    latent = scenes.sample_noise(count, rng)
    shape = model.shapes.draw(count, config.shape_spread, rng)
    light = sample_lights(config.light, count, rng)
    uniform = torch.rand(2, count, 3, 1, 1, generator=rng, device=rng.device)
    texture_paint, background_paint = 1 + config.paint * (2 * uniform - 1)
    deviation = config.noise * torch.rand(count, 1, 1, 1, generator=rng, device=rng.device)
    grain = deviation * torch.randn(count, 3, size, size, generator=rng, device=rng.device)
    return Draw(pose, latent, shape, light, texture_paint, background_paint, grain)


@torch.no_grad()
def _render(model: FullModel, scenes: SceneGenerator, drawn: Draw) -> Sample:
    vertices = model.shapes(drawn.shape)
    images = render(
        Mesh(vertices, model.faces, model.directions),
        (drawn.texture_paint * scenes.texture(drawn.latent)).clamp(0, 1),
        model.poses(drawn.pose, vertices),
        (drawn.background_paint * scenes.background(drawn.latent)).clamp(0, 1),
        drawn.light,
        model.config.renderer,
    ).images
    return Sample((images + drawn.grain).clamp(0, 1), drawn.pose, drawn.shape)
