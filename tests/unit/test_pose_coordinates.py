"""Pose coordinates and the placement of objects in the picture."""

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from pipeline.errors import ConfigError
from pipeline.geometry.camera import CameraConfig, project
from pipeline.geometry.symmetry import reflect
from pipeline.networks.pose_coordinates import PoseCoordinates, PoseRange
from pipeline.seeding import generator
from tests.tiny_full_model import base_mesh

CAMERA = CameraConfig(2.7, 30.0)
RANGE = PoseRange((-10.0, 50.0), (-20.0, 20.0), (-0.4, 0.4), (0.5, 2.0))


def boxes(poses: PoseCoordinates, coordinates: Tensor) -> tuple[Tensor, Tensor]:
    vertices = base_mesh().vertices.expand(len(coordinates), -1, -1)
    xy = project(vertices, poses(coordinates, vertices), CAMERA)[..., :2]
    return xy.amin(dim=1), xy.amax(dim=1)


def test_middle_of_the_ranges() -> None:
    vertices = base_mesh().vertices
    poses = PoseCoordinates(RANGE, CAMERA, rim=0.0, fills_picture=False)
    pose = poses(torch.tensor([[0.0, 2.0, 0, 0, 0, 0, 0]]), vertices)
    assert pose.azimuth.item() == torch.tensor(math.pi / 2)
    torch.testing.assert_close(pose.elevation, torch.tensor([math.radians(20)]))
    assert pose.roll.item() == 0


def test_box_is_where_the_coordinates_say_from_every_side() -> None:
    poses = PoseCoordinates(RANGE, CAMERA, rim=0.0, fills_picture=False)
    coordinates = poses.draw(50, generator(0))
    lower, upper = boxes(poses, coordinates)
    torch.testing.assert_close((lower + upper) / 2, 0.4 * coordinates[:, 4:6], atol=1e-5, rtol=0)
    torch.testing.assert_close((upper - lower).amax(dim=1), 2 * 2 ** coordinates[:, 6], atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("rim", [0.0, 0.1, 0.5])
def test_sides_of_the_box_are_means_of_the_outermost_vertices(rim: float) -> None:
    poses = PoseCoordinates(RANGE, CAMERA, rim, fills_picture=False)
    coordinates, vertices = poses.draw(20, generator(0)), torch.rand(20, 30, 3, generator=generator(1)) - 0.5
    ranks = project(vertices, poses(coordinates, vertices), CAMERA)[..., :2].sort(dim=1).values
    count = max(1, int(rim * 30))
    lower, upper = ranks[:, :count].mean(dim=1), ranks[:, -count:].mean(dim=1)
    torch.testing.assert_close((lower + upper) / 2, 0.4 * coordinates[:, 4:6], atol=1e-5, rtol=0)
    torch.testing.assert_close((upper - lower).amax(dim=1), 2 * 2 ** coordinates[:, 6], atol=1e-5, rtol=1e-5)


def test_a_tip_hardly_moves_the_other_vertices() -> None:
    vertices = base_mesh().vertices
    tip = vertices[0, :, 2].argmax()
    longer = vertices.clone()
    longer[0, tip, 2] += 0.1
    from_the_side = torch.tensor([[0.0, 1.0, 0, 0, 0, 0, 0]])

    def moved(rim: float) -> float:
        poses = PoseCoordinates(RANGE, CAMERA, rim, fills_picture=False)
        before, after = (project(body, poses(from_the_side, body), CAMERA)[0, :, :2] for body in (vertices, longer))
        change = (after - before).norm(dim=1)
        return torch.cat([change[:tip], change[tip + 1 :]]).max().item()

    assert moved(0.1) < 0.2 * moved(0.0)


def test_object_fills_the_picture_of_box_framing() -> None:
    poses = PoseCoordinates(RANGE, CAMERA, rim=0.1, fills_picture=True)
    lower, upper = boxes(poses, poses.draw(50, generator(0)))
    torch.testing.assert_close(torch.maximum(-lower, upper).amax(dim=1), torch.ones(50), atol=1e-5, rtol=0)
    torch.testing.assert_close(lower + upper, torch.zeros(50, 2), atol=1e-5, rtol=0)


def test_drawn_coordinates_cover_their_ranges_and_stay_inside() -> None:
    poses = PoseCoordinates(RANGE, CAMERA, rim=0.0, fills_picture=False)
    coordinates = poses.draw(2000, generator(0))
    torch.testing.assert_close(poses.clamp(coordinates), coordinates)
    assert (coordinates.amin(dim=0) < -0.98).all()
    assert (coordinates.amax(dim=0) > 0.98).all()


def test_clamp_moves_to_the_nearest_coordinates() -> None:
    poses = PoseCoordinates(RANGE, CAMERA, rim=0.0, fills_picture=False)
    clamped = poses.clamp(torch.tensor([[3.0, 4.0, 2.0, -2.0, 0.5, 0.0, -1.0]]))
    torch.testing.assert_close(clamped, torch.tensor([[0.6, 0.8, 1.0, -1.0, 0.5, 0.0, -1.0]]))


def test_mirror_of_a_mirror_symmetric_body_is_its_mirrored_picture() -> None:
    poses = PoseCoordinates(PoseRange((-10.0, 50.0), (-20.0, 20.0), (-0.4, 0.4), (0.5, 2.0)), CAMERA, 0.0, False)
    coordinates = poses.draw(20, generator(0))
    vertices = base_mesh().vertices.expand(20, -1, -1)
    xyz = project(vertices, poses(coordinates, vertices), CAMERA)
    mirrored = project(reflect(vertices), poses(poses.mirror(coordinates), vertices), CAMERA)
    torch.testing.assert_close(mirrored, reflect(xyz), atol=1e-5, rtol=0)


def test_a_range_may_be_one_value_but_not_reversed() -> None:
    poses = PoseCoordinates(replace(RANGE, roll=(0.0, 0.0), extent=(1.0, 1.0)), CAMERA, 0.0, False)
    drawn = poses.draw(4, generator(0))
    torch.testing.assert_close(poses.mirror(poses.mirror(drawn)), drawn)
    again = poses.clamp(2 * drawn + 1)
    assert not again[:, [3, 6]].any()
    torch.testing.assert_close(poses.box(again)[1], torch.ones(4))
    with pytest.raises(ConfigError, match=r"^roll is \[5\.0, -5\.0\]; expected the lower bound first"):
        replace(RANGE, roll=(5.0, -5.0))
    with pytest.raises(ConfigError, match=r"^center is \[-0\.5, 0\.1\]; expected as far to either side"):
        replace(RANGE, center=(-0.5, 0.1))


def test_gradients_flow_to_coordinates_and_vertices() -> None:
    poses = PoseCoordinates(RANGE, CAMERA, rim=0.0, fills_picture=False).double()
    vertices = base_mesh().vertices.double()
    coordinates = poses.draw(1, generator(0)).double()

    def scale(coordinates: Tensor, vertices: Tensor) -> Tensor:
        return poses(coordinates, vertices).scale

    inputs = (coordinates.requires_grad_(), vertices[:, ::10].clone().requires_grad_())
    assert torch.autograd.gradcheck(scale, inputs)
