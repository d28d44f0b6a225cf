"""Directional light with smooth shading (paper 3.1.5)."""

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional


class Light(NamedTuple):
    """Hold one distant light and the ambient light for each picture."""

    direction: Float[Tensor, "B 3"]
    """Unit vector from the object towards the light, in world axes."""
    ambient: Float[Tensor, " B"]
    """Intensity that reaches every surface."""
    directional: Float[Tensor, " B"]
    """Intensity that a surface facing the light gets on top."""


def vertex_normals(vertices: Float[Tensor, "B V 3"], faces: Int[Tensor, "F 3"]) -> Float[Tensor, "B V 3"]:
    """Return unit normals at the vertices: the mean of the touching faces' normals weighted by area."""
    batch, count, _ = vertices.shape
    # One contiguous row a vertex makes gathering several times faster.
    rows = vertices.transpose(0, 1).reshape(count, -1)
    first, second, third = (rows.index_select(0, corner).view(-1, batch, 3) for corner in faces.unbind(1))
    face_normals = torch.linalg.cross(second - first, third - first).flatten(1)
    normals = torch.zeros_like(rows)
    for corner in faces.unbind(1):
        normals = normals.index_add(0, corner, face_normals)
    return functional.normalize(normals.view(count, batch, 3).transpose(0, 1), dim=-1)


def shade(vertices: Float[Tensor, "B V 3"], faces: Int[Tensor, "F 3"], light: Light) -> Float[Tensor, "B V"]:
    """Return the light that each vertex reflects; interpolated over the faces it gives smooth shading.

    Gradients flow to the vertices and to the light.
    """
    cosine = (vertex_normals(vertices, faces) * light.direction[:, None]).sum(dim=-1)
    return light.ambient[:, None] + light.directional[:, None] * cosine.clamp(min=0)
