"""Chairs: dining chairs, armchairs and office chairs; panels, slats or cushions at the back."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from pipeline.datasets.toybox.model import Specimens, between, polyline, vectors
from pipeline.datasets.toybox.paint import palette, pick
from pipeline.datasets.toybox.solids import Solid, ellipsoid, join, kept, mirrored, moved, tube

FRAME, SEAT, BACK, LEG = range(4)
GLOSS = np.array([0.12, 0.04, 0.06, 0.15])
SIDEWAYS, FORWARD = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)


WOODS = palette("956f4b 6f4b30 b3956f 453830 cbc8c2")
METALS = palette("bcbcbc 383838 89898b dadada")
FABRICS = palette("3f3f45 aa3f3f 455989 b3a690 898989 cbc8c2 598159 c48938 815d45 5995a0")


class Proportions(NamedTuple):
    """Sizes of each chair in metres, and which parts it has."""

    width: np.ndarray
    depth: np.ndarray
    seat: np.ndarray
    """Height of the seat."""
    top: np.ndarray
    """Height of the back's upper edge."""
    cushion: np.ndarray
    """Half the thickness of the seat."""
    lean: np.ndarray
    """How far the back's upper edge is behind the seat."""
    splay: np.ndarray
    """How far the feet stand outside of the seat."""
    upholstered: np.ndarray
    office: np.ndarray
    slatted: np.ndarray
    arms: np.ndarray

    @property
    def rear(self) -> np.ndarray:
        """Depth coordinate at which the back starts."""
        return -0.46 * self.depth

    def on_back(self, x: np.ndarray | float, share: float) -> Float[np.ndarray, "B 3"]:
        """Return a point of the back: `share` of the way from the seat to the upper edge."""
        return vectors(x, self.seat + share * (self.top - self.seat), self.rear - share * self.lean)


def build_chairs(count: int, rng: np.random.Generator) -> Specimens:
    """Build random chairs."""
    sizes = _proportions(count, rng)
    solid = join([_seat(sizes), *_legs(sizes, rng), *_office_base(sizes), *_back(sizes, rng), *_arms(sizes, rng)])
    return Specimens(solid, _palette(sizes, rng), GLOSS)


def _proportions(count: int, rng: np.random.Generator) -> Proportions:
    kind = rng.random(count)
    upholstered, office = kind < 0.25, kind > 0.8
    width = np.where(upholstered, rng.uniform(0.55, 0.85, count), rng.uniform(0.4, 0.52, count))
    seat = np.where(upholstered, rng.uniform(0.36, 0.44, count), rng.uniform(0.42, 0.5, count))
    return Proportions(
        width=width,
        depth=width * rng.uniform(0.88, 1.08, count),
        seat=seat,
        top=seat + np.where(upholstered, rng.uniform(0.35, 0.6, count), rng.uniform(0.32, 0.6, count)),
        cushion=np.where(upholstered, rng.uniform(0.07, 0.12, count), rng.uniform(0.015, 0.05, count)),
        lean=rng.uniform(0.02, 0.16, count),
        splay=np.where(rng.random(count) < 0.5, 0.0, rng.uniform(0.0, 0.08, count)),
        upholstered=upholstered,
        office=office,
        slatted=~upholstered & ~office & (rng.random(count) < 0.5),
        arms=upholstered | (rng.random(count) < 0.3),
    )


def _seat(sizes: Proportions) -> Solid:
    half_depth = sizes.depth / 2
    path = polyline(*(vectors(0, sizes.seat, share * half_depth) for share in (-1.0, -0.9, 0.0, 0.85, 1.0)))
    half_width = np.stack([sizes.width * share for share in (0.42, 0.46, 0.5, 0.5, 0.45)], axis=1)
    thickness = np.stack([sizes.cushion * share for share in (0.8, 1.0, 1.0, 1.0, 0.7)], axis=1)
    return tube(path, np.stack([half_width, thickness], axis=-1), SIDEWAYS, SEAT, exponent=4.5, size=12)


def _rod(
    start: np.ndarray, end: np.ndarray, radius: np.ndarray, material: int, across: tuple[float, float, float]
) -> Solid:
    radii = np.repeat(radius[:, None, None], 2, axis=1)
    return tube(between(start, end, (0.0, 1.0)), np.repeat(radii, 2, axis=2), across, material, exponent=3.0, size=6)


def _legs(sizes: Proportions, rng: np.random.Generator) -> list[Solid]:
    count = len(sizes.width)
    radius = np.where(rng.random(count) < 0.4, rng.uniform(0.009, 0.014, count), rng.uniform(0.015, 0.03, count))
    x, foot = 0.44 * sizes.width, 0.44 * sizes.width + sizes.splay
    legs = []
    for z, outside in ((0.42 * sizes.depth, 1.0), (sizes.rear * 0.95, -1.0)):
        lower = vectors(foot, 0 * foot, z + outside * sizes.splay)
        legs.append(mirrored(_rod(vectors(x, sizes.seat, z), lower, radius, LEG, SIDEWAYS)))
    height = sizes.seat * rng.uniform(0.25, 0.6, count)
    bar_front, bar_rear = vectors(x, height, 0.42 * sizes.depth), vectors(x, height, sizes.rear * 0.95)
    bars = mirrored(_rod(bar_rear, bar_front, radius * 0.7, LEG, SIDEWAYS))
    return [kept(join(legs), ~sizes.office), kept(bars, ~sizes.office & (rng.random(count) < 0.35))]


