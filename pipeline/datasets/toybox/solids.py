"""Closed solids with random proportions: one topology per kind of object, one set of vertices per picture."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int


class Solid(NamedTuple):
    """A batch of surfaces that share their faces.

    Every connected part is closed, and its faces are counter-clockwise seen from outside, so the inside of the whole is
    where the winding number is positive. Parts may overlap. A part that a picture lacks has all vertices at the origin.
    """

    vertices: Float[np.ndarray, "B V 3"]
    faces: Int[np.ndarray, "F 3"]
    materials: Int[np.ndarray, " F"]


def join(solids: Sequence[Solid]) -> Solid:
    """Return one solid that has the parts of all."""
    offsets = np.cumsum([0, *(solid.vertices.shape[1] for solid in solids[:-1])])
    return Solid(
        np.concatenate([solid.vertices for solid in solids], axis=1),
        np.concatenate([solid.faces + offset for solid, offset in zip(solids, offsets, strict=True)]),
        np.concatenate([solid.materials for solid in solids]),
    )


def mirrored(solid: Solid) -> Solid:
    """Return the solid together with its mirror image about the plane x = 0."""
    image = Solid(solid.vertices * np.array([-1.0, 1.0, 1.0]), solid.faces[:, ::-1], solid.materials)
    return join([solid, image])


def moved(solid: Solid, offset: Float[np.ndarray, "B 3"]) -> Solid:
    """Return the solid translated by a vector per picture."""
    return solid._replace(vertices=solid.vertices + offset[:, None])


def kept(solid: Solid, present: np.ndarray) -> Solid:
    """Return the solid shrunk into the origin, which should lie in the object's box, where `present` (B,) is false."""
    return solid._replace(vertices=np.where(present[:, None, None], solid.vertices, 0.0))


def loft(
    rings: Float[np.ndarray, "B R S 3"], materials: int | Int[np.ndarray, "R-1 S"], caps: tuple[int, int]
) -> Solid:
    """Skin a row of rings into a closed tube.

    Each ring turns counter-clockwise as seen from the last ring. `materials` says what the strip between two rings is
    made of, per segment from one ring point to the next; `caps` does so for the first and the last end, which fan out
    from their mean.
    """
    batch, count, size, _ = rings.shape
    ends = rings[:, [0, -1]].mean(axis=2)
    vertices = np.concatenate([rings.reshape(batch, count * size, 3), ends], axis=1)
    here = np.arange(size)
    following = (here + 1) % size
    base = np.arange(count - 1)[:, None] * size
    corners = base + here, base + following, base + size + following, base + size + here
    first, second, third, fourth = (np.broadcast_to(corner, (count - 1, size)) for corner in corners)
    sides = np.stack([np.stack([first, second, third], -1), np.stack([first, third, fourth], -1)], axis=2).reshape(
        -1, 3
    )
    bottom = np.stack([np.full(size, count * size), following, here], axis=-1)
    last = (count - 1) * size
    top = np.stack([np.full(size, count * size + 1), last + here, last + following], axis=-1)
    side_materials = np.repeat(np.broadcast_to(materials, (count - 1, size)).reshape(-1), 2)
    cap_materials = np.repeat(np.array(caps), size)
    return Solid(vertices, np.concatenate([sides, bottom, top]), np.concatenate([side_materials, cap_materials]))


def superellipse(size: int, exponent: float) -> Float[np.ndarray, "S 2"]:
    """Return a counter-clockwise ring between a circle (exponent 2) and the square [-1, 1]^2."""
    angle = (np.arange(size) + 0.5) * (2 * np.pi / size)
    wave = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return np.sign(wave) * np.abs(wave) ** (2 / exponent)


def ellipsoid(radii: Float[np.ndarray, "B 3"], material: int, exponent: float = 2.0, size: int = 8) -> Solid:
    """Return an ellipsoid about the origin, its poles on the z axis; a larger exponent makes it boxy."""
    ring = superellipse(size, exponent)
    angle = np.linspace(0.12, np.pi - 0.12, 6)
    profile, height = np.sin(angle) ** (2 / exponent), -np.sign(np.cos(angle)) * np.abs(np.cos(angle)) ** (2 / exponent)
    across = profile[:, None, None] * ring
    rings = np.concatenate([across, np.broadcast_to(height[:, None, None], (*across.shape[:2], 1))], axis=-1)
    return loft(rings * radii[:, None, None], material, (material, material))


def box(radii: Float[np.ndarray, "B 3"], material: int) -> Solid:
    """Return a box about the origin of the given half sizes."""
    ring = np.array([[1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]])
    rings = np.stack([np.column_stack([ring, np.full(4, depth)]) for depth in (-1.0, 1.0)])
    return loft(rings * radii[:, None, None], material, (material, material))


def tube(
    path: Float[np.ndarray, "B R 3"],
    radii: Float[np.ndarray, "B R 2"],
    across: tuple[float, float, float],
    materials: int | Int[np.ndarray, "R-1 S"],
    exponent: float = 2.0,
    size: int = 8,
) -> Solid:
    """Return a bent tube, blade or slab along a path.

    Its cross-sections are superellipses with the first radius along the unit vector `across` and the second along the
    normal of that and the path.
    """
    tangent = np.gradient(path, axis=1)
    upward = np.cross(tangent, np.array(across))
    upward /= np.linalg.norm(upward, axis=-1, keepdims=True) + 1e-9
    ring = superellipse(size, exponent)
    sideways = ring[:, :1] * radii[:, :, None, :1] * np.array(across)
    rings = path[:, :, None] + sideways + ring[:, 1:] * radii[:, :, None, 1:] * upward[:, :, None]
    ends = (materials, materials) if isinstance(materials, int) else (int(materials[0, 0]), int(materials[-1, 0]))
    return loft(rings, materials, ends)
