import pytest
import torch
from torch import Tensor

from pipeline.errors import MeshError
from pipeline.geometry.icosphere import icosphere
from pipeline.geometry.topology import euler_characteristic, polygon_areas, topology_of

TETRAHEDRON = torch.tensor([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])


def test_edges_of_tetrahedron() -> None:
    topology = topology_of(TETRAHEDRON)
    assert topology.edges.tolist() == [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]
    assert topology.degrees.tolist() == [3, 3, 3, 3]


def test_faces_and_opposite_vertices_belong_to_their_edge() -> None:
    _, faces = icosphere(2)
    topology = topology_of(faces)
    for side in range(2):
        corners = torch.cat([topology.edges, topology.opposite_vertices[:, side : side + 1]], dim=1)
        assert torch.equal(corners.sort(dim=1).values, faces[topology.edge_faces[:, side]].sort(dim=1).values)


def test_sphere_has_euler_characteristic_two() -> None:
    _, faces = icosphere(3)
    assert euler_characteristic(faces) == 2


def test_torus_has_euler_characteristic_zero() -> None:
    size = 5
    i, j = torch.meshgrid(torch.arange(size), torch.arange(size), indexing="ij")
    corner = lambda di, dj: (((i + di) % size) * size + (j + dj) % size).flatten()  # noqa: E731
    lower = torch.stack([corner(0, 0), corner(1, 0), corner(1, 1)], dim=1)
    upper = torch.stack([corner(0, 0), corner(1, 1), corner(0, 1)], dim=1)
    assert euler_characteristic(torch.cat([lower, upper])) == 0


@pytest.mark.parametrize(
    "faces",
    [
        TETRAHEDRON[:3],
        torch.cat([TETRAHEDRON[:3], TETRAHEDRON[3:].flip(1)]),
        torch.cat([TETRAHEDRON, TETRAHEDRON]),
        torch.cat([TETRAHEDRON, torch.tensor([[0, 1, 4]])]),
    ],
    ids=["hole", "flipped face", "doubled faces", "fin on one edge"],
)
def test_mesh_that_is_not_closed_is_refused(faces: Tensor) -> None:
    with pytest.raises(MeshError, match="not closed"):
        topology_of(faces)


def test_a_mesh_has_faces() -> None:
    with pytest.raises(MeshError, match="no faces"):
        topology_of(TETRAHEDRON[:0])


def test_gradients_of_areas_are_the_same_bytes_every_time() -> None:
    vertices, faces = icosphere(4)
    weights, threads = torch.randn(len(faces), generator=torch.Generator().manual_seed(0)), torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        found = []
        for _ in range(30):
            leaf = vertices.clone().requires_grad_()
            (weights * polygon_areas(leaf, faces)).sum().backward()
            found.append(leaf.grad)
    finally:
        torch.set_num_threads(threads)
    assert all(torch.equal(found[0], gradient) for gradient in found)
