"""The differentiable renderer: mesh, texture, pose, light and background to picture."""

from dataclasses import dataclass
from functools import reduce
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from pipeline.geometry.camera import CameraConfig, Pose, project
from pipeline.ranges import Count
from pipeline.rendering.antialias import antialias
from pipeline.rendering.interpolate import interpolate
from pipeline.rendering.lighting import Light, shade
from pipeline.rendering.rasterize import rasterize
from pipeline.rendering.texture import sample_sphere_texture


@dataclass(frozen=True)
class RendererConfig:
    """Set the camera and the sampling of pictures."""

    camera: CameraConfig
    size: Count
    """Height and width of a picture, in pixels."""
    supersampling: Count
    """Samples along each side of a pixel."""


class Mesh(NamedTuple):
    """Hold a batch of shapes of one topology with the texture domain of its vertices."""

    vertices: Float[Tensor, "B V 3"]
    """Positions in the world."""
    faces: Int[Tensor, "F 3"]
    """Corners of each face, counter-clockwise from outside."""
    directions: Float[Tensor, "V 3"]
    """Each vertex's point on the unit sphere, on which textures are defined."""


class Rendering(NamedTuple):
    """Hold rendered pictures."""

    images: Float[Tensor, "B 3 H W"]
    """RGB, in [0, 1] where the light's intensities add up to at most 1; black behind where no background was given."""
    silhouettes: Float[Tensor, "B H W"]
    """The part of each pixel that the object covers, in [0, 1]."""


def render(
    mesh: Mesh,
    texture_maps: Float[Tensor, "B 3 T T"],
    pose: Pose,
    backgrounds: Float[Tensor, "B 3 H W"] | None,
    light: Light | None,
    config: RendererConfig,
) -> Rendering:
    """Render a batch of textured meshes.

    Without a light the texture is shown as it is. Gradients flow to the vertices, the textures, the pose, the light
    and the backgrounds.
    """
    vertices_ndc = project(mesh.vertices, pose, config.camera)
    fragments = rasterize(vertices_ndc, mesh.faces, config.size * config.supersampling)
    directions = interpolate(mesh.directions.expand(len(vertices_ndc), -1, -1), mesh.faces, fragments)
    colors = sample_sphere_texture(texture_maps, directions)  # 0 where nothing is covered, as directions are
    if light is not None:
        reflected = shade(mesh.vertices, mesh.faces, light)[..., None]
        colors = colors * interpolate(reflected, mesh.faces, fragments).permute(0, 3, 1, 2)
    covered = (fragments.face_index >= 0).to(colors.dtype)[:, None]
    layers = antialias(torch.cat((colors, covered), dim=1), fragments, vertices_ndc, mesh.faces)
    layers = _pool(layers, config.supersampling)
    images, silhouettes = layers[:, :3], layers[:, 3]
    if backgrounds is not None:
        images = images + (1 - silhouettes)[:, None] * backgrounds
    return Rendering(images, silhouettes)


def _pool(layers: Float[Tensor, "B C H W"], factor: int) -> Float[Tensor, "B C H2 W2"]:
    """Average squares of samples; several times as fast on a CPU as PyTorch's pooling."""
    rows = reduce(torch.add, (layers[:, :, first::factor] for first in range(factor)))
    return reduce(torch.add, (rows[..., first::factor] for first in range(factor))) / factor**2
