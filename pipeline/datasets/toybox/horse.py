"""Horses standing, walking and grazing, from tubes for trunk, neck, head, legs and tail."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from pipeline.datasets.toybox.model import Specimens, polyline, vectors
from pipeline.datasets.toybox.paint import palette, shades, vary
from pipeline.datasets.toybox.solids import Solid, ellipsoid, join, mirrored, moved, tube

COAT, MANE, POINT, MUZZLE, PATCH, HOOF = range(6)
GLOSS = np.array([0.06, 0.04, 0.05, 0.02, 0.06, 0.03])
SIDEWAYS = (1.0, 0.0, 0.0)

COATS = {
    "bay": "815938 302727 3f3027",
    "chestnut": "99693f 95653f 90613f",
    "dark bay": "593f30 302727 383027",
    "black": "303030 272727 303030",
    "palomino": "bc9b6c daceb8 b3956c",
    "white": "d3cec8 cbc7bf bcb6af",
    "gray": "999795 616161 6c6969",
}
"""Colours of the coat, of mane and tail, and of the lower legs."""
SHARES = (0.24, 0.2, 0.14, 0.12, 0.08, 0.12, 0.1)


class Proportions(NamedTuple):
    """Sizes of each horse in units of its height at the withers, and its bearing in radians."""

    length: np.ndarray
    girth: np.ndarray
    leg: np.ndarray
    neck_angle: np.ndarray
    """Of the neck above the horizontal."""
    head_angle: np.ndarray
    """Of the head above the horizontal; negative points down."""
    stride: np.ndarray
    """How far the legs swing."""


def build_horses(count: int, rng: np.random.Generator) -> Specimens:
    """Build random horses. Only the legs, which walk, are not symmetric about x = 0."""
    grazing = rng.random(count) < 0.15
    neck_angle = np.where(grazing, rng.uniform(-0.8, -0.5, count), rng.uniform(0.35, 1.05, count))
    sizes = Proportions(
        length=rng.uniform(0.92, 1.1, count),
        girth=rng.uniform(0.18, 0.23, count),
        leg=rng.uniform(0.5, 0.57, count),
        neck_angle=neck_angle,
        head_angle=np.where(grazing, -1.2, neck_angle - rng.uniform(1.1, 1.7, count)),
        stride=np.where(rng.random(count) < 0.4, 0.03, rng.uniform(0.1, 0.45, count)),
    )
    parts = [_trunk(sizes), *_neck_and_head(sizes), *_legs(sizes, rng), _tail(sizes, rng)]
    return Specimens(join(parts), _palette(count, rng), GLOSS)


def _trunk(sizes: Proportions) -> Solid:
    back = 1.0 - sizes.girth
    shares = (-0.5, -0.45, -0.32, -0.12, 0.1, 0.28, 0.42, 0.47)
    lift = (0.01, 0.015, 0.01, -0.03, -0.025, 0.0, 0.01, 0.0)
    path = polyline(*(vectors(0, back + up, share * sizes.length) for share, up in zip(shares, lift, strict=True)))
    half_width = np.outer(sizes.girth, [0.3, 0.65, 0.85, 0.9, 0.9, 0.78, 0.55, 0.25])
    half_height = np.outer(sizes.girth, [0.4, 0.8, 1.0, 0.98, 1.02, 1.05, 0.8, 0.4])
    materials = np.full((7, 12), COAT)
    materials[1:3, 4:9] = materials[4:6, 7:12] = PATCH
    return tube(path, np.stack([half_width, half_height], axis=-1), SIDEWAYS, materials, size=12)


def _neck_and_head(sizes: Proportions) -> list[Solid]:
    rise, reach = np.sin(sizes.neck_angle), np.cos(sizes.neck_angle)
    withers = vectors(0, 1.0 - 0.75 * sizes.girth, 0.36 * sizes.length)
    neck = vectors(0, rise, reach)
    normal = vectors(0, reach, -rise)
    path = polyline(withers - 0.08 * neck, withers + 0.12 * neck, withers + 0.3 * neck, withers + 0.46 * neck)
    path = path + np.array([0.0, 0.3, 0.35, 0.0])[:, None] * (0.1 * normal)[:, None]
    radii = np.stack(
        [np.outer(sizes.girth, [0.5, 0.42, 0.32, 0.28]), np.outer(sizes.girth, [0.95, 0.75, 0.55, 0.45])], -1
    )
    mane = path[:, 1:] + (normal * sizes.girth[:, None])[:, None] * np.array([0.68, 0.5, 0.42])[:, None]
    crest = np.stack([np.outer(sizes.girth, [0.12, 0.14, 0.12]), np.outer(sizes.girth, [0.22, 0.26, 0.2])], axis=-1)
    poll = path[:, 3]
    facing = vectors(0, np.sin(sizes.head_angle), np.cos(sizes.head_angle))
    head_path = poll[:, None] + np.array([-0.06, 0.04, 0.16, 0.27, 0.32])[:, None] * facing[:, None]
    head_radii = np.stack(
        [np.outer(sizes.girth, [0.2, 0.34, 0.27, 0.22, 0.14]), np.outer(sizes.girth, [0.28, 0.48, 0.36, 0.25, 0.16])],
        axis=-1,
    )
    face = np.repeat([[COAT], [COAT], [COAT], [MUZZLE]], 8, axis=1)
    ear_at = poll - 0.05 * facing + 0.1 * normal
    ear = np.stack([0.12 * sizes.girth, 0.38 * sizes.girth, 0.12 * sizes.girth], axis=-1)
    ears = mirrored(moved(ellipsoid(ear, COAT), ear_at + np.array([0.045, 0.0, 0.0])))
    return [
        tube(path, radii, SIDEWAYS, COAT, size=10),
        tube(mane, crest, SIDEWAYS, MANE, size=6),
        tube(head_path, head_radii, SIDEWAYS, face, size=8),
        ears,
    ]


def _legs(sizes: Proportions, rng: np.random.Generator) -> list[Solid]:
    count = len(sizes.length)
    legs = []
    for front in (True, False):
        for side in (-1.0, 1.0):
            swing = sizes.stride * rng.uniform(-1, 1, count)
            bend = sizes.stride * rng.uniform(0, 0.8, count)
            legs.append(_leg(sizes, front, side, swing, bend))
    return legs


def _leg(sizes: Proportions, front: bool, side: float, swing: np.ndarray, bend: np.ndarray) -> Solid:
    """Build one leg: `swing` forward from the shoulder or hip, `bend` backward below the knee or hock."""
    shoulder = vectors(side * 0.5 * sizes.girth, 1.0 - 1.25 * sizes.girth, (0.33 if front else -0.36) * sizes.length)
    total = 1.0 - 1.25 * sizes.girth
    upper = vectors(0, -np.cos(swing), np.sin(swing))
    lower_angle = swing - bend + (0.0 if front else -0.08)
    lower = vectors(0, -np.cos(lower_angle), np.sin(lower_angle))
    hock = 0.0 if front else -0.06
    knee = shoulder + (0.52 * total)[:, None] * upper + np.array([0.0, 0.0, hock])
    fetlock = knee + (0.38 * total)[:, None] * lower
    foot = fetlock + (0.1 * total)[:, None] * (lower + np.array([0.0, 0.0, 0.3]))
    thigh = (0.75 * shoulder + 0.25 * knee) + np.array([0.0, 0.0, 0.0 if front else 0.02])
    path = polyline(shoulder + np.array([0.0, 0.08, 0.0]), thigh, knee, (knee + fetlock) / 2, fetlock, foot)
    width = np.outer(sizes.girth, [0.38, 0.33, 0.19, 0.13, 0.14, 0.19])
    depth = np.outer(sizes.girth, [0.55 if front else 0.75, 0.42 if front else 0.6, 0.22, 0.15, 0.17, 0.22])
    materials = np.repeat([[COAT], [COAT], [COAT], [POINT], [HOOF]], 8, axis=1)
    return tube(path, np.stack([width, depth], axis=-1), SIDEWAYS, materials, size=8)


def _tail(sizes: Proportions, rng: np.random.Generator) -> Solid:
    lift = rng.uniform(0.02, 0.14, len(sizes.length))
    z = -0.49 * sizes.length
    top = 1.0 - 0.4 * sizes.girth
    path = polyline(
        vectors(0, top, z + 0.03),
        vectors(0, top - 0.02 + lift / 2, z - 0.03 - lift / 2),
        vectors(0, top - 0.2, z - 0.06 - lift),
        vectors(0, top - 0.5, z - 0.05 - lift),
    )
    radii = np.outer(sizes.girth, [0.16, 0.22, 0.3, 0.12])
    return tube(path, np.stack([radii * 0.8, radii], axis=-1), SIDEWAYS, MANE, size=6)


def _palette(count: int, rng: np.random.Generator) -> Float[np.ndarray, "B M 3"]:
    colors = np.stack([palette(codes) for codes in COATS.values()])[rng.choice(len(COATS), count, p=SHARES)]
    coat, mane, point = (vary(colors[:, material], rng) for material in range(3))
    white = shades("d2d2d2", count, rng)
    point = np.where(rng.random((count, 1)) < 0.25, white, point)
    muzzle = np.where(rng.random((count, 1)) < 0.3, white, (coat + point) / 2)
    patch = np.where(rng.random((count, 1)) < 0.12, white, coat)
    return np.stack([coat, mane, point, muzzle, patch, 0.5 * point + 0.05], axis=1)
