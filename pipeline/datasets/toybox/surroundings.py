"""Where toybox photographs are taken: colours, distances and sky."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from pipeline.datasets.toybox.noise import textures
from pipeline.datasets.toybox.paint import pick

ROADS = [[0.16, 0.16, 0.16], [0.26, 0.26, 0.26], [0.38, 0.37, 0.35], [0.09, 0.09, 0.09], [0.50, 0.49, 0.47]]
LAND = [[0.10, 0.16, 0.04], [0.16, 0.22, 0.06], [0.28, 0.22, 0.12], [0.42, 0.34, 0.22], [0.07, 0.10, 0.03]]
FLOORS = [[0.30, 0.18, 0.09], [0.45, 0.40, 0.33], [0.22, 0.21, 0.20], [0.55, 0.53, 0.50], [0.20, 0.08, 0.06]]
WALLS = [
    [0.34, 0.29, 0.23],
    [0.38, 0.17, 0.11],
    [0.55, 0.51, 0.43],
    [0.24, 0.24, 0.25],
    [0.62, 0.61, 0.58],
    [0.12, 0.10, 0.09],
]
INTERIORS = [
    [0.70, 0.68, 0.63],
    [0.55, 0.48, 0.36],
    [0.45, 0.50, 0.50],
    [0.32, 0.24, 0.17],
    [0.60, 0.35, 0.25],
    [0.82, 0.81, 0.79],
]
FOLIAGE = [[0.06, 0.11, 0.02], [0.035, 0.06, 0.02], [0.13, 0.17, 0.04], [0.24, 0.13, 0.04], [0.08, 0.08, 0.04]]
SKIES = [
    [0.20, 0.38, 0.75],
    [0.48, 0.62, 0.85],
    [0.80, 0.82, 0.84],
    [0.48, 0.49, 0.51],
    [0.07, 0.18, 0.55],
    [0.75, 0.48, 0.28],
]


class Setting(NamedTuple):
    """Shares of a category's photographs that are taken in front of one colour, indoors and in the air."""

    studio: float
    indoors: float
    airborne: float


class Place(NamedTuple):
    """The surroundings of each photograph; lengths in units of the object's longest side, colours as reflectance."""

    studio: Bool[np.ndarray, "B"]
    """In front of one colour, which is `wall`, on a floor of nearly the same."""
    indoors: Bool[np.ndarray, "B"]
    """In a room: the backdrop is its wall, and no sky shows."""
    drop: Float[np.ndarray, "B"]
    """How far below the object the ground is."""
    distance: Float[np.ndarray, "B"]
    """How far behind the object the backdrop stands."""
    ground: Float[np.ndarray, "B 3"]
    verge: Float[np.ndarray, "B 3"]
    """Colour of the ground beyond a random line."""
    wall: Float[np.ndarray, "B 3"]
    foliage: Float[np.ndarray, "B 3"]
    sky: Float[np.ndarray, "B 3"]
    texture: Float[np.ndarray, "B 128 128"]


def choose_places(setting: Setting, elevation: Float[np.ndarray, "B"], rng: np.random.Generator) -> Place:
    """Draw random surroundings; an object that is seen from below is in the air if its category ever is."""
    count = len(elevation)
    share = rng.random(count)
    studio = share < setting.studio
    indoors = ~studio & (share < setting.studio + setting.indoors)
    airborne = ~studio & ((rng.random(count) < setting.airborne) | ((elevation < 0.05) & (setting.airborne > 0)))
    paved = rng.random((count, 1)) < 0.6
    wall = np.where(indoors[:, None], pick(INTERIORS, count, rng), pick(WALLS, count, rng))
    wall = np.where(studio[:, None], _studio_colors(count, rng), wall)
    ground = np.where(paved, pick(ROADS, count, rng), pick(LAND, count, rng))
    ground = np.where(indoors[:, None], pick(FLOORS, count, rng), ground)
    near, far = 0.2, np.where(indoors, 1.5, 5.0)
    distance = near * (far / near) ** rng.random(count)
    return Place(
        studio=studio,
        indoors=indoors,
        drop=np.where(airborne, np.exp(rng.uniform(1.0, 4.0, count)), 0.0),
        distance=np.where(airborne, 150.0, distance),
        ground=np.where(studio[:, None], wall * rng.uniform(0.8, 1.0, (count, 1)), ground),
        verge=pick(LAND, count, rng),
        wall=wall,
        foliage=pick(FOLIAGE, count, rng),
        sky=pick(SKIES, count, rng),
        texture=textures(count, rng),
    )


def _studio_colors(count: int, rng: np.random.Generator) -> Float[np.ndarray, "B 3"]:
    """Draw mostly white, then grays, now and then a colour."""
    kind = rng.random((count, 1))
    gray, color = rng.random((count, 1)) ** 2, rng.random((count, 3)) ** 2
    return np.where(kind < 0.65, rng.uniform(0.85, 1.1, (count, 1)), np.where(kind < 0.85, gray, color))
