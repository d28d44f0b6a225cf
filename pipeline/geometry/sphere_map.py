"""One-to-one maps from surfaces of genus 0 to the unit sphere, the domain of textures."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

from pipeline.errors import MeshError
from pipeline.geometry.topology import polygon_areas
from pipeline.ranges import Count, NonNegative

SMALLEST_RATIO = 1e-12
"""Least enlargement whose logarithm is taken: areas vanish below single precision in the first embedding of a long
limb."""
UNFOLDING_ROUNDS = 100
"""At most; some tens are enough for the few triangles that need it."""


@dataclass(frozen=True)
class SphereMapConfig:
    """How areas are evened out."""

    iterations: Count
    """Number of embeddings, each correcting the areas of the one before, at least 1."""
    correction: NonNegative
    """Power of the area ratio by which springs are stiffened in an iteration: 0 leaves a plain Tutte embedding."""


def map_to_sphere(
    vertices: Float[Tensor, "V 3"],
    faces: Int[Tensor, "F 3"],
    loop: Int[Tensor, " K"],
    side: Int[Tensor, " V"],
    config: SphereMapConfig,
) -> Float[Tensor, "V 3"]:
    """Map a surface of genus 0 one-to-one to the unit sphere.

    The surface is cut in two disks along `loop`, which goes to the great circle x = 0; `side` is 1 for the vertices of
    the disk that the loop runs around counter-clockwise, seen from outside, -1 for the other disk's and 0 on the loop.
    Without the other disk the map covers the hemisphere x >= 0. Springs along the edges embed both disks in the unit
    disk, which cannot fold (Tutte 1963), and Lambert's equal-area projection lifts each to its hemisphere. Where the
    map enlarges the surface the springs are stiffened and the embedding is repeated (after Yoshizawa, Belyaev & Seidel
    2004). Of all iterations the one that distorts areas least is kept. Last, a turn about the x axis makes directions
    agree with positions best. Return unit vectors in double precision. Raises MeshError when every embedding has a
    flipped triangle.
    """
    vertices = vertices.double()
    adjacency = _adjacency(faces)
    stiffness = adjacency.clone()
    spacing = (vertices[loop.roll(-1)] - vertices[loop]).norm(dim=1)
    best, least_distortion = None, math.inf
    for _ in range(config.iterations):
        positions = _embed(stiffness, spacing, loop)
        directions = _unfold(_lift(positions, side), faces, adjacency, side)
        if (distortion := area_distortion(vertices, faces, directions)) < least_distortion:
            best, least_distortion = directions, distortion
        enlargement = _enlargement(vertices, faces, positions)
        stiffness *= (enlargement[:, None] * enlargement).sqrt() ** config.correction
        stiffness /= stiffness.max()
        # A length goes with the root of an area.
        spacing /= (enlargement[loop] * enlargement[loop.roll(-1)]).sqrt() ** (config.correction / 2)
    if best is None:
        raise MeshError(
            "every map of the mesh to the sphere folds, expected one that does not: the mesh is too distorted"
        )
    return _turn_towards(best, vertices, faces)


def solid_angles(directions: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"]) -> Float[Tensor, " F"]:
    """Measure the areas of spherical triangles, negative where flipped (Van Oosterom & Strackee 1983).

    `directions` are unit vectors; the result is in steradians.
    """
    a, b, c = directions[faces].unbind(dim=1)
    volume = (a * torch.linalg.cross(b, c)).sum(dim=1)
    return 2 * torch.atan2(volume, 1 + (a * b).sum(dim=1) + (b * c).sum(dim=1) + (c * a).sum(dim=1))


def area_ratios(
    vertices: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"], directions: Float[Tensor, "V 3"]
) -> Float[Tensor, " F"]:
    """Divide each face's share of the sphere by its share of the surface: 1 where the map keeps areas."""
    areas, angles = polygon_areas(vertices, faces), solid_angles(directions, faces)
    return (angles / angles.sum()) / (areas / areas.sum())


