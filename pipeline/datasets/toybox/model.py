"""What every kind of toybox object is made of: a solid, the colours of its materials, and how it is seen."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from pipeline.datasets.toybox.solids import Solid


class Specimens(NamedTuple):
    """A batch of random objects of one category."""

    solid: Solid
    """The front faces +z, up is +y, the mirror plane is x = 0; in units of its own."""
    palette: Float[np.ndarray, "B M 3"]
    """RGB reflectance in [0, 1] of each material of each object."""
    gloss: Float[np.ndarray, " M"]
    """Share of the surroundings that each material mirrors, range [0, 1]."""


def vectors(x: np.ndarray | float, y: np.ndarray | float, z: np.ndarray | float) -> Float[np.ndarray, "B *points 3"]:
    """Stack coordinates, of which at least one is given per object or per point of each object, into vectors."""
    return np.stack(np.broadcast_arrays(x, y, z), axis=-1)


def polyline(*points: Float[np.ndarray, "B 3"]) -> Float[np.ndarray, "B R 3"]:
    """Stack the points of one path per object."""
    return np.stack(points, axis=1)


def between(
    start: Float[np.ndarray, "B 3"], end: Float[np.ndarray, "B 3"], shares: Sequence[float]
) -> Float[np.ndarray, "B R 3"]:
    """Return points of the straight line from start to end, 0 and 1 being its ends."""
    return start[:, None] + np.array(shares)[:, None] * (end - start)[:, None]
