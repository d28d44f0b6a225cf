"""Heads that regress poses as an axis and an end of it."""

import math

import torch

from pipeline.networks.pose_coordinates import PoseCoordinates
from pipeline.networks.pose_decoder import PoseDecoder, PoseRegression, regression_error
from pipeline.seeding import generator
from tests.tiny_full_model import exact_regression
from tests.unit.test_pose_coordinates import CAMERA, RANGE

POSES = PoseCoordinates(RANGE, CAMERA, rim=0.0, fills_picture=False)


def test_axis_and_end_are_joined_into_the_coordinates() -> None:
    coordinates = POSES.draw(200, generator(0))
    torch.testing.assert_close(exact_regression(coordinates).coordinates, coordinates, atol=1e-5, rtol=0)
    torch.testing.assert_close(
        regression_error(exact_regression(coordinates), coordinates), torch.tensor(0.0), atol=1e-5, rtol=0
    )


def test_mirror_images_are_those_of_the_coordinates() -> None:
    coordinates = POSES.draw(200, generator(1))
    mirrored = exact_regression(coordinates).mirror(POSES)
    torch.testing.assert_close(mirrored.coordinates, POSES.mirror(coordinates), atol=1e-5, rtol=0)


def test_an_end_that_is_nearly_undecided_leaves_the_axis_as_it_is() -> None:
    regression = exact_regression(POSES.draw(200, generator(2)))
    weak = regression._replace(end=1e-3 * regression.end)
    torch.testing.assert_close(weak.coordinates, regression.coordinates)
    turned = regression._replace(end=-1e-3 * regression.end).coordinates
    torch.testing.assert_close(turned[:, :2], -regression.coordinates[:, :2])
    assert torch.equal(turned[:, 2:], regression.coordinates[:, 2:])


def test_a_head_that_sees_either_end_answers_with_one_of_them() -> None:
    decoder, code = PoseDecoder(4, 16, 1), torch.ones(64, 4)
    wanted = torch.zeros(64, 7)
    wanted[:, 0], wanted[:, 1] = math.cos(0.7), math.sin(0.7)
    wanted[::2, :2] *= -1
    optimizer = torch.optim.Adam(decoder.parameters(), lr=0.02)
    for _ in range(200):
        optimizer.zero_grad()
        regression_error(decoder(code), wanted).backward()
        optimizer.step()
    turn = decoder(code[:1]).coordinates[0, :2]
    assert abs(turn @ wanted[0, :2]) > math.cos(math.radians(5))


def test_a_head_that_is_compared_with_itself_keeps_its_axis_and_box() -> None:
    said = PoseDecoder(code_size=4, hidden_size=8, ensemble=1)(torch.randn(200, 4))
    own = POSES.clamp(said.coordinates).detach()
    of_axis, of_others = torch.autograd.grad(200 * regression_error(said, own), [said.axis, said.others])
    assert of_axis.norm(dim=-1).max() < 1e-4
    assert not of_others.any()


def test_gradients_flow_to_axis_and_others() -> None:
    said = torch.randn(20, 9, generator=generator(3)).requires_grad_()
    PoseRegression(*said.split([2, 2, 5], dim=1)).coordinates.square().cumsum(1).sum().backward()
    assert said.grad is not None
    assert (said.grad[:, :2] == 0).all()
    assert (said.grad[:, 2:].abs().sum(1) > 0).all()
    assert said.grad.isfinite().all()
