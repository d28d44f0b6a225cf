"""Rasterisation: which face each pixel shows, and where on that face."""

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor


class Fragments(NamedTuple):
    """Say what each pixel's centre sees."""

    face_index: Int[Tensor, "B H W"]
    """The nearest face, -1 where there is background."""
    barycentric: Float[Tensor, "B H W 3"]
    """Perspective-correct weights of that face's corners, summing to 1; 0 in the background."""


def pixel_centers(size: int, like: Tensor) -> Float[Tensor, "H W 2"]:
    """Return the ndc of every pixel's centre; row 0 is the top."""
    steps = (2 * torch.arange(size, dtype=like.dtype, device=like.device) + 1) / size - 1
    return torch.stack(torch.meshgrid(steps, -steps, indexing="xy"), dim=-1)


def barycentric_coordinates(
    vertices_ndc: Float[Tensor, "B V 3"], faces: Int[Tensor, "F 3"], face_index: Int[Tensor, "B H W"]
) -> Float[Tensor, "B H W 3"]:
    """Return perspective-correct barycentric coordinates of pixel centres on given faces, 0 in the background."""
    picture, row, column = (face_index >= 0).nonzero(as_tuple=True)
    centers = pixel_centers(face_index.shape[1], vertices_ndc)[row, column]
    corners = vertices_ndc[picture[:, None], faces[face_index[picture, row, column]]]
    to_corner = corners[..., :2] - centers[:, None]
    following, preceding = to_corner.roll(-1, dims=1), to_corner.roll(-2, dims=1)
    opposite_area = following[..., 0] * preceding[..., 1] - following[..., 1] * preceding[..., 0]
    weights = opposite_area / corners[..., 2]
    weights = weights / weights.sum(dim=1, keepdim=True)
    result = vertices_ndc.new_zeros(*face_index.shape, 3)
    return result.index_put((picture, row, column), weights)


def rasterize(vertices_ndc: Float[Tensor, "B V 3"], faces: Int[Tensor, "F 3"], size: int) -> Fragments:
    """Find the nearest face at every pixel's centre of a size x size picture.

    Both sides of a face are seen. Faces with a corner behind the camera and faces without area are left out.
    Gradients flow from the barycentric coordinates to the vertices.
    """
    with torch.no_grad():
        if vertices_ndc.is_cuda:
            from pipeline.rendering.rasterize_torch import nearest_faces

            face_index = nearest_faces(vertices_ndc, faces, size)
        else:
            from pipeline.rendering import rasterize_cpu

            face_index = torch.from_numpy(rasterize_cpu.nearest_faces(vertices_ndc.numpy(), faces.numpy(), size))
    return Fragments(face_index, barycentric_coordinates(vertices_ndc, faces, face_index))
