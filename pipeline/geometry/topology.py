"""Connectivity of closed triangle meshes."""

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.utils.weak import WeakTensorKeyDictionary

from pipeline.errors import MeshError


class Topology(NamedTuple):
    """Connectivity of a closed, consistently oriented mesh, computed once and shared by a batch.

    `edges` are unique with the lower vertex first, in lexicographic order. `edge_faces` are the two faces at each edge:
    the first one traverses it from the lower to the higher vertex. `opposite_vertices` are the third vertices of those
    two faces. `degrees` counts the edges at each vertex.
    """

    edges: Int[Tensor, "E 2"]
    edge_faces: Int[Tensor, "E 2"]
    opposite_vertices: Int[Tensor, "E 2"]
    degrees: Int[Tensor, " V"]


_derived = WeakTensorKeyDictionary()


def topology_of(faces: Int[Tensor, "F 3"]) -> Topology:
    """Derive the connectivity of a mesh; every index below the largest in `faces` is taken as a vertex.

    It is kept for as long as the tensor lives, because deriving it makes the host wait for a GPU: do not change faces
    in place. Raises MeshError unless every edge joins exactly two faces that traverse it in opposite directions.
    """
    if faces not in _derived:
        _derived[faces] = _derive(faces)
    return _derived[faces]


def _derive(faces: Int[Tensor, "F 3"]) -> Topology:
    if len(faces) == 0:
        raise MeshError("the mesh has no faces; expected at least one")
    vertex_count = int(faces.max()) + 1
    start, end, opposite = faces.flatten(), faces.roll(-1, dims=1).flatten(), faces.roll(-2, dims=1).flatten()
    key = torch.minimum(start, end) * vertex_count + torch.maximum(start, end)
    # Sorting by edge, then by direction, puts the two halves of each edge next to each other, the ascending one first.
    order = (2 * key + (start > end)).argsort()
    first, second = order[0::2], order[1::2]
    matched = len(order) % 2 == 0 and bool(
        ((start[first] == end[second]) & (end[first] == start[second]) & (start[first] < end[first])).all()
    )
    if not matched or len(torch.unique(key)) != len(first):
        raise MeshError(
            "the mesh is not closed: expected every edge to join two faces of one orientation; repair the mesh first"
        )
    edges = torch.stack([start[first], end[first]], dim=1)
    return Topology(
        edges=edges,
        edge_faces=torch.stack([first // 3, second // 3], dim=1),
        opposite_vertices=torch.stack([opposite[first], opposite[second]], dim=1),
        degrees=torch.bincount(edges.flatten(), minlength=vertex_count),
    )


def euler_characteristic(faces: Int[Tensor, "F 3"]) -> int:
    """Count vertices - edges + faces of a closed mesh: 2 for one of genus 0."""
    topology = topology_of(faces)
    return len(topology.degrees) - len(topology.edges) + len(faces)


def laplacian_matrix(faces: Int[Tensor, "F 3"]) -> Float[Tensor, "V V"]:
    """Return the graph Laplacian of a closed mesh: degrees on the diagonal, -1 for every edge."""
    topology = topology_of(faces)
    start, end = topology.edges.unbind(dim=1)
    laplacian = topology.degrees.float().diag()
    laplacian[start, end] = -1
    laplacian[end, start] = -1
    return laplacian


def polygon_areas(vertices: Float[Tensor, "*B V 3"], faces: Int[Tensor, "F 3"]) -> Float[Tensor, "*B F"]:
    """Measure the area of each face. Gradients flow to `vertices`."""
    # Indexing as such adds gradients in any order where there are many, so that bytes would change from run to run.
    a, b, c = vertices.index_select(-2, faces.flatten()).unflatten(-2, faces.shape).unbind(dim=-2)
    return torch.linalg.vector_norm(torch.linalg.cross(b - a, c - a), dim=-1) / 2
