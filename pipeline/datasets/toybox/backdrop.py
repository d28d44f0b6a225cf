"""What stands behind the object: sky, trees, buildings, rooms, and clutter in front of them."""

import numpy as np
from jaxtyping import Float

from pipeline.datasets.toybox.noise import sample
from pipeline.datasets.toybox.surroundings import Place, per_pixel


def paint_backdrop(
    place: Place, across: Float[np.ndarray, "B H W"], height: Float[np.ndarray, "B H W"], rng: np.random.Generator
) -> Float[np.ndarray, "B H W 3"]:
    """Paint the upright plane behind the object at positions along it and heights above the ground."""
    count = len(across)
    outdoors = ~(place.indoors | place.studio)
    near = place.distance < 100
    colors = _sky(place, across, height, rng)
    tree_height = np.where(rng.random(count) < 0.75, np.exp(rng.uniform(-1.2, 1.3, count)), 0.0)
    colors = _trees(colors, place, across, height, np.where(outdoors & near, tree_height, 0.0), rng)
    colors = _buildings(colors, place, across, height, outdoors & near & (rng.random(count) < 0.5), rng)
    colors = np.where(outdoors[:, None, None, None], colors, _room(place, across, height, rng))
    for _ in range(9):
        chosen = np.flatnonzero(near & ~place.studio & (rng.random(count) < 0.4))
        _add_clutter(colors, across, height, chosen, rng)
    return colors


def _sky(place: Place, across: np.ndarray, height: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Paint a sky that is paler towards the horizon, with clouds."""
    count = len(across)
    sideways, upward = across / per_pixel(place.distance + 3), height / per_pixel(place.distance + 3)
    scale = per_pixel(rng.uniform(0.15, 0.9, count))
    cloud = sample(place.texture, sideways * scale, upward * scale * 1.5)
    cover = np.clip(cloud * per_pixel(rng.uniform(0.05, 0.5, count)) + per_pixel(rng.uniform(-0.5, 0.5, count)), 0, 1)
    haze = np.exp(-np.abs(upward) / per_pixel(rng.uniform(0.05, 0.6, count))) * per_pixel(rng.uniform(0.0, 0.8, count))
    sky = place.sky[:, None, None].astype(np.float32) * (1 - 0.35 * np.clip(upward, -1, 1))[..., None]
    white = (per_pixel(rng.uniform(0.5, 1.0, count)) * (1 + 0.15 * cloud))[..., None]
    return sky + (white - sky) * np.maximum(cover, haze)[..., None]


def _trees(
    colors: np.ndarray, place: Place, across: np.ndarray, height: np.ndarray, top: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    count = len(across)
    scale = per_pixel(rng.uniform(0.05, 0.4, count))
    leaves = sample(place.texture, across * scale, height * scale)
    crown = per_pixel(top) * (1 + 0.25 * sample(place.texture, across * 0.1, across * 0 + 0.5) + 0.15 * leaves)
    shade = place.foliage[:, None, None] * np.exp(leaves * per_pixel(rng.uniform(0.3, 1.1, count)))[..., None]
    return np.where((height < crown)[..., None], shade, colors)


def _buildings(
    colors: np.ndarray,
    place: Place,
    across: np.ndarray,
    height: np.ndarray,
    present: np.ndarray,
    rng: np.random.Generator,
) -> np.ndarray:
    count = len(across)
    column = across / per_pixel(rng.uniform(0.2, 0.9, count)) % 1.0
    row = height / per_pixel(rng.uniform(0.25, 0.9, count)) % 1.0
    glazed = rng.random(count) < 0.75
    window = (
        (column > per_pixel(rng.uniform(0.25, 0.75, count)))
        & (row > per_pixel(rng.uniform(0.25, 0.75, count)))
        & per_pixel(glazed)
    )
    stains = 1 + 0.12 * sample(place.texture, across * 0.3, height * 0.3)
    wall = place.wall[:, None, None] * stains[..., None]
    wall = np.where(window[..., None], per_pixel(rng.uniform(0.01, 0.4, count))[..., None], wall)
    left = per_pixel(rng.uniform(-3.0, 1.0, count))
    inside = (across > left) & (across < left + per_pixel(rng.uniform(0.5, 4.0, count)))
    inside &= (height < per_pixel(rng.uniform(0.3, 3.0, count))) & per_pixel(present)
    return np.where(inside[..., None], wall, colors)


def _room(place: Place, across: np.ndarray, height: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Paint a wall with a skirting board and hangings, or a seamless studio."""
    count = len(across)
    stains = 1 + per_pixel(np.where(place.studio, 0.06, 0.15)) * sample(place.texture, across * 0.2, height * 0.2)
    stripes = np.floor(across / per_pixel(rng.uniform(0.05, 0.4, count))) % 2
    colors = (
        place.wall[:, None, None]
        * (stains - 0.25 * stripes * per_pixel(place.indoors & (rng.random(count) < 0.25)))[..., None]
    )
    skirting = (height < 0.06) & per_pixel(place.indoors)
    return np.where(skirting[..., None], per_pixel(rng.uniform(0.05, 0.8, count))[..., None], colors)


def _add_clutter(
    colors: np.ndarray, across: np.ndarray, height: np.ndarray, chosen: np.ndarray, rng: np.random.Generator
) -> None:
    """Stand one post, person, vehicle, sign or piece of furniture in front of the backdrop of the chosen pictures."""
    count = len(chosen)
    across, height = across[chosen], height[chosen]
    upright = rng.random(count) < 0.6
    half_width = np.where(upright, rng.uniform(0.015, 0.12, count), rng.uniform(0.15, 0.6, count))
    top = np.where(upright, rng.uniform(0.3, 2.0, count), rng.uniform(0.1, 0.5, count))
    bottom = np.where(rng.random(count) < 0.25, top * rng.uniform(0.3, 0.9, count), -0.05)
    offset = np.abs(across - per_pixel(rng.uniform(-1.4, 1.4, count))) / per_pixel(half_width)
    level = (height - per_pixel(bottom)) / per_pixel(top - bottom)
    rounding = per_pixel(rng.uniform(2.0, 8.0, count))
    inside = offset**rounding + np.abs(2 * level - 1) ** rounding < 1
    lower, upper = (rng.random((count, 3)) ** 2 * rng.uniform(0.1, 0.9, (count, 1)) for _ in range(2))
    gray = rng.random((count, 1)) < 0.7
    lower, upper = (np.where(gray, color.mean(axis=1, keepdims=True), color) for color in (lower, upper))
    split = (level > per_pixel(rng.uniform(0.2, 1.2, count)))[..., None]
    painted = np.where(split, upper[:, None, None], lower[:, None, None])
    colors[chosen] = np.where(inside[..., None], painted, colors[chosen])
