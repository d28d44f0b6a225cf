"""Remeshing of surfaces into polygons of even size (paper 3.1.7)."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from pipeline.errors import MeshError
from pipeline.geometry.halves import border_loop, cut_half, divide, join_halves, split_chords
from pipeline.geometry.mapped_mesh import MappedMesh, check_surface
from pipeline.geometry.meshlab import isotropic_remeshing
from pipeline.geometry.sphere_map import SphereMapConfig, map_to_sphere, solid_angles
from pipeline.geometry.symmetry import is_symmetric, mirror_index
from pipeline.geometry.topology import polygon_areas
from pipeline.ranges import Angle, Count, Positive

GRID = 4
"""Parts into which the sides of a face are divided to find nearest points, which say on which side a face is."""


@dataclass(frozen=True)
class IsotropicConfig:
    """Settings of pymeshlab's isotropic explicit remeshing."""

    target_faces: Count
    """Number of faces to aim at; the result is within some percent."""
    attempts: Count
    """Trials of the edge length; the one nearest to the target is kept."""
    iterations: Count
    """Rounds of splitting, collapsing, flipping, relaxing and projecting back."""
    feature_angle: Angle
    """Edges bent more than this are kept, in degrees: tips of limbs would wear off otherwise."""
    surface_tolerance: Positive
    """Largest deviation that a step may cause, in percent of the bounding box's diagonal."""


def remesh_isotropic(mesh: MappedMesh, isotropic: IsotropicConfig, sphere_map: SphereMapConfig) -> MappedMesh:
    """Make polygons even in size and shape and map the new mesh one-to-one to the sphere.

    A mirror-symmetric mesh stays so to the last bit, in positions and directions: one half is remeshed, mapped to a
    hemisphere and mirrored. Raises MeshError when the input is not finite, closed and of genus 0, or has no extent, and
    when rounding turns parts of the map over.
    """
    check_surface(mesh)
    symmetric = is_symmetric(mesh.vertices, mirror_index(mesh.directions))
    remeshed = (_remesh_half if symmetric else _remesh_whole)(mesh, isotropic, sphere_map)
    remeshed = MappedMesh(remeshed.vertices.float(), remeshed.faces, remeshed.directions.float())
    check_surface(remeshed)
    _require_one_to_one(remeshed)
    return remeshed


def _require_one_to_one(mesh: MappedMesh) -> None:
    flipped = int((solid_angles(mesh.directions.double(), mesh.faces) <= 0).sum())
    if flipped:
        raise MeshError(
            f"the map to the sphere turns {flipped} of {len(mesh.faces)} faces over; choose another "
            "remesh.isotropic.target_faces or more remesh.sphere_map.iterations"
        )


def _remesh_half(mesh: MappedMesh, isotropic: IsotropicConfig, sphere_map: SphereMapConfig) -> MappedMesh:
    vertices, faces = cut_half(mesh.vertices.double(), mesh.faces, mesh.directions)
    vertices, faces = _remesh(vertices, faces, isotropic.target_faces / 2, isotropic)
    vertices, faces = split_chords(vertices, faces)
    loop = border_loop(faces)
    side = torch.ones(len(vertices), dtype=torch.int64).index_fill(0, loop, 0)
    joined_vertices, joined_faces = join_halves(vertices, faces)
    directions = map_to_sphere(joined_vertices[: len(vertices)], faces, loop, side, sphere_map)
    return MappedMesh(joined_vertices, joined_faces, join_halves(directions, faces)[0])


def _remesh_whole(mesh: MappedMesh, isotropic: IsotropicConfig, sphere_map: SphereMapConfig) -> MappedMesh:
    vertices, faces = _remesh(mesh.vertices.double(), mesh.faces, isotropic.target_faces, isotropic)
    positive = divide(faces, _nearest_directions(vertices, mesh))
    vertices, right = split_chords(vertices, faces[positive])
    vertices, left = split_chords(vertices, faces[~positive])
    loop, faces = border_loop(right), torch.cat([right, left])
    side = torch.zeros(len(vertices), dtype=torch.int64)
    side = side.index_fill(0, right.unique(), 1).index_fill(0, left.unique(), -1).index_fill(0, loop, 0)
    return MappedMesh(vertices, faces, map_to_sphere(vertices, faces, loop, side, sphere_map))


def _nearest_directions(vertices: Float[Tensor, "V 3"], mesh: MappedMesh) -> Float[Tensor, "V 3"]:
    """Take each vertex's direction from the nearest of the points of a grid on every face."""
    steps = torch.cartesian_prod(torch.arange(GRID + 1), torch.arange(GRID + 1))
    steps = steps[steps.sum(dim=1) <= GRID] / GRID
    weights = torch.cat([1 - steps.sum(dim=1, keepdim=True), steps], dim=1).double()
    points, directions = (
        torch.einsum("gc,fcx->fgx", weights, values.double()[mesh.faces]).flatten(0, 1)
        for values in (mesh.vertices, mesh.directions)
    )
    return directions[torch.cdist(vertices, points).argmin(dim=1)]


def _remesh(
    vertices: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"], target: float, config: IsotropicConfig
) -> tuple[Float[Tensor, "new_vertices 3"], Int[Tensor, "new_faces 3"]]:
    """Remesh several times, correcting the edge length by the number of faces it led to, and keep the best."""
    edge_length = (polygon_areas(vertices, faces).sum().item() / target * 4 / 3**0.5) ** 0.5
    attempts = []
    for _ in range(config.attempts):
        attempts.append(
            isotropic_remeshing(
                vertices, faces, edge_length, config.iterations, config.feature_angle, config.surface_tolerance
            )
        )
        edge_length *= (len(attempts[-1][1]) / target) ** 0.5
    return min(attempts, key=lambda attempt: abs(len(attempt[1]) - target))
