"""Remeshing of mirror-symmetric surfaces into polygons of even size (paper 3.1.7)."""

from dataclasses import dataclass
from typing import NamedTuple

from jaxtyping import Float, Int
from torch import Tensor

from pipeline.errors import MeshError
from pipeline.geometry.halves import border_mask, cut_half, flatten_border, join_halves, split_chords
from pipeline.geometry.meshlab import isotropic_remeshing
from pipeline.geometry.sphere_map import SphereMapConfig, map_half_to_hemisphere
from pipeline.geometry.topology import euler_characteristic, polygon_areas


class MappedMesh(NamedTuple):
    """A closed mesh with a one-to-one map to the unit sphere, the domain of textures."""

    vertices: Float[Tensor, "V 3"]
    faces: Int[Tensor, "F 3"]
    directions: Float[Tensor, "V 3"]
    """Each vertex's point on the unit sphere."""


@dataclass(frozen=True)
class IsotropicConfig:
    """Settings of pymeshlab's isotropic explicit remeshing."""

    target_faces: int
    """Number of faces to aim at; the result is within some percent."""
    attempts: int
    """Trials of the edge length; the one nearest to the target is kept."""
    iterations: int
    """Rounds of splitting, collapsing, flipping, relaxing and projecting back."""
    feature_angle: float
    """Edges bent more than this are kept, in degrees: tips of limbs would wear off otherwise."""
    surface_tolerance: float
    """Largest deviation that a step may cause, in percent of the bounding box's diagonal."""


def remesh_isotropic(mesh: MappedMesh, isotropic: IsotropicConfig, sphere_map: SphereMapConfig) -> MappedMesh:
    """Make polygons even in size and shape and map the new mesh one-to-one to the sphere.

    One half is remeshed, mapped to a hemisphere and mirrored, so that the result is symmetric to the last bit in
    positions and directions. Raise MeshError when the input is not finite, closed, of genus 0 and symmetric.
    """
    check_surface(mesh)
    half_vertices, half_faces = cut_half(mesh.vertices.double(), mesh.faces, mesh.directions)
    attempts = _attempts(half_vertices, half_faces, isotropic)
    half_vertices, half_faces = min(attempts, key=lambda half: abs(2 * len(half[1]) - isotropic.target_faces))
    half_vertices, half_faces = split_chords(half_vertices, half_faces)
    half_vertices = flatten_border(half_vertices, border_mask(half_faces))
    half_directions = map_half_to_hemisphere(half_vertices, half_faces, sphere_map)
    vertices, faces = join_halves(half_vertices, half_faces)
    directions, _ = join_halves(half_directions, half_faces)
    remeshed = MappedMesh(vertices.float(), faces, directions.float())
    check_surface(remeshed)
    return remeshed


def check_surface(mesh: MappedMesh) -> None:
    """Raise MeshError unless the mesh is finite, closed and of genus 0."""
    if not (mesh.vertices.isfinite().all() and mesh.directions.isfinite().all()):
        raise MeshError(
            "the mesh has vertices that are not finite numbers: expected a base shape whose training converged"
        )
    if (characteristic := euler_characteristic(mesh.faces)) != 2:
        raise MeshError(
            f"the mesh has Euler characteristic {characteristic}, expected 2: one closed surface of genus 0"
        )


def _attempts(
    vertices: Float[Tensor, "W 3"], faces: Int[Tensor, "H 3"], config: IsotropicConfig
) -> list[tuple[Tensor, Tensor]]:
    """Remesh a disk several times, correcting the edge length by the number of faces it led to."""
    target = config.target_faces / 2
    edge_length = (polygon_areas(vertices, faces).sum().item() / target * 4 / 3**0.5) ** 0.5
    attempts = []
    for _ in range(config.attempts):
        attempts.append(
            isotropic_remeshing(
                vertices, faces, edge_length, config.iterations, config.feature_angle, config.surface_tolerance
            )
        )
        edge_length *= (len(attempts[-1][1]) / target) ** 0.5
    return attempts
