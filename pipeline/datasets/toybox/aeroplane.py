"""Aeroplanes: airliners, fighters, and light propeller planes with one wing or two."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from pipeline.datasets.toybox.model import Specimens, vectors
from pipeline.datasets.toybox.paint import palette, pick, shades
from pipeline.datasets.toybox.solids import Solid, ellipsoid, join, kept, mirrored, moved, superellipse, tube

BODY, WING, FIN, GLASS, STRIPE, ENGINE, NOSE, WHEEL, BELLY = range(9)
GLOSS = np.array([0.2, 0.15, 0.15, 0.3, 0.2, 0.15, 0.15, 0.02, 0.15])
SIDEWAYS, FORWARD = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)

AIRFRAMES = palette("e1e1e1 e1e1e1 b3b5b6 81868b 616555 cbaa38 b33f38 3f3f45 506ca0 95907c")
LIVERIES = palette("b33030 304b95 303038 cba030 3f7c50 5995bc")

# Low and high for airliners, fighters and light planes, in units of the fuselage's length.
RANGES = {
    "half span": [(0.42, 0.52), (0.28, 0.38), (0.5, 0.75)],
    "chord at the root": [(0.17, 0.23), (0.3, 0.5), (0.16, 0.24)],
    "share of it at the tip": [(0.2, 0.35), (0.12, 0.35), (0.55, 1.0)],
    "sweep of the tip": [(0.15, 0.28), (0.15, 0.35), (-0.02, 0.05)],
    "radius of the fuselage": [(0.055, 0.075), (0.06, 0.085), (0.065, 0.1)],
    "height of the fin": [(0.14, 0.19), (0.14, 0.2), (0.12, 0.18)],
    "half span of the tailplane": [(0.15, 0.2), (0.15, 0.22), (0.16, 0.24)],
}
SHARES = (0.45, 0.25, 0.3)


class Proportions(NamedTuple):
    """Sizes of each aeroplane in units of its fuselage's length."""

    kind: np.ndarray
    span: np.ndarray
    chord: np.ndarray
    taper: np.ndarray
    sweep: np.ndarray
    radius: np.ndarray
    fin: np.ndarray
    tail: np.ndarray
    wing_z: np.ndarray
    wing_y: np.ndarray

    @property
    def airliner(self) -> np.ndarray:
        """Which are airliners."""
        return self.kind == 0

    @property
    def fighter(self) -> np.ndarray:
        """Which are fighters."""
        return self.kind == 1

    @property
    def light(self) -> np.ndarray:
        """Which are light propeller planes."""
        return self.kind == 2


def build_aeroplanes(count: int, rng: np.random.Generator) -> Specimens:
    """Build random aeroplanes."""
    sizes = _proportions(count, rng)
    parts = [*_wings(sizes, rng), *_tail(sizes, rng), *_engines(sizes, rng), *_wheels(sizes, rng)]
    return Specimens(join([_fuselage(sizes, rng), *parts]), _palette(count, rng), GLOSS)


def _proportions(count: int, rng: np.random.Generator) -> Proportions:
    kind = rng.choice(3, count, p=SHARES)
    ranges = np.array(list(RANGES.values()))[:, kind]
    drawn = rng.uniform(ranges[..., 0], ranges[..., 1])
    radius = drawn[4]
    high = (kind == 2) & (rng.random(count) < 0.5)
    return Proportions(
        kind,
        *drawn,
        wing_z=np.array([0.06, -0.08, 0.14])[kind] + rng.uniform(-0.04, 0.04, count),
        wing_y=np.where(high, 0.95, np.where(kind == 1, 0.0, -0.6)) * radius,
    )


