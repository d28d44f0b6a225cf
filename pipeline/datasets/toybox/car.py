"""Cars of six styles: a lofted lower body, a cabin with sloping glass, wheels, lights and bumpers."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from pipeline.datasets.toybox.model import Specimens, spread, vectors
from pipeline.datasets.toybox.paint import car_paint, jitter
from pipeline.datasets.toybox.solids import Solid, box, ellipsoid, join, kept, loft, mirrored, moved, superellipse

BODY, GLASS, ROOF, PILLAR, TYRE, HUB, HEAD_LIGHT, TAIL_LIGHT, BUMPER, GRILLE, PLATE, ARCH, SILL, DECK = range(14)
GLOSS = np.array([0.22, 0.22, 0.22, 0.15, 0.02, 0.3, 0.3, 0.15, 0.15, 0.1, 0.05, 0.0, 0.15, 0.2])

# Low and high of: length, width, height in metres; then positions along the length, from the front, of the windscreen's foot and top, of
# the roof's rear end and the rear window's foot; then the heights of bonnet, belt line and boot as shares of the height.
STYLES = {
    "sedan": (
        (4.4, 5.1),
        (1.72, 1.9),
        (1.38, 1.5),
        (0.26, 0.33),
        (0.13, 0.18),
        (0.64, 0.72),
        (0.80, 0.87),
        (0.52, 0.58),
        (0.62, 0.67),
        (0.60, 0.66),
    ),
    "hatchback": (
        (3.5, 4.3),
        (1.62, 1.8),
        (1.42, 1.58),
        (0.22, 0.29),
        (0.13, 0.18),
        (0.82, 0.88),
        (0.93, 0.97),
        (0.52, 0.58),
        (0.60, 0.65),
        (0.60, 0.64),
    ),
    "estate": (
        (4.4, 4.9),
        (1.72, 1.85),
        (1.4, 1.55),
        (0.25, 0.31),
        (0.12, 0.17),
        (0.86, 0.91),
        (0.95, 0.98),
        (0.53, 0.58),
        (0.61, 0.65),
        (0.60, 0.64),
    ),
    "off-roader": (
        (4.1, 5.0),
        (1.75, 2.0),
        (1.7, 1.98),
        (0.23, 0.30),
        (0.05, 0.12),
        (0.88, 0.94),
        (0.95, 0.985),
        (0.56, 0.62),
        (0.62, 0.66),
        (0.60, 0.65),
    ),
    "pickup": (
        (5.0, 5.6),
        (1.8, 2.0),
        (1.65, 1.9),
        (0.25, 0.30),
        (0.08, 0.12),
        (0.53, 0.57),
        (0.56, 0.60),
        (0.56, 0.60),
        (0.60, 0.65),
        (0.58, 0.63),
    ),
    "coupe": (
        (3.9, 4.6),
        (1.7, 1.9),
        (1.15, 1.32),
        (0.35, 0.42),
        (0.13, 0.18),
        (0.64, 0.74),
        (0.84, 0.93),
        (0.54, 0.60),
        (0.64, 0.70),
        (0.64, 0.72),
    ),
}
SHARES = (0.3, 0.2, 0.12, 0.18, 0.06, 0.14)


class Proportions(NamedTuple):
    """Sizes of each car; lengths in metres, the stations along the length as shares from the front."""

    length: np.ndarray
    width: np.ndarray
    height: np.ndarray
    cowl: np.ndarray
    roof_front: np.ndarray
    roof_rear: np.ndarray
    rear_glass: np.ndarray
    bonnet: np.ndarray
    belt: np.ndarray
    boot: np.ndarray
    wheel: np.ndarray
    clearance: np.ndarray

    def along(self, share: np.ndarray | float) -> np.ndarray:
        """Return the z coordinate of a station."""
        return (0.5 - share) * self.length


def build_cars(count: int, rng: np.random.Generator) -> Specimens:
    """Build random cars."""
    style = rng.choice(len(STYLES), count, p=SHARES)
    sizes = _proportions(style, rng)
    parts = [_lower_body(sizes), _cabin(sizes), *_wheels(sizes, rng), *_lights(sizes, rng), *_trim(sizes, rng)]
    return Specimens(join(parts), _palette(count, style == list(STYLES).index("pickup"), rng), GLOSS)


def _proportions(style: Int[np.ndarray, " B"], rng: np.random.Generator) -> Proportions:
    ranges = np.array(list(STYLES.values()))[style]
    drawn = rng.uniform(ranges[..., 0], ranges[..., 1]).T
    length, width, height, cowl, rake, roof_rear, rear_glass, bonnet, belt, boot = drawn
    wheel = spread(rng, 0.29, 0.35, len(style)) * (0.55 + 0.3 * height)
    clearance = wheel * spread(rng, 0.45, 0.7, len(style))
    return Proportions(
        length,
        width,
        height,
        cowl,
        cowl + rake,
        roof_rear,
        rear_glass,
        bonnet * height,
        belt * height,
        boot * height,
        wheel,
        clearance,
    )


def _lower_body(sizes: Proportions) -> Solid:
    middle = (sizes.cowl + sizes.rear_glass) / 2
    stations = [
        1.0,
        0.985,
        0.94,
        (sizes.rear_glass + 0.96) / 2,
        sizes.rear_glass,
        middle,
        sizes.cowl,
        sizes.cowl * 0.55,
        0.06,
        0.015,
        0.0,
    ]
    sink = 0.03 * sizes.height
    tops = [
        sizes.boot - 4 * sink, sizes.boot - 1.2 * sink, sizes.boot - 0.3 * sink, sizes.boot, sizes.belt, sizes.belt, sizes.belt,
        (sizes.belt + 2 * sizes.bonnet) / 3, sizes.bonnet - sink, sizes.bonnet - 2.5 * sink, sizes.bonnet - 5 * sink,
    ]  # fmt: skip
    lift = [3.5, 2.0, 1.0, 0.3, 0, 0, 0, 0, 0.6, 1.6, 3.0]
    plan = [0.84, 0.93, 0.97, 0.99, 1, 1, 1, 0.99, 0.94, 0.86, 0.76]
    ring = superellipse(18, 5.0)
    ring = np.column_stack([ring[:, 0] * np.where(ring[:, 1] > 0.5, 0.93, 1.0), ring[:, 1]])
    rings = []
    for station, top, rise, share in zip(stations, tops, lift, plan, strict=True):
        bottom = sizes.clearance + rise * sink
        across = ring[:, 0] * (sizes.width / 2 * share)[:, None]
        upward = ((top + bottom) / 2)[:, None] + ring[:, 1] * ((top - bottom) / 2)[:, None]
        rings.append(vectors(across, upward, sizes.along(station)[:, None]))
    materials = np.full((10, 18), BODY)
    materials[:, 9:] = np.where((ring[9:, 1] < -0.6) | (np.roll(ring[:, 1], -1)[9:] < -0.6), SILL, BODY)
    materials[:4, 2:6] = DECK
    return loft(np.stack(rings, axis=1), materials, (BODY, BODY))


def _cabin(sizes: Proportions) -> Solid:
    half = np.array(
        [[0.0, 1.02], [0.55, 1.0], [0.86, 0.97], [0.96, 0.89], [1, 0.8], [1, 0.08], [1, -0.02], [1, -0.72], [0.96, -0.87], [0.86, -0.96], [0.55, -1.0], [0, -1.02]]
    )  # fmt: skip
    outline = np.concatenate([half, half[-2:0:-1] * [-1, 1]])
    glass_side = [GLASS, GLASS, PILLAR, PILLAR, GLASS, PILLAR, GLASS, PILLAR, PILLAR, GLASS, GLASS]
    window = np.array([*glass_side, *glass_side[::-1]])
    levels = np.array([-0.12, 0.06, 0.84, 0.96, 1.0])
    rings = []
    for level, rounding in zip(levels, (1.0, 1.0, 1.0, 0.97, 0.82), strict=True):
        front = sizes.along(sizes.cowl + level * (sizes.roof_front - sizes.cowl))
        rear = sizes.along(sizes.rear_glass + level * (sizes.roof_rear - sizes.rear_glass))
        half_width = sizes.width * (0.46 - 0.075 * level) * rounding
        height = sizes.belt + level * (sizes.height - sizes.belt)
        middle, reach = (front + rear) / 2, (front - rear) / 2 * rounding
        rings.append(
            vectors(
                outline[:, 0] * half_width[:, None], height[:, None], middle[:, None] + outline[:, 1] * reach[:, None]
            )
        )
    materials = np.stack([np.full(22, BODY), window, np.full(22, ROOF), np.full(22, ROOF)])
    return loft(np.stack(rings, axis=1), materials, (BODY, ROOF))


def _wheels(sizes: Proportions, rng: np.random.Generator) -> list[Solid]:
    count = len(sizes.length)
    solids = []
    for station in (spread(rng, 0.16, 0.2, count), spread(rng, 0.78, 0.83, count)):
        z = sizes.along(station)
        x = sizes.width / 2
        solids += [
            mirrored(_disc(sizes.wheel * 1.2, x - 0.15, x * 1.004, vectors(0, sizes.wheel * 1.12, z), ARCH, ARCH)),
            mirrored(_disc(sizes.wheel, x - 0.19, x + 0.012, vectors(0, sizes.wheel, z), TYRE, TYRE)),
            mirrored(
                _disc(
                    sizes.wheel * spread(rng, 0.55, 0.72, count),
                    x - 0.05,
                    x + 0.03,
                    vectors(0, sizes.wheel, z),
                    HUB,
                    HUB,
                )
            ),
        ]
    return solids


def _disc(
    radius: np.ndarray, inner: np.ndarray, outer: np.ndarray, center: Float[np.ndarray, "B 3"], side: int, face: int
) -> Solid:
    """Build a cylinder whose axis is parallel to x, between two positions on it."""
    ring = superellipse(12, 2.0)
    rings = [
        center[:, None] + vectors(position[:, None], ring[:, 0] * radius[:, None], ring[:, 1] * radius[:, None])
        for position in (inner, outer)
    ]
    return loft(np.stack(rings, axis=1), side, (side, face))


def _lights(sizes: Proportions, rng: np.random.Generator) -> list[Solid]:
    count = len(sizes.length)
    head = vectors(sizes.width * spread(rng, 0.06, 0.11, count), sizes.height * spread(rng, 0.035, 0.065, count), 0.13)
    tail = vectors(sizes.width * spread(rng, 0.05, 0.1, count), sizes.height * spread(rng, 0.04, 0.09, count), 0.1)
    head_center = vectors(
        sizes.width * 0.36, sizes.bonnet - sizes.height * spread(rng, 0.11, 0.15, count), sizes.along(0.025)
    )
    tail_center = vectors(
        sizes.width * 0.39, sizes.boot - sizes.height * spread(rng, 0.12, 0.18, count), sizes.along(0.98)
    )
    return [
        mirrored(moved(ellipsoid(head, HEAD_LIGHT, 3.0), head_center)),
        mirrored(moved(ellipsoid(tail, TAIL_LIGHT, 5.0), tail_center)),
    ]


def _trim(sizes: Proportions, rng: np.random.Generator) -> list[Solid]:
    count = len(sizes.length)
    low = sizes.clearance + 0.14 * sizes.height
    bumper = vectors(sizes.width * 0.46, sizes.height * spread(rng, 0.05, 0.08, count), 0.12)
    grille = vectors(sizes.width * spread(rng, 0.12, 0.26, count), sizes.height * spread(rng, 0.03, 0.07, count), 0.06)
    plate = np.tile([0.26, 0.06, 0.03], (count, 1))
    mirror = np.tile([0.11, 0.08, 0.06], (count, 1))
    at_mirror = vectors(sizes.width * 0.5, sizes.belt + 0.06, sizes.along(sizes.cowl + 0.05))
    present = rng.random(count) < 0.8
    return [
        moved(ellipsoid(bumper, BUMPER, 6.0), vectors(0, low, sizes.along(0.022))),
        moved(ellipsoid(bumper, BUMPER, 6.0), vectors(0, low, sizes.along(0.978))),
        moved(ellipsoid(grille, GRILLE, 6.0), vectors(0, sizes.bonnet - 0.19 * sizes.height, sizes.along(0.01))),
        kept(moved(box(plate, PLATE), vectors(0, low, sizes.along(-0.008))), present),
        kept(moved(box(plate, PLATE), vectors(0, sizes.boot - 0.24 * sizes.height, sizes.along(1.0))), present),
        mirrored(moved(ellipsoid(mirror, BODY, 4.0), at_mirror)),
    ]


def _palette(count: int, open_deck: np.ndarray, rng: np.random.Generator) -> Float[np.ndarray, "B 14 3"]:
    paint = car_paint(count, rng)
    dark = jitter(np.full((count, 3), 0.04), 0.02, rng)
    chrome = jitter(np.full((count, 3), 0.62), 0.12, rng)
    palette = np.repeat(paint[:, None], 14, axis=1)
    palette[:, GLASS] = jitter(np.array([0.05, 0.06, 0.07]) * rng.uniform(0.5, 3.0, (count, 1)), 0.02, rng)
    two_tone = rng.random(count)
    palette[two_tone < 0.1, ROOF] = car_paint(count, rng)[two_tone < 0.1]
    palette[:, PILLAR] = np.where(rng.random((count, 1)) < 0.5, paint, dark)
    palette[:, TYRE] = dark + 0.02
    palette[:, HUB] = np.where(rng.random((count, 1)) < 0.8, chrome, dark + 0.1)
    palette[:, HEAD_LIGHT] = jitter(np.array([0.85, 0.85, 0.8]), 0.15, rng, count)
    palette[:, TAIL_LIGHT] = jitter(np.array([0.6, 0.04, 0.03]), 0.1, rng, count)
    kind = rng.random((count, 1))
    palette[:, BUMPER] = np.where(kind < 0.5, paint, np.where(kind < 0.75, dark + 0.08, chrome))
    palette[:, GRILLE] = np.where(rng.random((count, 1)) < 0.7, dark, chrome)
    palette[:, PLATE] = jitter(np.array([0.8, 0.8, 0.75]), 0.15, rng, count)
    palette[:, ARCH] = 0.02
    palette[:, SILL] = np.where(rng.random((count, 1)) < 0.35, dark + 0.05, paint)
    palette[:, DECK] = np.where(open_deck[:, None], dark, paint)
    return np.clip(palette, 0.0, 1.0)