def area_distortion(
    vertices: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"], directions: Float[Tensor, "V 3"]
) -> float:
    """Average over the surface the factor, at least 1, between a face's shares of the sphere and of the surface.

    Infinite when a spherical triangle is flipped or empty.
    """
    ratios = area_ratios(vertices, faces, directions)
    if ratios.min() <= 0:
        return math.inf
    areas = polygon_areas(vertices, faces)
    return (torch.maximum(ratios, 1 / ratios) * areas / areas.sum()).sum().item()


def _adjacency(faces: Int[Tensor, "F 3"]) -> Float[Tensor, "V V"]:
    vertex_count = int(faces.max()) + 1
    adjacency = torch.zeros(vertex_count, vertex_count, dtype=torch.float64)
    adjacency[faces, faces.roll(-1, dims=1)] = 1
    return torch.maximum(adjacency, adjacency.T)


def _embed(
    stiffness: Float[Tensor, "V V"], spacing: Float[Tensor, " K"], loop: Int[Tensor, " K"]
) -> Float[Tensor, "V 2"]:
    """Spread the loop over the unit circle by the spacing and let springs pull the other vertices between it."""
    turn = 2 * math.pi * (spacing.cumsum(0) - spacing) / spacing.sum()
    positions = stiffness.new_zeros(len(stiffness), 2)
    positions[loop] = torch.stack([turn.cos(), turn.sin()], dim=1)
    inner = torch.ones(len(stiffness), dtype=torch.bool).index_fill(0, loop, False)
    laplacian = stiffness.sum(dim=1).diag() - stiffness
    positions[inner] = torch.linalg.solve(laplacian[inner][:, inner], stiffness[inner] @ positions)
    return positions


def _lift(positions: Float[Tensor, "V 2"], side: Int[Tensor, " V"]) -> Float[Tensor, "V 3"]:
    """Project the unit disk in y and z to either hemisphere, keeping areas (Lambert 1772)."""
    squared = positions.square().sum(dim=1, keepdim=True)
    return torch.cat([side[:, None] * (1 - squared), positions * (2 - squared).sqrt()], dim=1)


def _unfold(
    directions: Float[Tensor, "V 3"],
    faces: Int[Tensor, "F 3"],
    adjacency: Float[Tensor, "V V"],
    side: Int[Tensor, " V"],
) -> Float[Tensor, "V 3"]:
    """Pull the corners of flipped triangles between their neighbours.

    A triangle whose sides are straight in the disk can be flipped when they become great circles. Where there is but
    one disk its border stays on the great circle x = 0.
    """
    on_plane = (side == 0) & (side.min() == 0)
    for _ in range(UNFOLDING_ROUNDS):
        flipped = solid_angles(directions, faces) <= 0
        if not flipped.any():
            break
        corners = faces[flipped].unique()
        middle = adjacency[corners] @ directions
        middle[on_plane[corners], 0] = 0
        directions = directions.index_copy(0, corners, functional.normalize(middle, dim=1))
    return directions


def _enlargement(
    vertices: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"], positions: Float[Tensor, "V 2"]
) -> Float[Tensor, " V"]:
    """Average by how much the embedding in the disk enlarges the faces around each vertex, geometrically.

    Areas in the disk stay positive where a triangle of the sphere with long sides is still flipped.
    """
    embedded = polygon_areas(functional.pad(positions, (0, 1)), faces)
    logarithms = (embedded / polygon_areas(vertices, faces)).clamp(min=SMALLEST_RATIO).log()
    total = logarithms.new_zeros(len(vertices)).index_add(0, faces.flatten(), logarithms.repeat_interleave(3))
    return (total / torch.bincount(faces.flatten())).exp()


def _turn_towards(
    directions: Float[Tensor, "V 3"], vertices: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"]
) -> Float[Tensor, "V 3"]:
    """Turn directions about the x axis so that they point where the surface is, seen from its centroid."""
    weights = polygon_areas(vertices, faces)
    centers = vertices[faces].mean(dim=1)
    offsets = centers - (weights[:, None] * centers).sum(dim=0) / weights.sum()
    moments = (weights[:, None] * directions[faces].mean(dim=1)).T @ offsets
    angle = torch.atan2(moments[1, 2] - moments[2, 1], moments[1, 1] + moments[2, 2])
    x, y, z = directions.unbind(dim=1)
    return torch.stack([x, angle.cos() * y - angle.sin() * z, angle.sin() * y + angle.cos() * z], dim=1)
