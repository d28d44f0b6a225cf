"""Thickness of an object, from each vertex of its surface through to the other side."""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

_SLIT = 1e-4
"""Part of a face by which it reaches beyond its edges, where rounding could let a way through between two faces."""
_VERTICES_AT_ONCE = 128
"""Bounds the working memory to some ten megabytes a thousand faces."""


class FarSide(NamedTuple):
    """Hold what lies opposite each vertex: where the way inwards along its normal leaves the object.

    Where it leaves nowhere, because the surface passes through itself, the far side is the vertex itself.
    """

    inwards: Float[Tensor, "V 3"]
    """Unit vector of the way."""
    corners: Int[Tensor, "V 3"]
    """Vertices of the face where it leaves."""
    weights: Float[Tensor, "V 3"]
    """Barycentric coordinates of the point in that face, from 0 to 1 but for rounding."""


def far_side(vertices: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"], normals: Float[Tensor, "V 3"]) -> FarSide:
    """Find what lies opposite each vertex of a closed mesh with these outward unit normals."""
    inwards = -normals
    ways = torch.arange(len(vertices), device=faces.device).split(_VERTICES_AT_ONCE)
    found = [_first_exits(vertices, faces, vertex, inwards[vertex]) for vertex in ways]
    corners, weights = (torch.cat(parts) for parts in zip(*found, strict=True))
    return FarSide(inwards, corners, weights)


def thickness(vertices: Float[Tensor, "V 3"], far: FarSide) -> Float[Tensor, " V"]:
    """Measure how far the far side lies from each vertex along its way inwards; below 0 where they changed places.

    In the vertices' unit. Gradients flow to the vertices.
    """
    corners = vertices.index_select(0, far.corners.flatten()).unflatten(0, far.corners.shape)
    opposite = (corners * far.weights[..., None]).sum(dim=1)
    return ((opposite - vertices) * far.inwards).sum(dim=1)


def _first_exits(
    vertices: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"], start: Int[Tensor, " W"], way: Float[Tensor, "W 3"]
) -> tuple[Int[Tensor, "W 3"], Float[Tensor, "W 3"]]:
    """Intersect every way with every face (Moller & Trumbore 1997); return the nearest face it leaves through."""
    corner, first, second = vertices[faces].unbind(dim=1)
    first, second = first - corner, second - corner
    offset, way = vertices[start][:, None] - corner, way[:, None]
    across, over = torch.linalg.cross(way, second[None]), torch.linalg.cross(offset, first[None])
    determinant = (first * across).sum(-1)
    u, v = (offset * across).sum(-1) / determinant, (way * over).sum(-1) / determinant
    distance = (second * over).sum(-1) / determinant
    outwards = (way * torch.linalg.cross(first, second)).sum(-1) > 0
    inside = (u > -_SLIT) & (v > -_SLIT) & (u + v < 1 + _SLIT)
    left = outwards & inside & (distance > 0) & ~_touches(faces, start)
    nearest, face = torch.where(left, distance, torch.inf).min(dim=1, keepdim=True)
    weights = torch.cat([(1 - u - v).gather(1, face), u.gather(1, face), v.gather(1, face)], dim=1)
    somewhere = nearest.isfinite()
    corners = torch.where(somewhere, faces[face[:, 0]], start[:, None])
    return corners, torch.where(somewhere, weights, weights.new_tensor([1, 0, 0]))


def _touches(faces: Int[Tensor, "F 3"], start: Int[Tensor, " W"]) -> Bool[Tensor, "W F"]:
    return (faces[None] == start[:, None, None]).any(dim=-1)
