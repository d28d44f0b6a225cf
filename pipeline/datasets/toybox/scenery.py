"""What stands around the object: a ground, a backdrop behind it, sky above, clutter between, and the object's shadow."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from pipeline.datasets.toybox.noise import fractal, lattices
from pipeline.datasets.toybox.paint import jitter

GROUNDS = np.array(
    [[0.20, 0.20, 0.21], [0.32, 0.31, 0.30], [0.12, 0.20, 0.05], [0.30, 0.24, 0.15], [0.55, 0.52, 0.48], [0.10, 0.10, 0.11]]
)
WALLS = np.array([[0.35, 0.30, 0.25], [0.45, 0.22, 0.15], [0.55, 0.52, 0.45], [0.25, 0.27, 0.30], [0.60, 0.60, 0.60], [0.15, 0.13, 0.12]])
FOLIAGE = np.array([[0.08, 0.14, 0.03], [0.05, 0.09, 0.03], [0.16, 0.20, 0.05], [0.28, 0.16, 0.05], [0.10, 0.11, 0.06]])
SKIES = np.array([[0.25, 0.42, 0.75], [0.55, 0.65, 0.80], [0.75, 0.78, 0.80], [0.45, 0.47, 0.50], [0.10, 0.22, 0.60], [0.70, 0.50, 0.35]])


class Place(NamedTuple):
    """Random properties of the surroundings of each picture; lengths in units of the object's longest side."""

    ground: Float[np.ndarray, "B 3"]
    wall: Float[np.ndarray, "B 3"]
    foliage: Float[np.ndarray, "B 3"]
    sky: Float[np.ndarray, "B 3"]
    studio: Bool[np.ndarray, " B"]
    studio_color: Float[np.ndarray, "B 3"]
    distance: Float[np.ndarray, " B"]
    tree_height: Float[np.ndarray, " B"]
    wall_height: Float[np.ndarray, " B"]
    lattice: Float[np.ndarray, "B 32 32"]


class Rays(NamedTuple):
    """Lines of sight in world space: one camera position per picture and one direction per pixel."""

    origin: Float[np.ndarray, "B 3"]
    directions: Float[np.ndarray, "B H W 3"]


def choose_places(count: int, rng: np.random.Generator) -> Place:
    """Draw random surroundings."""
    def pick(colors: np.ndarray) -> np.ndarray:
        return jitter(colors[rng.integers(len(colors), size=count)], 0.12, rng)

    white = rng.random((count, 1)) < 0.6
    return Place(
        ground=pick(GROUNDS),
        wall=pick(WALLS),
        foliage=pick(FOLIAGE),
        sky=pick(SKIES),
        studio=rng.random(count) < 0.14,
        studio_color=np.where(white, rng.uniform(0.8, 1.0, (count, 1)), rng.uniform(0.0, 0.7, (count, 3))),
        distance=np.exp(rng.uniform(np.log(0.7), np.log(8.0), count)),
        tree_height=np.where(rng.random(count) < 0.6, rng.uniform(0.3, 3.0, count), 0.0),
        wall_height=np.where(rng.random(count) < 0.45, rng.uniform(0.2, 2.5, count), 0.0),
        lattice=lattices(count, rng),
    )


def paint_scenery(
    place: Place, rays: Rays, footprint: Float[np.ndarray, "B 3"], shadow: Float[np.ndarray, " B"], rng: np.random.Generator
) -> Float[np.ndarray, "B H W 3"]:
    """Trace every ray to the ground, the backdrop or the sky.

    `footprint` is the half width, ground height and half depth of the object; `shadow` the share of light it keeps from the ground.
    """
    facing = rays.origin * [1.0, 0.0, 1.0]
    reach = np.linalg.norm(facing, axis=-1)
    facing = facing / reach[:, None]
    down = footprint[:, 1] - rays.origin[:, 1]
    with_ground = _along(down, rays.directions[..., 1])
    with_wall = _along(-(place.distance + reach), np.einsum("bhwc,bc->bhw", rays.directions, facing))
    on_ground = with_ground < with_wall
    point = rays.origin[:, None, None] + np.minimum(with_ground, with_wall)[..., None] * rays.directions
    side = np.stack([facing[:, 2], np.zeros(len(reach)), -facing[:, 0]], axis=-1)
    across = np.einsum("bhwc,bc->bhw", point, side)
    height = point[..., 1] - footprint[:, 1, None, None]
    colors = np.where(on_ground[..., None], _ground(place, point, rng), _backdrop(place, across, height, rays.directions[..., 1], rng))
    colors = np.where(place.studio[:, None, None, None], place.studio_color[:, None, None], colors)
    occluded = np.where(on_ground, shadow[:, None, None] * _shadow(point, footprint), 0.0)
    return colors * (1 - occluded[..., None])


