from math import cos, pi, radians, sin, tan

import pytest
import torch

from pipeline.geometry.camera import CameraConfig, Pose, pose_from_tensor, pose_to_tensor, project, rotation_from_angles

CAMERA = CameraConfig(distance=3.0, field_of_view=40.0)


def pose(azimuth: float = 0.0, elevation: float = 0.0, roll: float = 0.0, scale: float = 1.0) -> Pose:
    angles = torch.tensor([[azimuth, elevation, roll, 0.0, 0.0, scale]], dtype=torch.float64)
    return pose_from_tensor(angles)


def seen(x: float, y: float, z: float, view: Pose) -> list[float]:
    return project(torch.tensor([[[x, y, z]]], dtype=torch.float64), view, CAMERA)[0, 0].tolist()


def test_origin_is_the_picture_center_at_the_camera_distance() -> None:
    assert seen(0, 0, 0, pose(1.0, 0.4, 0.3)) == pytest.approx([0, 0, 3])


def test_axes_from_the_front() -> None:
    assert seen(0.1, 0, 0, pose())[0] > 0
    assert seen(0, 0.1, 0, pose())[1] > 0
    assert seen(0, 0, 0.1, pose()) == pytest.approx([0, 0, 2.9])


def test_camera_stands_where_the_convention_says() -> None:
    azimuth, elevation = 0.7, 0.3
    x, y, z = sin(azimuth) * cos(elevation), sin(elevation), cos(azimuth) * cos(elevation)
    assert seen(x / 2, y / 2, z / 2, pose(azimuth, elevation)) == pytest.approx([0, 0, 2.5], abs=1e-6)


def test_front_faces_image_left_from_azimuth_ninety_degrees() -> None:
    assert seen(0, 0, 0.5, pose(azimuth=pi / 2))[0] < 0


def test_roll_turns_the_object_counter_clockwise() -> None:
    x, y, _ = seen(0.5, 0, 0, pose(roll=pi / 2))
    assert x == pytest.approx(0)
    assert y > 0


def test_edge_of_the_field_of_view_is_one() -> None:
    half_width = 3.0 * tan(radians(20))
    assert seen(half_width, -half_width, 0, pose()) == pytest.approx([1, -1, 3])


def test_scale_and_center_act_in_the_picture() -> None:
    view = pose(scale=0.5)._replace(center=torch.tensor([[0.2, -0.1]], dtype=torch.float64))
    plain = seen(0.3, 0.4, 0.1, pose())
    assert seen(0.3, 0.4, 0.1, view) == pytest.approx([0.5 * plain[0] + 0.2, 0.5 * plain[1] - 0.1, plain[2]])


def test_rotations_are_proper() -> None:
    angles = torch.randn(3, 16, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    rotation = rotation_from_angles(*angles)
    torch.testing.assert_close(rotation @ rotation.transpose(1, 2), torch.eye(3, dtype=torch.float64).expand(16, 3, 3))
    torch.testing.assert_close(torch.linalg.det(rotation), torch.ones(16, dtype=torch.float64))


def test_points_beside_the_camera_stay_finite() -> None:
    vertices = torch.tensor([[[0.0, 0.1, 3.0], [0.0, 0.1, 4.0]]], requires_grad=True)
    projected = project(vertices, Pose(*(part.float() for part in pose())), CAMERA)
    projected.sum().backward()
    assert projected.isfinite().all()
    assert vertices.grad is not None
    assert vertices.grad.isfinite().all()


def test_pose_survives_the_tensor() -> None:
    values = torch.randn(4, 6)
    assert torch.equal(pose_to_tensor(pose_from_tensor(values)), values)


def test_gradients_of_the_projection() -> None:
    vertices = torch.randn(2, 5, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1)) / 4
    values = torch.randn(2, 6, dtype=torch.float64, generator=torch.Generator().manual_seed(2))

    def function(vertices: torch.Tensor, values: torch.Tensor) -> torch.Tensor:
        return project(vertices, pose_from_tensor(values), CAMERA)

    assert torch.autograd.gradcheck(function, (vertices.requires_grad_(), values.requires_grad_()))
