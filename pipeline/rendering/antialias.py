"""Antialiasing of silhouettes, which is also where the gradients of silhouettes come from."""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from pipeline.geometry.topology import topology_of
from pipeline.rendering.rasterize import Fragments


class Edges(NamedTuple):
    """List silhouette edges of all pictures in pixel units, with axes such that each is steeper than it is wide."""

    picture: Int[Tensor, "E"]
    start: Float[Tensor, "E 3"]
    """Across, along (the steeper axis) and depth."""
    end: Float[Tensor, "E 3"]
    transposed: Bool[Tensor, "E"]
    """Whether the steeper axis is horizontal."""
    inside_low: Bool[Tensor, "E"]
    """Whether the object lies towards lower coordinates across the edge."""


def silhouette_edges(vertices_ndc: Float[Tensor, "B V 3"], faces: Int[Tensor, "F 3"], size: int) -> Edges:
    """Return the edges that join a face seen from outside to a face seen from inside."""
    topology = topology_of(faces)
    half = size / 2
    column = half * (1 + vertices_ndc[..., 0]) - 0.5
    row = half * (1 - vertices_ndc[..., 1]) - 0.5
    vertices = torch.stack((column, row, vertices_ndc[..., 2]), dim=-1)
    first, second, third = vertices.detach()[:, faces, :2].unbind(2)
    outside = _cross(second - first, third - first) < 0  # rows grow downwards
    picture, edge = (outside[:, topology.edge_faces[:, 0]] != outside[:, topology.edge_faces[:, 1]]).nonzero(
        as_tuple=True
    )
    corners = vertices[picture[:, None], topology.edges[edge]]
    start, end = corners.unbind(1)
    extent = (end - start).detach()
    transposed = extent[:, 0].abs() > extent[:, 1].abs()
    # The first face traverses the edge from start to end and lies on its left where it is seen from outside.
    left_inside = outside[picture, topology.edge_faces[edge, 0]]
    upwards = torch.where(transposed, extent[:, 0] > 0, extent[:, 1] < 0)
    inside_low = left_inside == upwards
    swap = torch.tensor([1, 0, 2], device=vertices.device)
    start = torch.where(transposed[:, None], start[:, swap], start)
    end = torch.where(transposed[:, None], end[:, swap], end)
    return Edges(picture, start, end, transposed, inside_low)


def antialias(
    colors: Float[Tensor, "B C H W"],
    fragments: Fragments,
    vertices_ndc: Float[Tensor, "B V 3"],
    faces: Int[Tensor, "F 3"],
) -> Float[Tensor, "B C H W"]:
    size = colors.shape[-1]
    edges = silhouette_edges(vertices_ndc, faces, size)
    low = torch.minimum(edges.start[:, 1], edges.end[:, 1]).detach()
    high = torch.maximum(edges.start[:, 1], edges.end[:, 1]).detach()
    first_line = low.ceil().clamp(min=0).long()
    line_count = (high.ceil().clamp(max=size).long() - first_line).clamp(min=0)
    index = torch.arange(len(low), device=low.device).repeat_interleave(line_count)
    offset = torch.arange(len(index), device=low.device) - (line_count.cumsum(0) - line_count)[index]
    line = first_line[index] + offset
    start, end = edges.start[index], edges.end[index]
    portion = (line - start[:, 1]) / (end[:, 1] - start[:, 1])
    across = start[:, 0] + portion * (end[:, 0] - start[:, 0])
    low_pixel = across.detach().floor().long()
    within = (low_pixel >= 0) & (low_pixel + 1 < size)
    index, line, across, low_pixel, portion = (t[within] for t in (index, line, across, low_pixel, portion))
    start, end = start[within], end[within]
    inside_low, transposed = edges.inside_low[index], edges.transposed[index]
    excess = across - low_pixel - 0.5
    excess = torch.where(inside_low, excess, -excess)
    inside_pixel = low_pixel + (~inside_low)
    outside_pixel = low_pixel + inside_low
    flat = lambda pixel: (
        edges.picture[index] * size * size + torch.where(transposed, pixel * size + line, line * size + pixel)
    )
    inside_pixel, outside_pixel = flat(inside_pixel), flat(outside_pixel)
    # depth
    with torch.no_grad():
        depth_edge = 1 / ((1 - portion) / start[:, 2] + portion / end[:, 2])
        face = fragments.face_index.flatten()[outside_pixel]
        corner_depth = vertices_ndc[edges.picture[index][:, None], faces[face], 2]
        depth_outside = (corner_depth * fragments.barycentric.flatten(0, 2)[outside_pixel]).sum(1)
        visible = (face < 0) | (depth_edge < depth_outside)
    excess, inside_pixel, outside_pixel = excess[visible], inside_pixel[visible], outside_pixel[visible]
    target = torch.where(excess > 0, outside_pixel, inside_pixel)
    source = torch.where(excess > 0, inside_pixel, outside_pixel)
    pixels = colors.permute(0, 2, 3, 1).flatten(0, 2)
    change = excess.abs()[:, None] * (pixels[source] - pixels[target])
    pixels = pixels.index_add(0, target, change)
    return pixels.reshape(*fragments.face_index.shape, -1).permute(0, 3, 1, 2)


def _cross(first: Float[Tensor, "*N 2"], second: Float[Tensor, "*N 2"]) -> Float[Tensor, "*N"]:
    return first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]
