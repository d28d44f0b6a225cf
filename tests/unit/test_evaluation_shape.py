import torch

from pipeline.evaluation.shape import (
    chamfer_l1,
    fit_constant,
    iou,
    proportions,
    sample_outer_surface,
    sample_surface,
    vertex_deviation,
)
from pipeline.geometry.icosphere import icosphere
from pipeline.geometry.voxels import voxelize

TRIANGLES = torch.tensor([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 5], [3, 0, 5], [0, 2, 5]]])
FACES = torch.tensor([[0, 1, 2], [3, 4, 5]])


def box(low: int, high: int) -> torch.Tensor:
    grid = torch.zeros(1, 8, 8, 8, dtype=torch.bool)
    grid[:, low:high, low:high, low:high] = True
    return grid


def test_iou_of_boxes() -> None:
    torch.testing.assert_close(iou(box(0, 4), box(2, 6)), torch.tensor([8 / (64 + 64 - 8)]))
    assert iou(box(1, 3), box(0, 4)).item() == 1 / 8
    assert iou(box(0, 4), box(4, 8)).item() == 0
    assert iou(box(0, 0), box(0, 0)).item() == 1


def test_the_best_constant_shape_may_hold_what_few_shapes_fill() -> None:
    halves, apart = torch.cat([box(0, 4), box(4, 8)]), torch.cat([box(0, 2), box(2, 4), box(4, 6), box(6, 8)])
    assert torch.equal(fit_constant(apart), apart.any(dim=0))  # no voxel is in two of them
    assert torch.equal(fit_constant(torch.cat([halves, box(0, 4)])), box(0, 4)[0])
    masks = torch.tensor([[[True, True, False]], [[True, False, False]], [[True, False, True]]])
    assert torch.equal(fit_constant(masks), masks[1])


def test_a_constant_shape_holds_nothing_that_fewer_than_a_twentieth_of_shapes_fill() -> None:
    assert fit_constant(torch.eye(20).bool()).all()
    assert not fit_constant(torch.eye(21).bool()).any()


def test_chamfer_of_shifted_grids_is_the_shift() -> None:
    axis = torch.arange(4.0)
    points = torch.cartesian_prod(axis, axis, axis)[None]
    shifted = points + torch.tensor([0.0, 0.3, 0.4])
    torch.testing.assert_close(chamfer_l1(points, shifted), torch.tensor([0.5]))


def test_chamfer_counts_both_directions() -> None:
    one, two = torch.zeros(1, 1, 3), torch.tensor([[[0.0, 0, 0], [0, 0, 3]]])
    assert chamfer_l1(one, two).item() == (0 + 1.5) / 2


def test_spread_is_the_mean_distance_from_the_mean_shape() -> None:
    vertices, _ = icosphere(1)
    assert not vertex_deviation(vertices.expand(3, -1, -1)).any()
    moved = torch.stack([vertices - torch.tensor([0.0, 0.03, 0.04]), vertices + torch.tensor([0.0, 0.03, 0.04])])
    torch.testing.assert_close(vertex_deviation(moved), torch.tensor([0.05, 0.05]))


def test_points_lie_on_the_surface_in_proportion_to_area() -> None:
    (points,), (normals,) = sample_surface(TRIANGLES, FACES, 4000, torch.Generator().manual_seed(0))
    torch.testing.assert_close(normals, torch.tensor([0.0, 0, 1]).expand(4000, 3))
    lower = points[:, 2] < 1
    torch.testing.assert_close(lower.float().mean(), torch.tensor(0.5 / 3.5), atol=0.02, rtol=0)
    assert (points[lower][:, :2].sum(1) <= 1 + 1e-6).all()
    torch.testing.assert_close(points[lower].mean(0), torch.tensor([1 / 3, 1 / 3, 0]), atol=0.03, rtol=0)
    torch.testing.assert_close(points[~lower].mean(0), torch.tensor([1, 2 / 3, 5]), atol=0.05, rtol=0)


def test_points_inside_overlapping_parts_are_left_out() -> None:
    vertices, faces = icosphere(2)
    near, far = torch.tensor([0.0, 0, -0.1]), torch.tensor([0.0, 0, 0.1])
    pair = torch.cat([vertices * 0.3 + near, vertices * 0.3 + far])[None].float()
    both = torch.cat([faces, faces + len(vertices)])
    points = sample_outer_surface(pair, both, voxelize(pair, both, 32), 500, torch.Generator().manual_seed(0))
    outside_both = torch.minimum((points[0] - near).norm(dim=1), (points[0] - far).norm(dim=1)) > 0.27
    assert outside_both.float().mean() > 0.97


def test_proportions_are_logarithms_of_width_and_height_over_length() -> None:
    box = torch.cartesian_prod(torch.tensor([0.0, 1.0]), torch.tensor([0.0, 2.0]), torch.tensor([0.0, 4.0]))
    torch.testing.assert_close(proportions(box[None]), torch.tensor([[0.25, 0.5]]).log())
