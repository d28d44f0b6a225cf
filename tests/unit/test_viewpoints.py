"""The fixed distributions of viewpoints and lights."""

import math

import pytest
import torch

from pipeline.errors import ConfigError
from pipeline.geometry.camera import CameraConfig, Pose, fill_picture, project
from pipeline.seeding import generator
from pipeline.training.viewpoints import (
    AngleConfig,
    LightConfig,
    ViewpointConfig,
    enlarge_fronts,
    sample_angles,
    sample_lights,
    sample_viewpoints,
)

COUNT = 20000


@pytest.mark.parametrize("concentration", [1.0, 1.5, 4.0])
def test_angles_have_the_moments_of_a_stretched_beta_distribution(concentration: float) -> None:
    angles = sample_angles(AngleConfig(-30.0, 90.0, concentration), COUNT, generator(0))
    degrees = torch.rad2deg(angles)
    variance = 120.0**2 / (4 * (2 * concentration + 1))
    assert degrees.min() >= -30.0
    assert degrees.max() <= 90.0
    assert degrees.mean().item() == pytest.approx(30.0, abs=4 * math.sqrt(variance / COUNT))
    assert degrees.var().item() == pytest.approx(variance, rel=0.03)


def test_narrow_distributions_stay_numbers() -> None:
    angles = sample_angles(AngleConfig(0, 180, 2000), 4000, generator(0)).rad2deg()
    assert angles.mean().item() == pytest.approx(90, abs=0.1)
    assert angles.std().item() == pytest.approx(180 / (2 * math.sqrt(4001)), rel=0.1)


def test_viewpoints_that_nothing_can_have_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"^low is 30 and high is 0; expected the smaller angle as low"):
        AngleConfig(30, 0, 1)
    with pytest.raises(ConfigError, match=r"^elevation is 0 to 300; expected degrees from -90 to 90"):
        ViewpointConfig(AngleConfig(0, 360, 1), AngleConfig(0, 300, 1), mirrored=False)


def test_viewpoints_look_at_the_centre_without_roll() -> None:
    config = ViewpointConfig(AngleConfig(0.0, 360.0, 1.0), AngleConfig(0.0, 30.0, 1.0), mirrored=False)
    pose = sample_viewpoints(config, 8, generator(1))
    assert pose.azimuth.max() > math.pi
    assert pose.elevation.max() <= math.radians(30.0)
    assert not pose.roll.any()
    assert not pose.center.any()
    assert torch.equal(pose.scale, torch.ones(8))


def test_mirrored_viewpoints_come_from_both_sides_alike() -> None:
    config = ViewpointConfig(AngleConfig(0.0, 180.0, 1.5), AngleConfig(-10.0, 10.0, 1.0), mirrored=True)
    azimuth = sample_viewpoints(config, COUNT, generator(3)).azimuth
    assert (azimuth > 0).float().mean().item() == pytest.approx(0.5, abs=0.02)
    assert azimuth.abs().mean().item() == pytest.approx(math.pi / 2, abs=0.03)


def test_light_comes_uniformly_from_above() -> None:
    light = sample_lights(LightConfig(0.4, 0.6), COUNT, generator(2))
    assert light.direction.norm(dim=1).allclose(torch.ones(COUNT))
    assert light.direction[:, 1].min() >= 0
    assert light.direction.mean(0).tolist() == pytest.approx([0.0, 0.5, 0.0], abs=0.02)
    assert light.ambient.unique().item() == pytest.approx(0.4)
    assert light.directional.unique().item() == pytest.approx(0.6)


def test_filling_the_picture_keeps_the_angles_and_fits_the_box() -> None:
    around = AngleConfig(0.0, 360.0, 1.0)
    pose = sample_viewpoints(ViewpointConfig(around, AngleConfig(0.0, 30.0, 1.0), mirrored=False), 6, generator(0))
    vertices = torch.rand(6, 40, 3, generator=generator(1)) - 0.5
    camera = CameraConfig(2.3, 30.0)
    filled = fill_picture(vertices, pose, camera)
    torch.testing.assert_close(filled.azimuth, pose.azimuth)
    corners = project(vertices, filled, camera)[..., :2]
    low, high = corners.amin(dim=1), corners.amax(dim=1)
    torch.testing.assert_close((low + high) / 2, torch.zeros(6, 2), atol=1e-4, rtol=0)
    torch.testing.assert_close((high - low).amax(dim=1), torch.full((6,), 2.0), atol=1e-4, rtol=0)


def test_fronts_and_rears_are_enlarged_and_sides_are_not() -> None:
    azimuth = torch.deg2rad(torch.tensor([0.0, 45.0, 90.0, 180.0, 270.0]))
    zeros = torch.zeros(5)
    pose = enlarge_fronts(Pose(azimuth, zeros, zeros, torch.zeros(5, 2), torch.full((5,), 2.0)), 1.4)
    torch.testing.assert_close(pose.scale, 2 * torch.tensor([1.4, 1.2, 1.0, 1.4, 1.0]))
    torch.testing.assert_close(pose.azimuth, azimuth)
