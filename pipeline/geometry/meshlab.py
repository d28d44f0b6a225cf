"""The two filters of MeshLab that the pipeline uses."""

# pyright: reportAttributeAccessIssue=false
# pymeshlab is a compiled module that ships no type stubs.

import ctypes
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from threading import Event, Thread

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

_M_PERTURB = -6
"""Option of glibc's `mallopt`: fresh memory is filled with the complement of its value, unless that is 0."""


@contextmanager
def _filled_memory() -> Iterator[None]:
    """Let fresh memory hold no zeros, where glibc manages it."""
    fill = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if fill is not None:
        fill(_M_PERTURB, 85)
    try:
        yield
    finally:
        if fill is not None:
            fill(_M_PERTURB, 0)


def _import_and_stay(imported: Event) -> None:
    try:
        with suppress(ImportError):  # which is raised again below
            import_module("pymeshlab")
    finally:
        imported.set()
    Event().wait()


# Release 2025.7 never sets a flag that it reads: where the memory it gets at its import holds zeros, isotropic
# remeshing forgets the surface tolerance. glibc does not fill memory that a thread gets back from its own cache, so the
# import runs in a new thread, whose cache is empty. That thread stays: Qt frees what it keeps of a thread when the
# thread ends, and MeshLab's plugins use it once more when the process does.
with _filled_memory():
    _imported = Event()
    Thread(target=_import_and_stay, args=(_imported,), daemon=True).start()
    _imported.wait()
    import pymeshlab


def isotropic_remeshing(
    vertices: Float[Tensor, "V 3"],
    faces: Int[Tensor, "F 3"],
    edge_length: float,
    iterations: int,
    feature_angle: float,
    surface_tolerance: float,
) -> tuple[Float[Tensor, "new_vertices 3"], Int[Tensor, "new_faces 3"]]:
    """Split, collapse, flip, relax and project back until edges are about `edge_length` long.

    Borders stay borders. Edges bent more than `feature_angle` degrees are kept; no step may move the surface by more
    than `surface_tolerance` percent of the diagonal.
    """
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(_mesh(vertices, faces))
    meshes.meshing_isotropic_explicit_remeshing(
        iterations=iterations,
        targetlen=pymeshlab.PureValue(edge_length),
        featuredeg=feature_angle,
        maxsurfdist=pymeshlab.PercentageValue(surface_tolerance),
    )
    result = meshes.current_mesh()
    return torch.from_numpy(result.vertex_matrix().copy()), torch.from_numpy(result.face_matrix().astype(np.int64))


def one_sided_distance(
    sampled: tuple[Float[Tensor, "V 3"], Int[Tensor, "F 3"]],
    target: tuple[Float[Tensor, "target_vertices 3"], Int[Tensor, "target_faces 3"]],
) -> dict[str, float]:
    """Measure how far one surface strays from another: `max` and `mean` over the samples.

    Samples are the corners after every edge of the sampled mesh was split in two, twice: 16 times as many polygons.
    """
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(_mesh(*target))
    meshes.add_mesh(_mesh(*sampled))
    meshes.meshing_surface_subdivision_midpoint(iterations=2, threshold=pymeshlab.PureValue(0))
    result = meshes.get_hausdorff_distance(sampledmesh=1, targetmesh=0, maxdist=pymeshlab.PercentageValue(100))
    return {"max": result["max"], "mean": result["mean"]}


def _mesh(vertices: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"]) -> pymeshlab.Mesh:
    return pymeshlab.Mesh(vertices.double().numpy(), faces.int().numpy())
