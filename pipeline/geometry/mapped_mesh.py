"""Meshes that are mapped to the unit sphere."""

from typing import NamedTuple

from jaxtyping import Float, Int
from torch import Tensor

from pipeline.errors import MeshError
from pipeline.geometry.topology import euler_characteristic, polygon_areas

SMALLEST_AREA = 1e-4
"""Share of the squared diagonal below which there is no surface to speak of; a sphere has about 1."""


class MappedMesh(NamedTuple):
    """A closed mesh with a one-to-one map to the unit sphere, the domain of textures."""

    vertices: Float[Tensor, "V 3"]
    faces: Int[Tensor, "F 3"]
    directions: Float[Tensor, "V 3"]
    """Each vertex's point on the unit sphere."""


def check_surface(mesh: MappedMesh) -> None:
    """Raise MeshError unless the mesh is finite, closed, of genus 0 and more than a line or a point."""
    if not (mesh.vertices.isfinite().all() and mesh.directions.isfinite().all()):
        raise MeshError(
            "the mesh has vertices that are not finite numbers: expected a base shape whose training converged"
        )
    if (characteristic := euler_characteristic(mesh.faces)) != 2:
        raise MeshError(
            f"the mesh has Euler characteristic {characteristic}, expected 2: one closed surface of genus 0"
        )
    diagonal = (mesh.vertices.amax(dim=0) - mesh.vertices.amin(dim=0)).norm()
    if polygon_areas(mesh.vertices, mesh.faces).sum() <= SMALLEST_AREA * diagonal.square():
        raise MeshError("the mesh has collapsed to a line or a point: expected a base shape whose training converged")
