"""The renderer's operations once more in tensor operations, whose gradients are PyTorch's: an oracle for kernels."""

from math import pi
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from pipeline.geometry.camera import NEAREST_DEPTH
from pipeline.geometry.topology import topology_of
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
    owner, position = _expand(torch.where(drawn, width * height, 0))
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


def antialias(
    colors: Float[Tensor, "B C H W"],
    fragments: Fragments,
    vertices_ndc: Float[Tensor, "B V 3"],
    faces: Int[Tensor, "F 3"],
) -> Float[Tensor, "B C H W"]:
    """Blend the pixels on both sides of visible silhouette edges by the area that the edges cut off."""
    size = colors.shape[-1]
    crossings = _find_crossings(_silhouette_edges(vertices_ndc, faces, size), size)
    depth_inside, depth_outside = (
        _depth_at(pixels, fragments, vertices_ndc, faces) for pixels in (crossings.inside, crossings.outside)
    )
    visible = depth_outside > torch.maximum(depth_inside, crossings.depth)
    inside, outside, excess = _outermost(crossings, visible, colors[:, 0].numel())
    target, source = torch.where(excess > 0, outside, inside), torch.where(excess > 0, inside, outside)
    share = excess.abs()
    # Several edges may cut one pixel, as at corners and thin parts: together they take no more than all of it.
    taken = share.new_zeros(colors[:, 0].numel()).index_add(0, target, share)
    share = share / taken[target].clamp(min=1)
    return _blend(colors, target, source, share)


def _opposite_areas(to_x: Float[Tensor, "N 3"], to_y: Float[Tensor, "N 3"]) -> Float[Tensor, "N 3"]:
    """Return twice the areas of the triangles that a point spans with each corner's opposite edge."""
    return to_x.roll(-1, 1) * to_y.roll(-2, 1) - to_y.roll(-1, 1) * to_x.roll(-2, 1)


class _Edges(NamedTuple):
    """Silhouette edges in pixel units. The axes are called along (the one an edge is longer in) and across."""

    picture: Int[Tensor, " E"]
    start: Float[Tensor, "E 3"]
    """Across, along, depth; along and across are 0 at the first pixel's centre."""
    end: Float[Tensor, "E 3"]
    sideways: Bool[Tensor, " E"]
    """Whether along is the horizontal axis."""
    inside_first: Bool[Tensor, " E"]
    """Whether the object lies on the side of the smaller coordinate across."""


class _Crossings(NamedTuple):
    """Places where a silhouette edge passes between the centres of neighbouring pixels."""

    inside: Int[Tensor, " N"]
    """The pixel on the object's side, counted through all pictures."""
    outside: Int[Tensor, " N"]
    excess: Float[Tensor, " N"]
    """How far the object reaches beyond the border between the two pixels, in [-.5, .5] pixels."""
    depth: Float[Tensor, " N"]
    """Depth of the edge."""


def _silhouette_edges(vertices_ndc: Float[Tensor, "B V 3"], faces: Int[Tensor, "F 3"], size: int) -> _Edges:
    topology = topology_of(faces)
    outside = _seen_from_outside(vertices_ndc.detach(), faces)
    first_outside, second_outside = (outside.index_select(0, topology.edge_faces[:, k]) for k in range(2))
    behind = vertices_ndc[..., 2].T < NEAREST_DEPTH
    first_behind, second_behind = (behind.index_select(0, topology.edges[:, k]) for k in range(2))
    turning = (first_outside != second_outside) & ~(first_behind | second_behind)
    edge, picture = turning.nonzero(as_tuple=True)
    x, y, depth = _corners(vertices_ndc, picture, topology.edges[edge]).unbind(-1)
    column, row = size / 2 * (1 + x) - 0.5, size / 2 * (1 - y) - 0.5
    rightwards, downwards = (column[:, 1] - column[:, 0]).detach(), (row[:, 1] - row[:, 0]).detach()
    sideways = rightwards.abs() > downwards.abs()
    across, along = torch.where(sideways[:, None], row, column), torch.where(sideways[:, None], column, row)
    start, end = torch.stack((across, along, depth), dim=-1).unbind(1)
    # The first face traverses the edge from start to end, so seen from outside it lies to the left.
    left_is_first = torch.where(sideways, rightwards > 0, downwards < 0)
    return _Edges(picture, start, end, sideways, left_is_first == first_outside[edge, picture])


def _seen_from_outside(vertices_ndc: Float[Tensor, "B V 3"], faces: Int[Tensor, "F 3"]) -> Bool[Tensor, "F B"]:
    """Return whether corners run counter-clockwise in the picture."""
    x, y, _ = vertices_ndc.permute(2, 1, 0).contiguous()
    first, second, third = faces.unbind(1)
    (ax, ay), (bx, by) = (
        (x.index_select(0, end) - x.index_select(0, first), y.index_select(0, end) - y.index_select(0, first))
        for end in (second, third)
    )
    return ax * by > ay * bx


