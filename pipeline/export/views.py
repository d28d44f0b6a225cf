"""Renderings for people: shapes as grey clay or textured, from given sides, with a transparent background.

An object that would be cut off somewhere in a full turn is drawn smaller, from all sides alike.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

from pipeline.geometry.camera import CameraConfig, level_pose, project
from pipeline.ranges import Count, Elevation, Frames
from pipeline.rendering.lighting import Light
from pipeline.rendering.renderer import Mesh, RendererConfig, render

CLAY = 0.8
SEED_AZIMUTHS = (0.0, 45.0, 90.0, 225.0)
"""Front, front corner, side and rear corner, in degrees: from where base shapes are shown."""
_TURNS = 72
"""Of a full turn, that are looked at for what would be cut off."""


@dataclass(frozen=True)
class ViewConfig:
    """How objects are shown."""

    size: Count
    """Height and width of a rendering in pixels."""
    supersampling: Count
    """Samples along each side of a pixel."""
    elevation: Elevation
    """Height angle of the camera in degrees."""


@dataclass(frozen=True)
class TurntableConfig:
    """How `kato3d reconstruct` draws objects."""

    frames: Frames
    """Renderings in one turn."""
    view: ViewConfig
    """Size and elevation of renderings; reconstructions are enlarged to about the same size."""


def render_clay(
    vertices: Float[Tensor, "V 3"],
    faces: Int[Tensor, "F 3"],
    azimuths: Sequence[float],
    camera: CameraConfig,
    config: ViewConfig,
) -> Float[Tensor, "K 4 H W"]:
    """Render one shape in grey, lit from the camera's upper left, from azimuths in degrees."""
    turns = torch.tensor(azimuths).deg2rad()
    lamp, height = turns - math.radians(35), math.radians(50)
    across = torch.stack([lamp.sin(), torch.zeros_like(lamp), lamp.cos()], dim=1) * math.cos(height)
    direction = across + torch.tensor([0.0, math.sin(height), 0.0])
    light = Light(direction, torch.full_like(turns, 0.45), torch.full_like(turns, 0.6))
    texture = torch.full((1, 3, 2, 2), CLAY)
    return _render(vertices, faces, functional.normalize(vertices), texture, turns, light, camera, config)


def render_textured(
    vertices: Float[Tensor, "V 3"],
    faces: Int[Tensor, "F 3"],
    directions: Float[Tensor, "V 3"],
    texture: Float[Tensor, "3 T T"],
    azimuths: Sequence[float],
    camera: CameraConfig,
    config: ViewConfig,
) -> Float[Tensor, "K 4 H W"]:
    """Render one textured shape without light from azimuths in degrees."""
    turns = torch.tensor(azimuths).deg2rad()
    return _render(vertices, faces, directions, texture[None], turns, None, camera, config)


@torch.no_grad()
def _render(
    vertices: Float[Tensor, "V 3"],
    faces: Int[Tensor, "F 3"],
    directions: Float[Tensor, "V 3"],
    texture: Float[Tensor, "1 3 T T"],
    turns: Float[Tensor, " K"],
    light: Light | None,
    camera: CameraConfig,
    config: ViewConfig,
) -> Float[Tensor, "K 4 H W"]:
    """Render from all turns in one batch; colours are those of the covered part of each pixel, opacity is its share."""
    count, elevation = len(turns), math.radians(config.elevation)
    pose = level_pose(turns, torch.full_like(turns, elevation))
    pose = pose._replace(scale=pose.scale / _reach(vertices, elevation, camera).clamp(min=1))
    mesh = Mesh(vertices.expand(count, -1, -1), faces, directions)
    renderer = RendererConfig(camera=camera, size=config.size, supersampling=config.supersampling)
    images, silhouettes = render(mesh, texture.expand(count, -1, -1, -1), pose, None, light, renderer)
    opacity = silhouettes[:, None].clamp(0, 1)
    return torch.cat([images / opacity.clamp_min(1e-6), opacity], dim=1).clamp(0, 1)


def _reach(vertices: Float[Tensor, "V 3"], elevation: float, camera: CameraConfig) -> Float[Tensor, ""]:
    """Return how far a shape reaches in a full turn, in ndc: 1 is the border of the picture."""
    turns = torch.arange(_TURNS) * (2 * math.pi / _TURNS)
    pose = level_pose(turns, torch.full_like(turns, elevation))
    return project(vertices.expand(_TURNS, -1, -1), pose, camera)[..., :2].abs().max()


def on_white(pictures: Float[Tensor, "*batch 4 H W"]) -> Float[Tensor, "*batch 3 H W"]:
    """Lay renderings with opacity over white."""
    colors, opacity = pictures[..., :3, :, :], pictures[..., 3:, :, :]
    return colors * opacity + 1 - opacity
