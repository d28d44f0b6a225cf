"""Cutting a sphere-textured mesh open, so that every corner has one place in the flat texture."""

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from pipeline.rendering.lighting import vertex_normals

# Barycentric coordinates below this count as 0: the pole lies on an edge or a corner.
ON_EDGE = 1e-5


class UnwrappedMesh(NamedTuple):
    """A mesh whose vertices have texture coordinates; those on the cut stand twice."""

    vertices: Float[Tensor, "V 3"]
    normals: Float[Tensor, "V 3"]
    """Unit vectors, smooth across the cut."""
    uv: Float[Tensor, "V 2"]
    """u to the right, v down, (0, 0) in the upper left corner; across the cut u leaves [0, 1]: the texture repeats."""
    faces: Int[Tensor, "F 3"]


def unwrap(
    vertices: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"], directions: Float[Tensor, "V 3"], texture_size: int
) -> UnwrappedMesh:
    """Give each corner its place in an equirectangular texture of `texture_size` rows, as the renderer samples it.

    The cut runs down the back (-z) from pole to pole. Faces around a pole are split there, and each part gets a pole of
    its own, above the middle of its base.
    """
    normals = vertex_normals(vertices[None], faces)[0]
    attributes = torch.cat([vertices, normals, torch.nn.functional.normalize(directions, dim=1)], dim=1)
    for sign in (1.0, -1.0):
        attributes, faces = _split_at_pole(attributes, faces, sign)
    positions, normals, directions = attributes.split(3, dim=1)
    uv = _corner_uv(directions, faces, texture_size)
    # Corners that agree in vertex and place in the texture are one vertex of the result.
    corners = torch.cat([faces.flatten()[:, None], (uv.flatten(0, 1) * 2**20).round().long()], dim=1)
    kept, new_faces = corners.unique(dim=0, return_inverse=True)
    uv = uv.new_zeros(len(kept), 2).index_copy(0, new_faces, uv.flatten(0, 1))
    source = kept[:, 0]
    return UnwrappedMesh(
        positions[source], torch.nn.functional.normalize(normals[source], dim=1), uv, new_faces.view(-1, 3)
    )


def _split_at_pole(
    attributes: Float[Tensor, "V 9"], faces: Int[Tensor, "F 3"], sign: float
) -> tuple[Float[Tensor, "vertices 9"], Int[Tensor, "faces 3"]]:
    """Replace the faces that contain the direction (0, sign, 0) by their parts that meet in it."""
    pole = attributes.new_tensor([0.0, sign, 0.0])
    corners = attributes[:, 6:][faces]
    facing = (corners @ pole).amax(dim=1) > 0
    weights = torch.linalg.solve(corners[facing].double().mT, pole.double().expand(int(facing.sum()), 3))
    weights = weights / weights.sum(dim=1, keepdim=True)
    around = facing.nonzero()[:, 0][(weights > -ON_EDGE).all(dim=1)]
    new_faces = [faces[~torch.isin(torch.arange(len(faces)), around)]]
    for face, weight in zip(around, weights[(weights > -ON_EDGE).all(dim=1)].to(attributes), strict=True):
        middle = torch.cat([weight @ attributes[faces[face], :6], pole])
        for corner in (weight > ON_EDGE).nonzero()[:, 0]:
            new_faces.append(faces[face].index_fill(0, corner, len(attributes))[None])
            attributes = torch.cat([attributes, middle[None]])
    return attributes, torch.cat(new_faces)


def _corner_uv(
    directions: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"], texture_size: int
) -> Float[Tensor, "F 3 2"]:
    corners = directions[faces]
    around = _turn(corners)
    middle = _turn(corners.sum(dim=1))[:, None]
    # Nearest the face's middle, whichever side of the cut that is.
    around = middle + torch.remainder(around - middle + 0.5, 1) - 0.5
    at_pole = corners[..., 1].abs() == 1
    others = (around * ~at_pole).sum(dim=1, keepdim=True) / (~at_pole).sum(dim=1, keepdim=True)
    upward = torch.atan2(corners[..., 1], corners[..., ::2].norm(dim=-1)) / torch.pi
    # The renderer repeats the outermost rows; a viewer that repeats the whole texture must not reach beyond them.
    margin = 0.5 / texture_size
    return torch.stack([torch.where(at_pole, others, around), (0.5 - upward).clamp(margin, 1 - margin)], dim=-1)


def _turn(directions: Float[Tensor, "*N 3"]) -> Float[Tensor, "*N"]:
    """Return the column of directions as a share of the texture's width: the front (+z) is in the middle."""
    return 0.5 + torch.atan2(directions[..., 0], directions[..., 2]) / (2 * torch.pi)
