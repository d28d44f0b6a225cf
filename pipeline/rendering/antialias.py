"""Antialiasing of silhouettes, which is also where the gradients of silhouettes come from.

Where a silhouette edge passes between the centres of two neighbouring pixels, one of the two is blended with the other
by the area that the edge cuts off. This is the idea of nvdiffrast (Laine et al. 2020, section 3.5), but it walks along
the silhouette edges instead of starting at pixels: at 32 pixels most faces at a silhouette cover no pixel's centre.
"""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from pipeline.geometry.camera import NEAREST_DEPTH
from pipeline.geometry.topology import topology_of
from pipeline.rendering.ragged import expand
from pipeline.rendering.rasterize import Fragments


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


def antialias(
    colors: Float[Tensor, "B C H W"],
    fragments: Fragments,
    vertices_ndc: Float[Tensor, "B V 3"],
    faces: Int[Tensor, "F 3"],
) -> Float[Tensor, "B C H W"]:
    """Blend the pixels on both sides of visible silhouette edges by the area that the edges cut off.

    An edge is a silhouette where it joins a face seen from outside to one seen from inside. It is visible where its
    outer pixel shows something farther away. Gradients flow to the colors and, through where the edges are, to the
    vertices. Raise MeshError if the mesh is not closed.
    """
    if colors.is_cuda:
        from pipeline.rendering import antialias_triton

        return antialias_triton.antialias(colors, *fragments, vertices_ndc, faces)
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
    edge, position = expand(line_count)
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