def _office_base(sizes: Proportions) -> list[Solid]:
    """Build a column on a five-pointed star with castors, one point to the front."""
    count = len(sizes.width)
    hub = vectors(0, 0.09 + 0 * sizes.seat, 0)
    parts = [_rod(vectors(0, sizes.seat, 0), hub, np.full(count, 0.028), LEG, SIDEWAYS)]
    for angle in (0.0, 0.4 * np.pi, 0.8 * np.pi):
        tip = vectors(np.sin(angle) * 0.3, 0.06 + 0 * sizes.seat, np.cos(angle) * 0.3)
        across = (float(np.cos(angle)), 0.0, float(-np.sin(angle)))
        arm = _rod(hub, tip, np.full(count, 0.02), LEG, across)
        castor = moved(ellipsoid(np.full((count, 3), 0.03), LEG), tip - np.array([0, 0.03, 0]))
        parts += [arm, castor] if angle == 0 else [mirrored(arm), mirrored(castor)]
    return [kept(join(parts), sizes.office)]


def _back(sizes: Proportions, rng: np.random.Generator) -> list[Solid]:
    count = len(sizes.width)
    thickness = np.where(sizes.upholstered, rng.uniform(0.06, 0.1, count), rng.uniform(0.01, 0.025, count))
    rounding = rng.uniform(0.75, 1.0, count)
    lowest = np.where(sizes.upholstered | (rng.random(count) < 0.5), 0.0, rng.uniform(0.2, 0.5, count))
    shares = [lowest + share * (1 - lowest) for share in (0.0, 0.06, 0.55, 0.93, 1.0)]
    rise = sizes.top - sizes.seat
    path = polyline(*(vectors(0, sizes.seat + s * rise, sizes.rear - s * sizes.lean) for s in shares))
    half_width = np.stack([0.46 * sizes.width * share for share in (0.93, 1.0, 1.0, rounding, rounding * 0.8)], axis=1)
    slab = np.stack([half_width, np.repeat(thickness[:, None], 5, axis=1)], axis=-1)
    panel = tube(path, slab, SIDEWAYS, BACK, exponent=4.0, size=12)
    radius = rng.uniform(0.01, 0.022, count)
    posts = mirrored(
        _rod(sizes.on_back(0.42 * sizes.width, -0.1), sizes.on_back(0.42 * sizes.width, 1.0), radius, FRAME, SIDEWAYS)
    )
    return [kept(panel, ~sizes.slatted), kept(posts, ~sizes.upholstered), *_slats(sizes, radius, rng)]


def _slats(sizes: Proportions, radius: np.ndarray, rng: np.random.Generator) -> list[Solid]:
    """Build rails across the back or, in some chairs, upright spindles below the top rail."""
    count = len(sizes.width)
    spindles = rng.random(count) < 0.4
    half = 0.42 * sizes.width
    rails = []
    for share in (0.95, 0.62, 0.3):
        path = between(sizes.on_back(-half, share), sizes.on_back(half, share), (0.0, 1.0))
        height = np.repeat(np.stack([radius * 0.8, radius * 2.0], axis=-1)[:, None], 2, axis=1)
        rail = tube(path, height, FORWARD, FRAME, exponent=4.0, size=6)
        rails.append(kept(rail, sizes.slatted & (~spindles | (share > 0.9))))
    for share in (0.15, 0.5):
        spindle = _rod(
            sizes.on_back(share * half, 0.0), sizes.on_back(share * half, 0.95), radius * 0.6, FRAME, SIDEWAYS
        )
        rails.append(kept(mirrored(spindle), sizes.slatted & spindles))
    return rails


def _arms(sizes: Proportions, rng: np.random.Generator) -> list[Solid]:
    count = len(sizes.width)
    height = sizes.seat + rng.uniform(0.17, 0.26, count)
    x, front = 0.5 * sizes.width, sizes.depth * rng.uniform(0.25, 0.42, count)
    radius = rng.uniform(0.012, 0.025, count)
    rest = _rod(vectors(x, height, sizes.rear), vectors(x, height, front), radius, FRAME, SIDEWAYS)
    post = _rod(
        vectors(x * 0.96, sizes.seat, front * 0.95), vectors(x, height, front * 0.95), radius * 0.8, FRAME, SIDEWAYS
    )
    open_arms = kept(mirrored(join([rest, post])), sizes.arms & ~sizes.upholstered)
    middle = (height + sizes.seat * 0.55) / 2
    path = between(vectors(x, middle, sizes.rear), vectors(x, middle, front * 1.1), (0.0, 0.05, 0.9, 1.0))
    half_height = (height - sizes.seat * 0.55) / 2
    radii = np.stack(
        [np.outer(sizes.width, [0.06, 0.09, 0.09, 0.06]), np.outer(half_height, [0.9, 1, 1, 0.85])], axis=-1
    )
    padded = kept(mirrored(tube(path, radii, SIDEWAYS, SEAT, exponent=4.0, size=10)), sizes.arms & sizes.upholstered)
    return [open_arms, padded]


def _palette(sizes: Proportions, rng: np.random.Generator) -> Float[np.ndarray, "B M 3"]:
    count = len(sizes.width)
    wooden = (rng.random(count) < 0.65) & ~sizes.office
    frame = np.where(wooden[:, None], pick(WOODS, count, rng), pick(METALS, count, rng))
    fabric = pick(FABRICS, count, rng)
    covered = (sizes.upholstered | sizes.office | (rng.random(count) < 0.5))[:, None]
    seat = np.where(covered, fabric, frame)
    back = np.where(covered & (rng.random((count, 1)) < 0.8), seat, frame)
    return np.stack([frame, seat, back, frame], axis=1)
