"""The renderer's operations once more in tensor operations, whose gradients are PyTorch's: an oracle for kernels."""

from math import pi

import torch
from jaxtyping import Float, Int
from torch import Tensor

from pipeline.geometry.camera import NEAREST_DEPTH
from pipeline.rendering.ragged import expand
from pipeline.rendering.rasterize import Fragments


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
    owner, position = expand(torch.where(drawn, width * height, 0))
    column = first_column[owner] + position % width[owner]
    row = first_row[owner] + position // width[owner]
    opposite_area = _opposite_areas(x[owner] - column[:, None], y[owner] - row[:, None]) / area[owner, None]
    inside = (opposite_area >= 0).all(dim=1)
    seen_depth = 1 / (opposite_area[inside] / depth[owner[inside]]).sum(dim=1)
    # Positive floats compare like their bits; below them the face's index breaks ties.
    key = seen_depth.float().view(torch.int32).long() << 32 | owner[inside] % len(faces)
    pixel = (owner[inside] // len(faces) * size + row[inside]) * size + column[inside]
    nearest = torch.full((len(vertices_ndc) * size * size,), torch.iinfo(torch.int64).max)
    nearest.scatter_reduce_(0, pixel, key, "amin")
    face_index = torch.where(nearest == torch.iinfo(torch.int64).max, -1, nearest & 0xFFFFFFFF)
    return face_index.reshape(-1, size, size)


def barycentric_coordinates(
    vertices_ndc: Float[Tensor, "B V 3"], faces: Int[Tensor, "F 3"], face_index: Int[Tensor, "B H W"]
) -> Float[Tensor, "B H W 3"]:
    """Return perspective-correct barycentric coordinates of pixel centres on given faces, 0 in the background."""
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


def interpolate(
    attributes: Float[Tensor, "B V C"], faces: Int[Tensor, "F 3"], fragments: Fragments
) -> Float[Tensor, "B H W C"]:
    """Interpolate attributes of vertices; the background gets 0."""
    picture, row, column = (fragments.face_index >= 0).nonzero(as_tuple=True)
    corners = attributes[picture[:, None], faces[fragments.face_index[picture, row, column]]]
    values = (fragments.barycentric[picture, row, column][..., None] * corners).sum(dim=1)
    background = attributes.new_zeros(*fragments.face_index.shape, attributes.shape[-1])
    return background.index_put((picture, row, column), values)


def sample_sphere_texture(
    texture_maps: Float[Tensor, "B 3 T T"], directions: Float[Tensor, "B H W 3"]
) -> Float[Tensor, "B 3 H W"]:
    """Look up equirectangular maps along directions, bilinearly; the zero direction is black."""
    size = texture_maps.shape[-1]
    x, y, z = directions.unbind(-1)
    around = torch.atan2(x, z) / pi
    upward = torch.atan2(y, (x * x + z * z + 1e-12).sqrt()) * 2 / pi
    wrapped = torch.cat((texture_maps[..., -1:], texture_maps, texture_maps[..., :1]), dim=-1)
    grid = torch.stack((around * size / (size + 2), -upward), dim=-1)
    colors = torch.nn.functional.grid_sample(wrapped, grid, padding_mode="border", align_corners=False)
    return colors * directions.any(dim=-1)[:, None]


def _opposite_areas(to_x: Float[Tensor, "N 3"], to_y: Float[Tensor, "N 3"]) -> Float[Tensor, "N 3"]:
    """Return twice the areas of the triangles that a point spans with each corner's opposite edge."""
    return to_x.roll(-1, 1) * to_y.roll(-2, 1) - to_y.roll(-1, 1) * to_x.roll(-2, 1)
