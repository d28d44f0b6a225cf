"""Where toybox photographs are taken: colours, distances and sky."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from pipeline.datasets.toybox.noise import textures
from pipeline.datasets.toybox.paint import palette, pick

ROADS = palette("6f6f6f 8b8b8b a6a4a0 555555 bcbab6")
LAND = palette("596f38 6f8145 908161 ad9e81 4b5930")
FLOORS = palette("957655 b3aa9b 817e7c c4c0bc 7c5045")
WALLS = palette("9e9384 a6735d c4bdaf 868689 cecdc8 615955")
INTERIORS = palette("dad7d0 c4b8a2 b3bcbc 998673 cba089 eae8e6")
FOLIAGE = palette("455d27 354527 657338 866538 505038")
SKIES = palette("7ca6e1 7ca6e1 b8ceed e7eaec b8babd 4b76c4 5f92d8 e1b890")


class Setting(NamedTuple):
    """Shares of a category's photographs that are taken in front of one colour, indoors and in the air."""

    studio: float
    indoors: float
    airborne: float


class Place(NamedTuple):
    """The surroundings of each photograph; lengths in units of the object's longest side, colours as reflectance."""

    studio: Bool[np.ndarray, " B"]
    """In front of one colour, which is `wall`, on a floor of nearly the same."""
    indoors: Bool[np.ndarray, " B"]
    """In a room: the backdrop is its wall, and no sky shows."""
    drop: Float[np.ndarray, " B"]
    """How far below the object the ground is."""
    distance: Float[np.ndarray, " B"]
    """How far behind the object the backdrop stands."""
    ground: Float[np.ndarray, "B 3"]
    verge: Float[np.ndarray, "B 3"]
    """Colour of the ground beyond a random line."""
    wall: Float[np.ndarray, "B 3"]
    foliage: Float[np.ndarray, "B 3"]
    sky: Float[np.ndarray, "B 3"]
    texture: Float[np.ndarray, "B 128 128"]


def choose_places(setting: Setting, elevation: Float[np.ndarray, " B"], rng: np.random.Generator) -> Place:
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
        ground=np.where(studio[:, None], wall * rng.uniform(0.8, 1.0, (count, 1)), ground).astype(np.float32),
        verge=pick(LAND, count, rng).astype(np.float32),
        wall=wall.astype(np.float32),
        foliage=pick(FOLIAGE, count, rng).astype(np.float32),
        sky=pick(SKIES, count, rng).astype(np.float32),
        texture=textures(count, rng),
    )


def _studio_colors(count: int, rng: np.random.Generator) -> Float[np.ndarray, "B 3"]:
    """Draw mostly white, then grays, now and then a colour."""
    kind = rng.random((count, 1))
    gray, color = rng.random((count, 1)) ** 2, rng.random((count, 3)) ** 2
    return np.where(kind < 0.65, rng.uniform(0.85, 1.1, (count, 1)), np.where(kind < 0.85, gray, color))


def per_pixel(values: np.ndarray) -> np.ndarray:
    """Give one value per photograph the shape that goes with one per pixel."""
    return values[:, None, None] if values.dtype == bool else values[:, None, None].astype(np.float32)
