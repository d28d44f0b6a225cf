"""Textures on the sphere of directions, stored as equirectangular maps."""

from math import pi

import torch
from jaxtyping import Float
from torch import Tensor


def equirectangular_coordinates(directions: Float[Tensor, "*N 3"]) -> tuple[Float[Tensor, "*N"], Float[Tensor, "*N"]]:
    """Return u and v in [0, 1] of directions of any length: u = .5 is the front (+z), .75 is +x, v = 0 is up (+y)."""
    x, y, z = directions.unbind(-1)
    around = torch.atan2(x, z)
    upward = torch.atan2(y, (x * x + z * z + 1e-12).sqrt())
    return 0.5 + around / (2 * pi), 0.5 - upward / pi


def sample_sphere_texture(
    texture_maps: Float[Tensor, "B 3 T T"], directions: Float[Tensor, "B H W 3"]
) -> Float[Tensor, "B 3 H W"]:
    """Look up equirectangular maps along directions, bilinearly.

    Columns wrap around, so there is no seam; rows end at the poles. Directions need no unit length.
    Gradients flow to the maps and to the directions.
    """
    size = texture_maps.shape[-1]
    u, v = equirectangular_coordinates(directions)
    wrapped = torch.cat((texture_maps[..., -1:], texture_maps, texture_maps[..., :1]), dim=-1)
    grid = torch.stack(((2 * u - 1) * size / (size + 2), 2 * v - 1), dim=-1)
    return torch.nn.functional.grid_sample(wrapped, grid, mode="bilinear", padding_mode="border", align_corners=False)
