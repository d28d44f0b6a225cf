"""Annotations of PASCAL3D+: one MATLAB file a picture, with a struct `record` that lists its objects."""

import io
import math
import zlib
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy.io import loadmat
from scipy.io.matlab import MatReadError

from pipeline.datasets.decoding import Box
from pipeline.errors import DataError

ANGLES = ("azimuth", "elevation", "theta")
"""Fields of `viewpoint` in degrees; the project's azimuth, elevation and roll, see docs/conventions.md."""
_DAMAGE = (
    MatReadError,
    zlib.error,
    ValueError,
    TypeError,
    IndexError,
    NotImplementedError,
    OSError,
    OverflowError,
)
"""What reading raises when bytes are wrong, or a field is something else than expected."""


class AnnotatedObject(NamedTuple):
    """A whole, visible object."""

    box: Box
    angles: tuple[float, float, float]
    """Azimuth, elevation and roll in radians, in the conventions of `pipeline.geometry.camera.Pose`."""


def read_objects(content: bytes, name: str, category: str, has_difficult: bool) -> list[AnnotatedObject]:
    """List the objects of a category that are neither truncated, occluded nor difficult and have a fine viewpoint.

    A viewpoint without a distance, or with the distance 0, is coarse and left out. ImageNet's annotations
    (`has_difficult` false) mark none as difficult. Raises DataError, naming the file, where it cannot be read or a
    field is missing or no number.
    """
    try:
        record = loadmat(io.BytesIO(content), simplify_cells=True)["record"]
        objects = record["objects"]
        objects = [objects] if isinstance(objects, Mapping) else list(objects)
        flags = ("truncated", "occluded", "difficult") if has_difficult else ("truncated", "occluded")
        return [_object(found) for found in objects if found["class"] == category and _is_usable(found, flags)]
    except KeyError as error:
        raise DataError(f"{name} has no field {error}; expected an annotation of PASCAL3D+") from None
    except _DAMAGE as error:
        reason = " ".join(str(error).split())
        raise DataError(f"{name} is not an annotation of PASCAL3D+ ({reason}); copy it again") from None


def _is_usable(found: Mapping[str, Any], flags: tuple[str, ...]) -> bool:
    viewpoint = found["viewpoint"]
    fine = isinstance(viewpoint, Mapping) and viewpoint.get("distance", 0) != 0
    return fine and not any(np.any(found[flag]) for flag in flags)


def _object(found: Mapping[str, Any]) -> AnnotatedObject:
    left, top, right, bottom = (round(float(side)) for side in found["bbox"])
    azimuth, elevation, theta = (math.radians(float(found["viewpoint"][angle])) for angle in ANGLES)
    if not all(map(math.isfinite, (azimuth, elevation, theta))):
        raise ValueError("an angle is not finite")
    # MATLAB counts pixels from 1, and the last one is inside the box.
    return AnnotatedObject((left - 1, top - 1, right, bottom), (azimuth, elevation, theta))
