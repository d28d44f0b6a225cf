"""Ground truth of pictures. It is written for evaluation and reports; no training stage can reach it."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt8


class Viewpoints(NamedTuple):
    """What is known of photographs cut to their objects, in the conventions of `pipeline.geometry.camera.Pose`."""

    azimuth: Float[np.ndarray, " B"]
    """Radians."""
    elevation: Float[np.ndarray, " B"]
    """Radians."""
    roll: Float[np.ndarray, " B"]
    """Radians."""
    center: Float[np.ndarray, "B 2"]
    """0: the middle of the object's box is that of the picture."""
    scale: Float[np.ndarray, " B"]
    """NaN: how large the object is in the reference camera is not known."""


class GroundTruth(NamedTuple):
    """What is true of one category's pictures, in the conventions of `pipeline.geometry.camera.Pose`."""

    azimuth: Float[np.ndarray, " B"]
    """Radians."""
    elevation: Float[np.ndarray, " B"]
    """Radians."""
    roll: Float[np.ndarray, " B"]
    """Radians."""
    center: Float[np.ndarray, "B 2"]
    """Where the world's origin, the middle of the object's cube, falls in the picture, in ndc."""
    scale: Float[np.ndarray, " B"]
    """Factor on the size that the reference camera gives."""
    masks: UInt8[np.ndarray, "B H W"]
    """1 where the object covers at least half of the pixel."""
    vertices: Float[np.ndarray, "B V 3"]
    """World space, fitted into the unit cube; the front faces +z, the mirror plane is x = 0."""
    faces: Int[np.ndarray, "F 3"]
    """Counter-clockwise from outside. Parts are closed and may overlap: inside, the winding number is positive."""


def viewpoints_of_boxes(angles: Sequence[tuple[float, ...]]) -> Viewpoints:
    """Take azimuth, elevation and roll of pictures, in radians, whose frames are their objects' boxes."""
    azimuth, elevation, roll = np.array(angles).T
    return Viewpoints(azimuth, elevation, roll, np.zeros((len(angles), 2)), np.full(len(angles), np.nan))


def concatenate(truths: list[GroundTruth]) -> GroundTruth:
    """Join the ground truths of consecutive pictures, whose meshes share their faces."""
    joined = {name: np.concatenate([getattr(truth, name) for truth in truths]) for name in GroundTruth._fields}
    return GroundTruth(**(joined | {"faces": truths[0].faces}))
