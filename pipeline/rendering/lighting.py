"""Directional light with smooth shading (paper 3.1.6)."""

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor


class Light(NamedTuple):
    """Hold one distant light and the ambient light for each picture."""

    direction: Float[Tensor, "B 3"]
    """Unit vector from the object towards the light, in world axes."""
    ambient: Float[Tensor, "B"]
    """Intensity that reaches every surface."""
    directional: Float[Tensor, "B"]
    """Intensity that a surface facing the light gets on top."""


def vertex_normals(vertices: Float[Tensor, "B V 3"], faces: Int[Tensor, "F 3"]) -> Float[Tensor, "B V 3"]:
    """Return unit normals at the vertices: the mean of the touching faces' normals weighted by area."""
    first, second, third = vertices[:, faces].unbind(2)
    face_normals = torch.linalg.cross(second - first, third - first)
    normals = torch.zeros_like(vertices)
    for corner in faces.unbind(1):
        normals = normals.index_add(1, corner, face_normals)
    return torch.nn.functional.normalize(normals, dim=-1)


def shade(vertices: Float[Tensor, "B V 3"], faces: Int[Tensor, "F 3"], light: Light) -> Float[Tensor, "B V"]:
    """Return the light that each vertex reflects; interpolated over the faces it gives smooth shading.

    Gradients flow to the vertices and to the light.
    """
    cosine = (vertex_normals(vertices, faces) * light.direction[:, None]).sum(dim=-1)
    return light.ambient[:, None] + light.directional[:, None] * cosine.clamp(min=0)
