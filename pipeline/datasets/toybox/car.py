"""Cars of six styles: a lofted lower body, a cabin with sloping glass, wheels, lights and bumpers."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from pipeline.datasets.toybox.model import Specimens, vectors
from pipeline.datasets.toybox.paint import palette, shades, vary
from pipeline.datasets.toybox.solids import Solid, box, ellipsoid, join, kept, loft, mirrored, moved, superellipse

BODY, GLASS, ROOF, PILLAR, TYRE, HUB, HEAD_LIGHT, TAIL_LIGHT, BUMPER, GRILLE, PLATE, ARCH, SILL, DECK = range(14)
GLOSS = np.array([0.22, 0.22, 0.22, 0.15, 0.02, 0.3, 0.3, 0.15, 0.15, 0.1, 0.05, 0.0, 0.15, 0.2])

PAINTS = palette("e5e5e2 303035 b3b5b8 6f7376 bc3030 385095 892738 e1bc30 306f50 bcad95 5990c4 cb7c30 99b3ad 765945")
PAINT_SHARES = np.array([16, 12, 16, 9, 15, 9, 4, 6, 3, 3, 4, 2, 3, 1]) / 103

# The cabin from above, from its front to its rear on one side: x and z as shares of its half width and half length.
HALF_OUTLINE = np.array(
    [
        [0.0, 1.02], [0.55, 1.0], [0.86, 0.97], [0.96, 0.89], [1.0, 0.8], [1.0, 0.08],
        [1.0, -0.02], [1.0, -0.72], [0.96, -0.87], [0.86, -0.96], [0.55, -1.0], [0.0, -1.02],
    ]
)  # fmt: skip
HALF_WINDOWS = (GLASS, GLASS, PILLAR, PILLAR, GLASS, PILLAR, GLASS, PILLAR, PILLAR, GLASS, GLASS)

# Low and high for saloons, hatchbacks, estates, off-roaders, pickups and coupes. Sizes in metres; positions along the
# length as shares of it from the front; heights as shares of the height.
RANGES = {
    "length": [(4.4, 5.1), (3.5, 4.3), (4.4, 4.9), (4.1, 5.0), (5.0, 5.6), (3.9, 4.6)],
    "width": [(1.72, 1.9), (1.62, 1.8), (1.72, 1.85), (1.75, 2.0), (1.8, 2.0), (1.7, 1.9)],
    "height": [(1.38, 1.5), (1.42, 1.58), (1.4, 1.55), (1.7, 1.98), (1.65, 1.9), (1.15, 1.32)],
    "foot of the windscreen": [(0.26, 0.33), (0.22, 0.29), (0.25, 0.31), (0.23, 0.3), (0.25, 0.3), (0.35, 0.42)],
    "slope of the windscreen": [(0.13, 0.18), (0.13, 0.18), (0.12, 0.17), (0.05, 0.12), (0.08, 0.12), (0.13, 0.18)],
    "rear of the roof": [(0.64, 0.72), (0.82, 0.88), (0.86, 0.91), (0.88, 0.94), (0.53, 0.57), (0.64, 0.74)],
    "foot of the rear window": [(0.8, 0.87), (0.93, 0.97), (0.95, 0.98), (0.95, 0.985), (0.56, 0.6), (0.84, 0.93)],
    "height of the bonnet": [(0.52, 0.58), (0.52, 0.58), (0.53, 0.58), (0.56, 0.62), (0.56, 0.6), (0.54, 0.6)],
    "height of the belt line": [(0.62, 0.67), (0.6, 0.65), (0.61, 0.65), (0.62, 0.66), (0.6, 0.65), (0.64, 0.7)],
    "height of the boot": [(0.6, 0.66), (0.6, 0.64), (0.6, 0.64), (0.6, 0.65), (0.58, 0.63), (0.64, 0.72)],
}
PICKUP = 4
STYLE_SHARES = (0.3, 0.2, 0.12, 0.18, 0.06, 0.14)


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
    style = rng.choice(len(STYLE_SHARES), count, p=STYLE_SHARES)
    sizes = _proportions(style, rng)
    parts = [_lower_body(sizes), _cabin(sizes), *_wheels(sizes, rng), *_lights(sizes, rng), *_trim(sizes, rng)]
    return Specimens(join(parts), _palette(count, style == PICKUP, rng), GLOSS)


def _proportions(style: Int[np.ndarray, " B"], rng: np.random.Generator) -> Proportions:
    ranges = np.array(list(RANGES.values()))[:, style]
    drawn = rng.uniform(ranges[..., 0], ranges[..., 1])
    length, width, height, cowl, rake, roof_rear, rear_glass, bonnet, belt, boot = drawn
    wheel = rng.uniform(0.29, 0.35, len(style)) * (0.55 + 0.3 * height)
    clearance = wheel * rng.uniform(0.45, 0.7, len(style))
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
        sizes.boot - 4 * sink, sizes.boot - 1.2 * sink, sizes.boot - 0.3 * sink, sizes.boot,
        sizes.belt, sizes.belt, sizes.belt, (sizes.belt + 2 * sizes.bonnet) / 3,
        sizes.bonnet - sink, sizes.bonnet - 2.5 * sink, sizes.bonnet - 5 * sink,
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
    outline = np.concatenate([HALF_OUTLINE, HALF_OUTLINE[-2:0:-1] * [-1, 1]])
    rings = []
    for level, rounding in ((-0.12, 1.0), (0.06, 1.0), (0.84, 1.0), (0.96, 0.97), (1.0, 0.82)):
        front = sizes.along(sizes.cowl + level * (sizes.roof_front - sizes.cowl))
        rear = sizes.along(sizes.rear_glass + level * (sizes.roof_rear - sizes.rear_glass))
        half_width = sizes.width * (0.46 - 0.075 * level) * rounding
        height = sizes.belt + level * (sizes.height - sizes.belt)
        middle, reach = (front + rear) / 2, (front - rear) / 2 * rounding
        across, along = np.outer(half_width, outline[:, 0]), np.outer(reach, outline[:, 1])
        rings.append(vectors(across, height[:, None], middle[:, None] + along))
    windows = np.array([*HALF_WINDOWS, *HALF_WINDOWS[::-1]])
    roof = np.full(len(outline), ROOF)
    materials = np.stack([np.full(len(outline), BODY), windows, roof, roof])
    return loft(np.stack(rings, axis=1), materials, (BODY, ROOF))


def _wheels(sizes: Proportions, rng: np.random.Generator) -> list[Solid]:
    count = len(sizes.length)
    side = sizes.width / 2
    solids = []
    for station in (rng.uniform(0.16, 0.2, count), rng.uniform(0.78, 0.83, count)):
        axle = vectors(0, sizes.wheel, sizes.along(station))
        arch = axle + vectors(0, 0.12 * sizes.wheel, 0)
        rim = sizes.wheel * rng.uniform(0.55, 0.72, count)
        solids += [
            mirrored(_disc(sizes.wheel * 1.2, side - 0.15, side * 1.004, arch, ARCH)),
            mirrored(_disc(sizes.wheel, side - 0.19, side + 0.012, axle, TYRE)),
            mirrored(_disc(rim, side - 0.05, side + 0.03, axle, HUB)),
        ]
    return solids


def _disc(
    radius: np.ndarray, inner: np.ndarray, outer: np.ndarray, center: Float[np.ndarray, "B 3"], material: int
) -> Solid:
    """Build a cylinder whose axis is parallel to x, between two positions on it."""
    ring = superellipse(12, 2.0)
    around = np.outer(radius, ring[:, 0]), np.outer(radius, ring[:, 1])
    rings = [center[:, None] + vectors(position[:, None], *around) for position in (inner, outer)]
    return loft(np.stack(rings, axis=1), material, (material, material))


def _lights(sizes: Proportions, rng: np.random.Generator) -> list[Solid]:
    count = len(sizes.length)
    head = vectors(sizes.width * rng.uniform(0.06, 0.11, count), sizes.height * rng.uniform(0.035, 0.065, count), 0.13)
    tail = vectors(sizes.width * rng.uniform(0.05, 0.1, count), sizes.height * rng.uniform(0.04, 0.09, count), 0.1)
    head_center = vectors(
        sizes.width * 0.36, sizes.bonnet - sizes.height * rng.uniform(0.11, 0.15, count), sizes.along(0.025)
    )
    tail_center = vectors(
        sizes.width * 0.39, sizes.boot - sizes.height * rng.uniform(0.12, 0.18, count), sizes.along(0.98)
    )
    return [
        mirrored(moved(ellipsoid(head, HEAD_LIGHT, 3.0), head_center)),
        mirrored(moved(ellipsoid(tail, TAIL_LIGHT, 5.0), tail_center)),
    ]


def _trim(sizes: Proportions, rng: np.random.Generator) -> list[Solid]:
    count = len(sizes.length)
    low = sizes.clearance + 0.14 * sizes.height
    bumper = vectors(sizes.width * 0.46, sizes.height * rng.uniform(0.05, 0.08, count), 0.12)
    grille = vectors(sizes.width * rng.uniform(0.12, 0.26, count), sizes.height * rng.uniform(0.03, 0.07, count), 0.06)
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


def _palette(count: int, pickup: np.ndarray, rng: np.random.Generator) -> Float[np.ndarray, "B M 3"]:
    paint, second = (vary(PAINTS[rng.choice(len(PAINTS), count, p=PAINT_SHARES)], rng) for _ in range(2))
    dark, chrome, white = (shades(code, count, rng) for code in ("383838", "cdcdcd", "eaeae4"))
    kind = rng.random((count, 1))
    colors = np.repeat(paint[:, None], len(GLOSS), axis=1)
    colors[:, GLASS] = dark * rng.uniform(0.8, 3.5, (count, 1))
    colors[:, ROOF] = np.where(rng.random((count, 1)) < 0.1, second, paint)
    colors[:, PILLAR] = np.where(rng.random((count, 1)) < 0.5, paint, dark)
    colors[:, TYRE] = dark + 0.02
    colors[:, HUB] = np.where(rng.random((count, 1)) < 0.8, chrome, dark + 0.1)
    colors[:, HEAD_LIGHT] = colors[:, PLATE] = white
    colors[:, TAIL_LIGHT] = shades("cb3832", count, rng)
    colors[:, BUMPER] = np.where(kind < 0.5, paint, np.where(kind < 0.75, dark + 0.08, chrome))
    colors[:, GRILLE] = np.where(rng.random((count, 1)) < 0.7, dark, chrome)
    colors[:, ARCH] = 0.02
    colors[:, SILL] = np.where(rng.random((count, 1)) < 0.35, dark + 0.05, paint)
    colors[:, DECK] = np.where(pickup[:, None], dark, paint)
    return colors
