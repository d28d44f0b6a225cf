"""Cutting a sphere-textured mesh open, so that every corner has one place in the flat texture."""

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

from pipeline.rendering.lighting import vertex_normals

ON_EDGE = 1e-5
"""Barycentric coordinates up to this count as 0: the pole lies on an edge or a corner."""


class UnwrappedMesh(NamedTuple):
    """A mesh whose vertices have texture coordinates; those on the cut stand twice."""

    vertices: Float[Tensor, "V 3"]
    normals: Float[Tensor, "V 3"]
    """Unit vectors, smooth across the cut."""
    uv: Float[Tensor, "V 2"]
    """u to the right, v down, (0, 0) in the upper left corner; across the cut u leaves [0, 1]: the texture repeats."""
    faces: Int[Tensor, "F 3"]


class Seam(NamedTuple):
    """How meshes of the same faces and directions are cut open, whatever their shapes."""

    faces: Int[Tensor, "F 3"]
    """Of the whole mesh."""
    mixture: Float[Tensor, "new_vertices V"]
    """How much of each vertex of the whole mesh is in each of its vertices and poles."""
    origins: Int[Tensor, " cut_vertices"]
    """Which of these each vertex of the cut mesh copies to the last bit, so that readers can join the copies."""
    uv: Float[Tensor, "cut_vertices 2"]
    cut_faces: Int[Tensor, "cut_faces 3"]

    def unwrap(self, vertices: Float[Tensor, "V 3"], texture_size: int) -> UnwrappedMesh:
        """Cut a mesh open for a texture of `texture_size` rows."""
        normals = vertex_normals(vertices[None], self.faces)[0]
        # The renderer repeats the outermost rows; a viewer that repeats the whole texture must not reach beyond them.
        margin = 0.5 / texture_size
        return UnwrappedMesh(
            (self.mixture @ vertices)[self.origins],
            functional.normalize(self.mixture @ normals, dim=1)[self.origins],
            torch.stack([self.uv[:, 0], self.uv[:, 1].clamp(margin, 1 - margin)], dim=1),
            self.cut_faces,
        )


def cut_open(faces: Int[Tensor, "F 3"], directions: Float[Tensor, "V 3"]) -> Seam:
    """Give each corner its place in an equirectangular texture, as the renderer samples it.

    The cut runs down the back (-z) from pole to pole. Faces around a pole are split there; in the texture each part has
    the pole above the middle of its base.
    """
    count, cut_faces = len(directions), faces
    mixture, directions = torch.eye(count), functional.normalize(directions, dim=1)
    for sign in (1.0, -1.0):
        mixture, directions, cut_faces = _split_at_pole(mixture, directions, cut_faces, sign)
    uv = _corner_uv(directions, cut_faces).flatten(0, 1)
    # Corners that agree in vertex and place in the texture are one vertex of the result.
    corners = torch.cat([cut_faces.flatten()[:, None], (uv * 2**20).round().long()], dim=1)
    kept, new_faces = corners.unique(dim=0, return_inverse=True)
    uv = uv.new_zeros(len(kept), 2).index_copy(0, new_faces, uv)
    return Seam(faces, mixture, kept[:, 0], uv, new_faces.view(-1, 3))


def _split_at_pole(
    mixture: Float[Tensor, "K V"], directions: Float[Tensor, "K 3"], faces: Int[Tensor, "F 3"], sign: float
) -> tuple[Float[Tensor, "new_vertices V"], Float[Tensor, "new_vertices 3"], Int[Tensor, "new_faces 3"]]:
    """Replace the faces that contain the direction (0, sign, 0) by their parts that meet in it, in one new vertex."""
    pole = directions.new_tensor([0.0, sign, 0.0])
    corners = directions[faces]
    facing = (corners @ pole).amax(dim=1) > 0
    weights = torch.linalg.solve(corners[facing].double().mT, pole.double().expand(int(facing.sum()), 3))
    weights = weights / weights.sum(dim=1, keepdim=True)
    # One face decides whether the pole lies on a corner or an edge, and its neighbours there go along.
    nearest = weights.amin(dim=1).nan_to_num(nan=-torch.inf).argmax()  # NaN where the face runs along the pole's line
    face = faces[facing][nearest]
    corners = face[weights[nearest] > ON_EDGE]
    around = torch.isin(faces, corners).sum(dim=1) == len(corners)
    parts = [torch.where(faces[around] == corner, len(directions), faces[around]) for corner in corners]
    middle = weights[nearest].to(mixture) @ mixture[face]
    new_faces = torch.cat([faces[~around], *parts])
    return torch.cat([mixture, middle[None]]), torch.cat([directions, pole[None]]), new_faces


def _corner_uv(directions: Float[Tensor, "K 3"], faces: Int[Tensor, "F 3"]) -> Float[Tensor, "F 3 2"]:
    corners = directions[faces]
    around = _turn(corners)
    middle = _turn(corners.sum(dim=1))[:, None]
    # Nearest the face's middle, whichever side of the cut that is.
    around = middle + torch.remainder(around - middle + 0.5, 1) - 0.5
    at_pole = corners[..., 1].abs() == 1
    others = (around * ~at_pole).sum(dim=1, keepdim=True) / (~at_pole).sum(dim=1, keepdim=True)
    upward = torch.atan2(corners[..., 1], corners[..., ::2].norm(dim=-1)) / torch.pi
    return torch.stack([torch.where(at_pole, others, around), 0.5 - upward], dim=-1)


def _turn(directions: Float[Tensor, "*N 3"]) -> Float[Tensor, "*N"]:
    """Return the column of directions as a share of the texture's width: the front (+z) is in the middle."""
    return 0.5 + torch.atan2(directions[..., 0], directions[..., 2]) / (2 * torch.pi)
