import pytest
import torch
from torch import Tensor

from pipeline.errors import MeshError
from pipeline.geometry.halves import border_loop, border_mask, cut_half, divide, join_halves, split_chords
from pipeline.geometry.icosphere import icosphere
from pipeline.geometry.symmetry import mirror_index, reflect
from pipeline.geometry.topology import euler_characteristic, polygon_areas
from tests.deformed_spheres import SHAPES, deformed_sphere


@pytest.mark.parametrize("name", SHAPES)
def test_half_is_a_disk_with_half_the_area_and_a_border_on_the_plane(name: str) -> None:
    vertices, faces, directions = deformed_sphere(name)
    half_vertices, half_faces = cut_half(vertices, faces, directions)
    loop = border_loop(half_faces)
    assert (half_vertices[loop, 0] == 0).all()
    torch.testing.assert_close(polygon_areas(half_vertices, half_faces).sum() * 2, polygon_areas(vertices, faces).sum())


@pytest.mark.parametrize("subdivisions", [0, 1, 2])
def test_joined_halves_are_closed_symmetric_and_outward(subdivisions: int) -> None:
    directions, faces = icosphere(subdivisions)
    half = split_chords(*cut_half(directions, faces, directions))
    vertices, joined = join_halves(*half)
    assert euler_characteristic(joined) == 2
    assert torch.equal(reflect(vertices)[mirror_index(vertices)], vertices)
    assert (torch.linalg.det(vertices[joined]) > 0).all()


def test_sides_are_told_by_directions_where_the_surface_crosses_the_plane() -> None:
    directions, faces = icosphere(2)
    crossed = directions * torch.tensor([-1.0, 1, 1])
    half_vertices, half_faces = cut_half(crossed, faces, directions)
    assert (half_vertices[~border_mask(half_faces, len(half_vertices)), 0] < 0).all()


def test_chord_between_border_vertices_is_split() -> None:
    vertices = torch.tensor([[0.0, 0, 0], [0, 1, 0], [0, 1, 1], [0, 0, 1]])
    split_vertices, split_faces = split_chords(vertices, torch.tensor([[0, 1, 2], [0, 2, 3]]))
    assert split_vertices[4].tolist() == [0, 0.5, 0.5]
    assert len(split_faces) == 4
    torch.testing.assert_close(polygon_areas(split_vertices, split_faces).sum().item(), 1.0)
    assert euler_characteristic(join_halves(split_vertices, split_faces)[1]) == 2


def test_divided_sphere_is_two_disks_whatever_islands_its_directions_have() -> None:
    directions, faces = icosphere(3)
    generator = torch.Generator().manual_seed(0)
    noisy = directions + 0.4 * torch.randn(directions.shape, generator=generator)
    positive = divide(faces, noisy)
    first, second = border_loop(faces[positive]), border_loop(faces[~positive])
    assert set(first.tolist()) == set(second.tolist())
    assert 0.4 < positive.float().mean() < 0.6


def test_border_of_two_loops_is_refused() -> None:
    ring = torch.arange(6)
    tube = (
        torch.stack([ring, (ring + 1) % 6, ring + 6], dim=1),
        torch.stack([(ring + 1) % 6, (ring + 1) % 6 + 6, ring + 6], 1),
    )
    with pytest.raises(MeshError, match="not a disk"):
        border_loop(torch.cat(tube))


@pytest.mark.parametrize("faces", [[[0, 1, 4], [1, 2, 3]], [[1, 2, 3], [0, 1, 4]]])
def test_border_that_touches_itself_is_refused(faces: list[list[int]]) -> None:
    with pytest.raises(MeshError, match="not a disk"):
        border_loop(torch.tensor(faces))


def test_faces_that_are_not_symmetric_are_refused() -> None:
    vertices, faces = cube_with_slanted_top()
    with pytest.raises(MeshError, match="not mirror-symmetric"):
        cut_half(vertices, faces, torch.nn.functional.normalize(vertices, dim=1))


def cube_with_slanted_top() -> tuple[Tensor, Tensor]:
    """Return a cube whose squares across the plane are cut along one diagonal only."""
    corners = torch.cartesian_prod(*[torch.tensor([-1.0, 1.0])] * 3)
    squares = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    return corners, torch.tensor([triangle for a, b, c, d in squares for triangle in ([a, b, c], [a, c, d])])
