"""Trace lines of sight past the object: to the ground with the object's shadow, to a backdrop, or to the sky."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from pipeline.datasets.toybox.backdrop import paint_backdrop
from pipeline.datasets.toybox.noise import sample
from pipeline.datasets.toybox.surroundings import Place, per_pixel

FARTHEST = 300.0
"""Distance, in units of the object, that stands for infinity."""


class Rays(NamedTuple):
    """Lines of sight in world space."""

    origin: Float[np.ndarray, "B 3"]
    """Where the camera stands."""
    directions: Float[np.ndarray, "B H W 3"]
    """Through each pixel, of any length."""


class Footprint(NamedTuple):
    """The space that each object takes up, in world units."""

    half_width: Float[np.ndarray, " B"]
    half_depth: Float[np.ndarray, " B"]
    bottom: Float[np.ndarray, " B"]
    """Height of its lowest point."""


def paint_scenery(
    place: Place, rays: Rays, footprint: Footprint, shadow: Float[np.ndarray, " B"], rng: np.random.Generator
) -> Float[np.ndarray, "B H W 3"]:
    """Return the reflectance of what is seen; `shadow` is the share of light that the object keeps from the ground."""
    facing = rays.origin * np.array([1.0, 0.0, 1.0], np.float32)
    reach = np.linalg.norm(facing, axis=-1)
    facing = facing / reach[:, None]
    level = np.minimum(footprint.bottom - place.drop, rays.origin[:, 1] - 0.1)
    to_ground = _distance(level - rays.origin[:, 1], rays.directions[..., 1])
    to_wall = _distance(-(place.distance + reach), np.einsum("bhwc,bc->bhw", rays.directions, facing))
    point = rays.origin[:, None, None] + np.minimum(to_ground, to_wall)[..., None] * rays.directions
    side = np.stack([facing[:, 2], np.zeros_like(reach), -facing[:, 0]], axis=-1)
    across = np.einsum("bhwc,bc->bhw", point, side)
    height = point[..., 1] - per_pixel(level)
    ground = _ground(place, point, to_ground, rng)
    ground = ground * (1 - shadow[:, None, None, None] * _shadow(point, footprint, place)[..., None])
    return np.where((to_ground < to_wall)[..., None], ground, paint_backdrop(place, across, height, rng))


def _distance(offset: np.ndarray, slope: np.ndarray) -> Float[np.ndarray, "B H W"]:
    """Return how far along each ray a plane is met, in ray lengths."""
    share = per_pixel(offset) / np.where(np.abs(slope) < 1e-4, 1e-4, slope)
    return np.where(share > 0, np.minimum(share, FARTHEST), FARTHEST).astype(np.float32)


def _ground(place: Place, point: np.ndarray, distance: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Paint asphalt, soil or floor with an edge to other ground, lines and stains."""
    count = len(point)
    grain = per_pixel(rng.uniform(0.1, 0.6, count) / (1 + place.drop))
    stains = sample(place.texture, point[..., 0] * grain, point[..., 2] * grain)
    strength = per_pixel(np.where(place.studio, 0.08, rng.uniform(0.05, 0.55, count))) / (
        1 + distance / (6 + per_pixel(place.drop))
    )
    angle = rng.uniform(0, np.pi, count)
    offset = point[..., 0] * per_pixel(np.cos(angle)) + point[..., 2] * per_pixel(np.sin(angle))
    width = 1 + place.drop
    edge = per_pixel(rng.uniform(-0.2, 1.2, count) * width)
    outdoors = ~(place.studio | place.indoors)
    beyond = (offset > edge) & per_pixel(outdoors & (rng.random(count) < 0.45))
    colors = np.where(beyond[..., None], place.verge[:, None, None], place.ground[:, None, None])
    line = (np.abs(offset - edge + per_pixel(rng.uniform(0.0, 0.4, count) * width)) < 0.03) & per_pixel(
        outdoors & (rng.random(count) < 0.4)
    )
    field = per_pixel(2.0 / width)
    fields = sample(place.texture, np.floor(offset * field) * 0.37, np.floor(point[..., 0] * field) * 0.61)
    fields = fields * per_pixel((place.drop > 0) * rng.uniform(0.0, 0.6, count))
    boards = per_pixel(place.indoors & (rng.random(count) < 0.5)) * (np.floor(offset * 6) % 2 - 0.5)
    colors = colors * np.exp(strength * (stains + boards) + fields)[..., None]
    return np.where(line[..., None], 0.75, colors).astype(np.float32)


def _shadow(point: np.ndarray, footprint: Footprint, place: Place) -> Float[np.ndarray, "B H W"]:
    """Return how dark the ground is: fully under the object, fading beside it."""
    beyond = np.maximum(
        np.abs(point[..., 0]) - per_pixel(footprint.half_width), np.abs(point[..., 2]) - per_pixel(footprint.half_depth)
    )
    return np.clip(1 - (beyond + 0.05) / 0.15, 0, 1) * per_pixel(place.drop == 0)
