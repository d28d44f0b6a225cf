"""The rasteriser in tensor operations, for CUDA devices; it gives the same on any device."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from pipeline.geometry.camera import NEAREST_DEPTH
from pipeline.rendering.ragged import expand

CANDIDATES_AT_ONCE = 1 << 22
"""About how many pairs of a face and a pixel are tested in one go: a bound on memory."""


@torch.no_grad()
def nearest_faces(vertices_ndc: Float[Tensor, "B V 3"], faces: Int[Tensor, "F 3"], size: int) -> Int[Tensor, "B H W"]:
    """Return the nearest face at every pixel's centre, -1 in the background."""
    x, y, depth = vertices_ndc.double()[:, faces].flatten(0, 1).unbind(-1)
    x, y = size / 2 * (1 + x) - 0.5, size / 2 * (1 - y) - 0.5
    area = (x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (y[:, 1] - y[:, 0]) * (x[:, 2] - x[:, 0])
    drawn = (area != 0) & (depth.amin(dim=1) >= NEAREST_DEPTH)
    first_column, first_row = (t.amin(dim=1).ceil().clamp(0, size).long() for t in (x, y))
    last_column, last_row = (t.amax(dim=1).floor().clamp(-1, size - 1).long() for t in (x, y))
    width, height = (last_column + 1 - first_column).clamp(min=0), (last_row + 1 - first_row).clamp(min=0)
    pixel_count = torch.where(drawn, width * height, 0)
    nearest = torch.full((len(vertices_ndc) * size * size,), torch.iinfo(torch.int64).max, device=x.device)
    group_size = (pixel_count.cumsum(0) // CANDIDATES_AT_ONCE).unique_consecutive(return_counts=True)[1]
    for group in torch.arange(len(x), device=x.device).split(group_size.tolist()):
        owner, position = expand(pixel_count[group])
        owner = group[owner]
        column = first_column[owner] + position % width[owner]
        row = first_row[owner] + position // width[owner]
        to_x, to_y = x[owner] - column[:, None], y[owner] - row[:, None]
        opposite_area = _opposite_areas(to_x, to_y) / area[owner, None]
        inside = (opposite_area >= 0).all(dim=1)
        seen_depth = 1 / (opposite_area[inside] / depth[owner[inside]]).sum(dim=1)
        # Positive floats compare like their bits; below them the face's index breaks ties.
        key = seen_depth.float().view(torch.int32).long() << 32 | owner[inside] % len(faces)
        pixel = (owner[inside] // len(faces) * size + row[inside]) * size + column[inside]
        nearest.scatter_reduce_(0, pixel, key, "amin")
    face_index = torch.where(nearest == torch.iinfo(torch.int64).max, -1, nearest & 0xFFFFFFFF)
    return face_index.reshape(-1, size, size)


def barycentric_coordinates(
    vertices_ndc: Float[Tensor, "B V 3"], faces: Int[Tensor, "F 3"], face_index: Int[Tensor, "B H W"]
) -> Float[Tensor, "B H W 3"]:
    """Return perspective-correct barycentric coordinates of pixel centres on given faces, 0 in the background.

    Gradients flow to the vertices.
    """
    size = face_index.shape[1]
    picture, row, column = (face_index >= 0).nonzero(as_tuple=True)
    corners = vertices_ndc[picture[:, None], faces[face_index[picture, row, column]]]
    step = 2 / size
    to_x = corners[..., 0] - ((column.to(corners.dtype) + 0.5) * step - 1)[:, None]
    to_y = corners[..., 1] - (1 - (row.to(corners.dtype) + 0.5) * step)[:, None]
    weights = _opposite_areas(to_x, to_y) / corners[..., 2]
    weights = weights / weights.sum(dim=1, keepdim=True)
    background = vertices_ndc.new_zeros(*face_index.shape, 3)
    return background.index_put((picture, row, column), weights)


def _opposite_areas(to_x: Float[Tensor, "N 3"], to_y: Float[Tensor, "N 3"]) -> Float[Tensor, "N 3"]:
    """Return twice the areas of the triangles that a point spans with each corner's opposite edge."""
    return to_x.roll(-1, 1) * to_y.roll(-2, 1) - to_y.roll(-1, 1) * to_x.roll(-2, 1)
