"""The sphere that base shapes deform, and its mirror symmetry."""

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from pipeline.geometry.icosphere import icosphere
from pipeline.geometry.symmetry import mirror_index


class Sphere(NamedTuple):
    """The icosphere that base shapes deform."""

    directions: Float[Tensor, "V 3"]
    """Unit vectors, the texture domain."""
    faces: Int[Tensor, "F 3"]
    """Counter-clockwise from outside."""
    mirror: Int[Tensor, " V"]
    """Index of each vertex's mirror image about x = 0."""


def build_sphere(subdivisions: int, device: torch.device) -> Sphere:
    """Build the icosphere and find each vertex's mirror image."""
    directions, faces = icosphere(subdivisions)
    directions, faces = directions.to(device), faces.to(device)
    return Sphere(directions, faces, mirror_index(directions))