def _fuselage(sizes: Proportions, rng: np.random.Generator) -> Solid:
    count = len(sizes.kind)
    stations = np.array([-0.5, -0.46, -0.34, -0.18, 0.0, 0.2, 0.34, 0.41, 0.46, 0.488, 0.5])
    blunt = np.array([0.12, 0.28, 0.62, 0.95, 1.0, 1.0, 1.0, 0.92, 0.72, 0.45, 0.1])
    pointed = np.array([0.6, 0.75, 0.9, 1.0, 1.0, 0.9, 0.75, 0.58, 0.38, 0.18, 0.04])
    profile = np.where(sizes.fighter[:, None], pointed, blunt) * sizes.radius[:, None]
    light = np.array([0.1, 0.2, 0.35, 0.6, 0.95, 1.05, 0.95, 0.85, 0.75, 0.6, 0.2])
    profile = np.where(sizes.light[:, None], light * sizes.radius[:, None], profile)
    rise = np.where(sizes.fighter, 0.1, 0.6)[:, None] * sizes.radius[:, None] * np.clip(-(stations + 0.15) / 0.35, 0, 1)
    path = vectors(0, rise, np.broadcast_to(stations, rise.shape))
    height = profile * rng.uniform(0.95, 1.25, count)[:, None]
    materials = np.full((10, 12), BODY)
    height_of_ring = superellipse(12, 2.0)[:, 1]
    upper, lower = (-height_of_ring > 0.8), (-height_of_ring < -0.6)
    materials[:, lower] = BELLY
    materials[2:8, (np.abs(height_of_ring) < 0.3)] = STRIPE
    materials[7:8, upper | (-height_of_ring > 0.4)] = GLASS
    materials[9:] = NOSE
    fuselage = tube(path, np.stack([profile, height], axis=-1), SIDEWAYS, materials, size=12)
    canopy_size = np.stack([0.55 * sizes.radius, 0.75 * sizes.radius, rng.uniform(0.06, 0.11, count)], axis=-1)
    canopy_at = vectors(0, 0.75 * sizes.radius, np.where(sizes.fighter, 0.24, 0.14))
    return join([fuselage, kept(moved(ellipsoid(canopy_size, GLASS), canopy_at), ~sizes.airliner)])


def _blade(
    root: np.ndarray, tip: np.ndarray, chords: tuple[np.ndarray, np.ndarray], thickness: np.ndarray, material: int
) -> Solid:
    """Build a wing or fin from its root's middle to its tip's middle; chords are lengths along z."""
    shares = np.array([0.0, 0.5, 0.97, 1.0])
    path = root[:, None] + shares[:, None] * (tip - root)[:, None]
    chord = chords[0][:, None] * (1 - shares) + chords[1][:, None] * shares * np.array([1, 1, 1, 0.6])
    radii = np.stack([chord / 2, thickness[:, None] * np.array([1.0, 0.8, 0.6, 0.2])], axis=-1)
    return tube(path, radii, FORWARD, material, exponent=2.0, size=8)


def _wings(sizes: Proportions, rng: np.random.Generator) -> list[Solid]:
    count = len(sizes.kind)
    dihedral = np.where(sizes.fighter, rng.uniform(-0.05, 0.03, count), rng.uniform(0.02, 0.12, count)) * sizes.span
    root = vectors(0, sizes.wing_y, sizes.wing_z)
    tip = vectors(sizes.span, sizes.wing_y + dihedral, sizes.wing_z - sizes.sweep)
    thickness = sizes.chord * rng.uniform(0.04, 0.07, count)
    wing = mirrored(_blade(root, tip, (sizes.chord, sizes.chord * sizes.taper), thickness, WING))
    biplane = sizes.light & (sizes.wing_y < 0) & (rng.random(count) < 0.4)
    second = moved(wing, vectors(0, rng.uniform(0.16, 0.2, count), 0.03))
    strut_at = sizes.span * 0.65
    strut = mirrored(
        _blade(
            vectors(strut_at, sizes.wing_y, sizes.wing_z),
            vectors(strut_at, sizes.wing_y + 0.2, sizes.wing_z + 0.03),
            (np.full(count, 0.02), np.full(count, 0.02)),
            np.full(count, 0.006),
            WING,
        )
    )
    return [wing, kept(join([second, strut]), biplane)]


