import torch
from torch import Tensor

from pipeline.geometry.icosphere import icosphere
from pipeline.geometry.voxels import voxelize

CORNERS = torch.cartesian_prod(*[torch.tensor([-0.5, 0.5])] * 3)
SQUARES = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
CUBE = torch.tensor([triangle for a, b, c, d in SQUARES for triangle in ([a, b, c], [a, c, d])])


def centers(resolution: int) -> Tensor:
    line = (torch.arange(resolution) + 0.5) / resolution - 0.5
    return torch.stack(torch.meshgrid(line, line, line, indexing="ij"), dim=-1)


def test_box_fills_exactly_its_voxels() -> None:
    size, shift = torch.tensor([0.5, 0.25, 0.75]), torch.tensor([0.125, 0.25, 0.0])
    expected = ((centers(16) - shift).abs() < size / 2).all(dim=-1)
    assert torch.equal(voxelize((CORNERS * size + shift)[None], CUBE, 16)[0], expected)


def test_edges_through_voxel_centres_are_hit_once() -> None:
    # The box ends on centres and its diagonals run through them: half-open on each axis, so 8 x 8 x 8 voxels.
    voxels = voxelize((CORNERS * 0.5 + 1 / 32)[None], CUBE, 16)
    assert voxels.sum() == 8**3


def test_sphere_agrees_with_its_equation() -> None:
    vertices, faces = icosphere(4)
    radius = centers(32).norm(dim=-1)
    voxels = voxelize(vertices[None] / 2, faces, 32)[0]
    certain = (radius - 0.5).abs() > 0.005
    assert torch.equal(voxels[certain], (radius < 0.5)[certain])


def test_overlapping_parts_and_reversed_faces_count_once() -> None:
    two = torch.cat([CORNERS * 0.5 - 0.1, CORNERS * 0.5 + 0.1])
    faces = torch.cat([CUBE, CUBE + 8])
    separate = voxelize((CORNERS * 0.5)[None] + torch.tensor([-0.1, 0.1])[:, None, None], CUBE, 16)
    assert torch.equal(voxelize(two[None], faces, 16)[0], separate.any(dim=0))
    assert torch.equal(voxelize(two[None], faces.flip(1), 16)[0], separate.any(dim=0))


def test_batch_equals_single_meshes_and_geometry_outside_is_cut() -> None:
    vertices, faces = icosphere(2)
    batch = vertices * torch.tensor([0.2, 0.5, 2.0])[:, None, None]
    voxels = voxelize(batch, faces, 8)
    assert all(torch.equal(voxels[i], voxelize(batch[i : i + 1], faces, 8)[0]) for i in range(3))
    assert voxels[2].all()
