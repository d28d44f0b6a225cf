"""Where toybox photographers stand: viewpoints and framings by category."""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float

from pipeline.geometry.camera import CameraConfig, Pose, project


class Viewpoints(NamedTuple):
    """The distribution of viewpoints of one category (paper, appendix, Table 3); angles in degrees."""

    elevation: tuple[float, float]
    """Lowest and highest, uniform between."""
    side_views: bool
    """Azimuths favour the sides, left and right alike: 180 times Beta(1.5, 1.5), mirrored for half of the pictures; else uniform."""
    roll: float
    """Standard deviation of the in-plane turn."""
    fill: float
    """Mean share of the picture's side that the longer side of the object's box takes up."""


def choose_poses(
    viewpoints: Viewpoints, vertices: Float[np.ndarray, "B V 3"], camera: CameraConfig, rng: np.random.Generator
) -> Pose:
    """Draw viewpoints, and frame the objects as people crop photographs: filling most of the picture, a little off its middle.

    The scale brings the longer side of the object's box in the picture to a random share of the picture.
    """
    count = len(vertices)
    azimuth = rng.uniform(0.0, 2 * np.pi, count)
    if viewpoints.side_views:
        azimuth = np.pi * rng.beta(1.5, 1.5, count) * rng.choice([-1.0, 1.0], count) % (2 * np.pi)
    elevation = np.deg2rad(rng.uniform(*viewpoints.elevation, count))
    roll = np.deg2rad(rng.normal(0.0, viewpoints.roll, count))
    fill = np.clip(rng.normal(viewpoints.fill, 0.11, count), 0.5, 1.25)
    shift = rng.normal(0.0, 0.07, (count, 2))
    angles = [torch.from_numpy(angle).float() for angle in (azimuth, elevation, roll)]
    plain = Pose(*angles, torch.zeros(count, 2), torch.ones(count))
    extent = project(torch.from_numpy(vertices).float(), plain, camera)[..., :2]
    lower, upper = extent.amin(dim=1), extent.amax(dim=1)
    scale = torch.from_numpy(2 * fill).float() / (upper - lower).amax(dim=1)
    center = torch.from_numpy(shift).float() - scale[:, None] * (lower + upper) / 2
    return plain._replace(center=center, scale=scale)