def _tail(sizes: Proportions, rng: np.random.Generator) -> list[Solid]:
    count = len(sizes.kind)
    chord = sizes.fin * rng.uniform(0.7, 1.0, count)
    back = np.where(sizes.light, 0.03, rng.uniform(0.06, 0.12, count))
    thin = np.full(count, 0.008)
    twin = sizes.fighter & (rng.random(count) < 0.4)
    lean = np.where(twin, 0.06, 0.0)
    start = np.where(twin, 0.05, 0.0)
    root, tip = vectors(start, 0.03, -0.4), vectors(start + lean, sizes.fin + 0.03, -0.4 - back)
    fin = _blade(root, tip, (chord, chord * rng.uniform(0.4, 0.7, count)), thin, FIN)
    pair = mirrored(fin)
    t_tail = ~sizes.fighter & (rng.random(count) < 0.2)
    height = np.where(t_tail, sizes.fin, 0.25 * sizes.radius)
    plane_root = vectors(0, height, -0.42 - back * t_tail)
    plane_tip = vectors(sizes.tail, height + 0.01, -0.42 - back * (1 + t_tail))
    plane = mirrored(_blade(plane_root, plane_tip, (chord * 0.8, chord * 0.45), thin, WING))
    return [pair, plane]


def _engines(sizes: Proportions, rng: np.random.Generator) -> list[Solid]:
    count = len(sizes.kind)
    jet = np.stack([0.55 * sizes.radius, 0.55 * sizes.radius, rng.uniform(0.045, 0.07, count)], axis=-1)
    rear_mounted = sizes.airliner & (rng.random(count) < 0.2)
    four = sizes.airliner & ~rear_mounted & (rng.random(count) < 0.3)
    engines = []
    for share, present in ((0.35, sizes.airliner & ~rear_mounted), (0.65, four)):
        at = vectors(share * sizes.span, sizes.wing_y - 0.6 * sizes.radius, sizes.wing_z + 0.06 - share * sizes.sweep)
        engines.append(kept(mirrored(moved(ellipsoid(jet, ENGINE, 3.0), at)), present))
    at_rear = vectors(1.6 * sizes.radius, 0.5 * sizes.radius, -0.27)
    engines.append(kept(mirrored(moved(ellipsoid(jet, ENGINE, 3.0), at_rear)), rear_mounted))
    disc = np.stack([sizes.radius * 0.25, sizes.radius * rng.uniform(1.4, 2.0, count), np.full(count, 0.006)], axis=-1)
    return [*engines, kept(moved(ellipsoid(disc, WHEEL), vectors(0, 0 * sizes.radius, 0.505)), sizes.light)]


def _wheels(sizes: Proportions, rng: np.random.Generator) -> list[Solid]:
    count = len(sizes.kind)
    down = rng.random(count) < np.array([0.35, 0.3, 0.75])[sizes.kind]
    size = np.where(sizes.light, 0.03, 0.02)
    wheel = vectors(0.4 * size, size, size)
    depth = -1.2 * sizes.radius - 0.07
    main = mirrored(moved(ellipsoid(wheel, WHEEL), vectors(1.3 * sizes.radius, depth, sizes.wing_z - 0.02)))
    leg = mirrored(
        _blade(
            vectors(0.8 * sizes.radius, -0.5 * sizes.radius, sizes.wing_z - 0.02),
            vectors(1.3 * sizes.radius, depth, sizes.wing_z - 0.02),
            (np.full(count, 0.014), np.full(count, 0.014)),
            np.full(count, 0.006),
            ENGINE,
        )
    )
    nose = moved(ellipsoid(wheel, WHEEL), vectors(0, depth, 0.38))
    nose_leg = _blade(
        vectors(0, -0.3 * sizes.radius, 0.38),
        vectors(0, depth, 0.38),
        (np.full(count, 0.014), np.full(count, 0.014)),
        np.full(count, 0.006),
        ENGINE,
    )
    return [kept(join([main, leg, nose, nose_leg]), down)]


def _palette(count: int, rng: np.random.Generator) -> Float[np.ndarray, "B M 3"]:
    body, other, livery = (pick(colors, count, rng) for colors in (AIRFRAMES, AIRFRAMES, LIVERIES))
    colors = np.repeat(body[:, None], len(GLOSS), axis=1)
    for material, share in ((WING, 0.3), (BELLY, 0.35), (ENGINE, 0.5)):
        colors[:, material] = np.where(rng.random((count, 1)) < share, other, body)
    for material, share in ((FIN, 0.55), (STRIPE, 0.55), (NOSE, 0.3), (ENGINE, 0.2)):
        colors[:, material] = np.where(rng.random((count, 1)) < share, livery, colors[:, material])
    colors[:, GLASS] = colors[:, WHEEL] = shades("404040", count, rng)
    return colors