def _find_crossings(edges: _Edges, size: int) -> _Crossings:
    lowest, highest = (
        extreme(edges.start[:, 1], edges.end[:, 1]).detach() for extreme in (torch.minimum, torch.maximum)
    )
    first_line = lowest.ceil().clamp(min=0).long()
    line_count = (highest.ceil().clamp(max=size).long() - first_line).clamp(min=0)
    edge, position = _expand(line_count)
    line = first_line[edge] + position
    start, end = edges.start[edge], edges.end[edge]
    portion = (line - start[:, 1]) / (end[:, 1] - start[:, 1])
    across = torch.lerp(start[:, 0], end[:, 0], portion)
    depth = 1 / torch.lerp(1 / start[:, 2], 1 / end[:, 2], portion).detach()
    pixel = across.detach().floor().long()
    inside_first, sideways = edges.inside_first[edge], edges.sideways[edge]
    excess = torch.where(inside_first, 1, -1) * (across - pixel - 0.5)
    step = torch.where(sideways, size, 1)
    before = edges.picture[edge] * size**2 + torch.where(sideways, line, line * size) + pixel * step
    crossings = _Crossings(before + step * ~inside_first, before + step * inside_first, excess, depth)
    within = (pixel >= 0) & (pixel < size - 1)
    return _Crossings(*(value[within] for value in crossings))


def _outermost(
    crossings: _Crossings, visible: Bool[Tensor, " N"], pixel_count: int
) -> tuple[Int[Tensor, " M"], Int[Tensor, " M"], Float[Tensor, " M"]]:
    """Keep the visible crossing that reaches farthest between each two pixels: others lie in front of the object."""
    inside, outside, excess = crossings.inside[visible], crossings.outside[visible], crossings.excess[visible]
    sideways = (inside - outside).abs() > 1
    pair = torch.minimum(inside, outside) + pixel_count * sideways
    farthest = excess.new_full((2 * pixel_count,), -1).scatter_reduce(0, pair, excess.detach(), "amax")
    kept = excess.detach() == farthest[pair]
    return inside[kept], outside[kept], excess[kept]


def _corners(
    values: Float[Tensor, "B V C"], picture: Int[Tensor, " N"], vertices: Int[Tensor, "N K"]
) -> Float[Tensor, "N K C"]:
    """Return what some vertices of some pictures have; one flat index is several times faster than two."""
    places = (picture * values.shape[1])[:, None] + vertices
    return values.flatten(0, 1).index_select(0, places.flatten()).view(*places.shape, values.shape[-1])


@torch.no_grad()
def _depth_at(
    pixels: Int[Tensor, " N"], fragments: Fragments, vertices_ndc: Float[Tensor, "B V 3"], faces: Int[Tensor, "F 3"]
) -> Float[Tensor, " N"]:
    """Return the depth that pixels show, infinite in the background."""
    face = fragments.face_index.flatten().index_select(0, pixels)
    picture = pixels // fragments.face_index[0].numel()
    corner_depth = _corners(vertices_ndc[..., 2:], picture, faces.index_select(0, face.clamp(min=0))).squeeze(-1)
    depth = (corner_depth * fragments.barycentric.flatten(0, 2).index_select(0, pixels)).sum(dim=1)
    return depth.masked_fill(face < 0, torch.inf)


def _blend(
    colors: Float[Tensor, "B C H W"], target: Int[Tensor, " N"], source: Int[Tensor, " N"], share: Float[Tensor, " N"]
) -> Float[Tensor, "B C H W"]:
    """Move each target pixel towards its source pixel by a share of their difference."""
    channels, pixel_count = colors.shape[1], colors[0, 0].numel()
    channel = torch.arange(channels, device=colors.device) * pixel_count
    places = torch.stack((target, source))
    places = (places // pixel_count * channels * pixel_count + places % pixel_count)[..., None] + channel
    values = colors.flatten()
    target_value, source_value = values.index_select(0, places.flatten()).view_as(places)
    change = share[:, None] * (source_value - target_value)
    return values.index_add(0, places[0].flatten(), change.flatten()).view_as(colors)


def _expand(counts: Int[Tensor, " N"]) -> tuple[Int[Tensor, " M"], Int[Tensor, " M"]]:
    """Return owner and position of every member of lists with the given lengths, list after list."""
    owner = torch.arange(len(counts), device=counts.device).repeat_interleave(counts)
    first = counts.cumsum(0) - counts
    return owner, torch.arange(len(owner), device=counts.device) - first[owner]
