"""Where toybox photographers stand: viewpoints and framings by category."""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.geometry.camera import CameraConfig, Pose, place_in_picture


class ViewRange(NamedTuple):
    """The distribution of viewpoints of one category (paper, appendix, Table 4); angles in degrees."""

    elevation: tuple[float, float]
    """Lowest and highest, uniform between."""
    side_views: bool
    """Whether azimuths favour the sides: 180 times Beta(1.5, 1.5), negated in half of the pictures; else uniform."""
    roll: float
    """Standard deviation of the in-plane turn."""
    fill: float
    """Mean share of the picture's side that the longer side of the object's box takes up."""


def choose_poses(
    viewpoints: ViewRange, vertices: Float[Tensor, "B V 3"], camera: CameraConfig, rng: np.random.Generator
) -> Pose:
    """Draw viewpoints, and frame the objects as people crop photographs.

    The longer side of the object's box takes up a random share of the picture, a little off its middle.
    """
    count = len(vertices)
    azimuth = rng.uniform(0.0, 2 * np.pi, count)
    if viewpoints.side_views:
        azimuth = np.pi * rng.beta(1.5, 1.5, count) * rng.choice([-1.0, 1.0], count) % (2 * np.pi)
    elevation = np.deg2rad(rng.uniform(*viewpoints.elevation, count))
    roll = np.deg2rad(rng.normal(0.0, viewpoints.roll, count))
    fill = np.clip(rng.normal(viewpoints.fill, 0.11, count), 0.5, 1.25)
    shift = rng.normal(0.0, 0.07, (count, 2))
    azimuths, elevations, rolls, centers, extents = (
        torch.from_numpy(values).float() for values in (azimuth, elevation, roll, shift, fill)
    )
    return place_in_picture(vertices, azimuths, elevations, rolls, centers, extents, camera)