def _along(distance: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Return how far along each ray a plane is met, or a large number where it is not."""
    share = distance[:, None, None] / np.where(np.abs(slope) < 1e-4, 1e-4, slope)
    return np.where(share > 0, np.minimum(share, 200.0), 200.0)


def _ground(place: Place, point: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    count = len(point)
    angle = rng.uniform(0, np.pi, count)
    grain, strength = rng.uniform(1.5, 8.0, count), rng.uniform(0.03, 0.35, count)
    texture = fractal(place.lattice, point[..., 0] * _wide(grain), point[..., 2] * _wide(grain), 3)
    colors = place.ground[:, None, None] * (1 + _wide(strength)[..., None] * texture[..., None])
    offset = point[..., 0] * _wide(np.cos(angle)) + point[..., 2] * _wide(np.sin(angle)) - _wide(rng.uniform(0.3, 1.2, count))
    line = (np.abs(offset) < 0.025) & _wide(rng.random(count) < 0.35)
    verge = (offset > _wide(rng.uniform(0.1, 0.8, count))) & _wide(rng.random(count) < 0.4)
    colors = np.where(verge[..., None], place.foliage[:, None, None] * 1.5 * (1 + 0.5 * texture[..., None]), colors)
    return np.where(line[..., None], 0.7, colors)


def _backdrop(place: Place, across: np.ndarray, height: np.ndarray, slope: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    count = len(across)
    cloud = fractal(place.lattice, across * 0.3, height * 0.6 + 5.0, 3)
    haze = np.clip(slope * _wide(rng.uniform(0.3, 2.0, count)), 0, 1)
    sky = place.sky[:, None, None] * (1 - haze[..., None] * 0.4) + np.clip(cloud, 0, 1)[..., None] * _wide(rng.uniform(0, 0.4, count))[..., None]
    leaf = fractal(place.lattice, across * _wide(rng.uniform(1.0, 5.0, count)), height * _wide(rng.uniform(1.0, 5.0, count)), 4)
    crown = place.tree_height[:, None, None] * (1 + 0.35 * fractal(place.lattice, across * 1.3, across * 0.0 + 9.0, 2))
    trees = place.foliage[:, None, None] * np.exp(_wide(rng.uniform(0.4, 1.3, count)) * leaf)[..., None]
    colors = np.where((height < crown)[..., None], trees, sky)
    inside = (height < _wide(place.wall_height)) & (np.abs(across - _wide(rng.uniform(-1.5, 1.5, count))) < _wide(rng.uniform(0.4, 3.0, count)))
    colors = np.where(inside[..., None], _building(place, across, height, rng), colors)
    return _posts(colors, across, height, rng)


def _building(place: Place, across: np.ndarray, height: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    count = len(across)
    pitch, storey = rng.uniform(0.2, 0.8, count), rng.uniform(0.25, 0.8, count)
    column, row = across / _wide(pitch) % 1.0, height / _wide(storey) % 1.0
    window = (column > _wide(rng.uniform(0.3, 0.7, count))) & (row > _wide(rng.uniform(0.3, 0.7, count))) & _wide(rng.random(count) < 0.7)
    grain = fractal(place.lattice, across * 2.0, height * 2.0, 3)
    wall = place.wall[:, None, None] * (1 + 0.2 * grain[..., None])
    return np.where(window[..., None], _wide(rng.uniform(0.02, 0.5, count))[..., None], wall)


def _posts(colors: np.ndarray, across: np.ndarray, height: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Stand trunks, people and other upright clutter in front of the backdrop."""
    count = len(across)
    for _ in range(4):
        place, half_width, tall = rng.uniform(-1.5, 1.5, count), rng.uniform(0.02, 0.14, count), rng.uniform(0.2, 2.0, count)
        present = (rng.random(count) < 0.35)[:, None, None]
        inside = (np.abs(across - _wide(place)) < _wide(half_width)) & (height < _wide(tall)) & present
        colors = np.where(inside[..., None], (rng.random((count, 3)) ** 2.2 * 0.8)[:, None, None], colors)
    return colors


def _shadow(point: np.ndarray, footprint: np.ndarray) -> np.ndarray:
    """Return how dark the ground is under and beside the object, fading within a tenth of its size."""
    beyond = np.maximum(np.abs(point[..., 0]) - _wide(footprint[:, 0]), np.abs(point[..., 2]) - _wide(footprint[:, 2]))
    return np.clip(1 - np.maximum(beyond + 0.03, 0) / 0.12, 0, 1)


def _wide(values: np.ndarray) -> np.ndarray:
    return values[:, None, None]
