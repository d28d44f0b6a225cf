"""Smoothness regularisation of surfaces (paper, appendix 'Smoothness regularization')."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from pipeline.geometry.topology import Topology, topology_of
from pipeline.ranges import NonNegative

COLLAPSED = 1e-16
"""Added to products of two and of four lengths; far below those of a polygon in the unit cube, so only collapsed
polygons feel it."""


@dataclass(frozen=True)
class SmoothnessConfig:
    """Weights of the four terms and tolerances of the hinged ones, for shapes in the unit cube."""

    laplacian_squared_weight: NonNegative
    """lambda_g2: sum over vertices of the squared norm of the Laplacian."""
    laplacian_hinge_weight: NonNegative
    """lambda_g1: squared excess of the sum of norms over the tolerance."""
    laplacian_tolerance: NonNegative
    """t_l: sum over vertices of the norm of the Laplacian that goes unpunished, in world units."""
    angle_squared_weight: NonNegative
    """lambda_a2: sum over edges of the squared angle between normals."""
    angle_hinge_weight: NonNegative
    """lambda_a1: squared excess of the sum of angles over the tolerance."""
    angle_tolerance: NonNegative
    """t_a: sum over edges of the angle between normals that goes unpunished, in radians."""


def smoothness(
    vertices: Float[Tensor, "B V 3"], faces: Int[Tensor, "F 3"], config: SmoothnessConfig
) -> Float[Tensor, " B"]:
    """Sum the four smoothness terms of each mesh: L_s of the appendix.

    Terms are sums over vertices and edges, not means. Gradients flow to `vertices` and stay finite on collapsed
    polygons.
    """
    topology = topology_of(faces)
    # Coordinates first and the batch last: rows of the gathers are then long and contiguous, three times faster.
    positions = vertices.permute(1, 2, 0).contiguous()
    starts = positions.index_select(0, topology.edges[:, 0])
    edges = positions.index_select(0, topology.edges[:, 1]) - starts
    laplacian_norms = _laplacian_norms(edges, topology)
    angles = _dihedral_angles(positions, starts, edges, topology)
    return (
        config.laplacian_squared_weight * laplacian_norms.square().sum(dim=0)
        + config.laplacian_hinge_weight * _hinge(laplacian_norms, config.laplacian_tolerance)
        + config.angle_squared_weight * angles.square().sum(dim=0)
        + config.angle_hinge_weight * _hinge(angles.abs(), config.angle_tolerance)
    )


def _laplacian_norms(edges: Float[Tensor, "E 3 B"], topology: Topology) -> Float[Tensor, "V B"]:
    """Measure the distance of each vertex from the mean of its neighbours."""
    vertex_count, batch = len(topology.degrees), edges.shape[2]
    to_neighbours = edges.new_zeros(vertex_count, 3, batch)
    to_neighbours = to_neighbours.index_add(0, topology.edges[:, 0], edges).index_add(0, topology.edges[:, 1], -edges)
    return torch.linalg.vector_norm(to_neighbours, dim=1) / topology.degrees[:, None]


def _dihedral_angles(
    positions: Float[Tensor, "V 3 B"], starts: Float[Tensor, "E 3 B"], edges: Float[Tensor, "E 3 B"], topology: Topology
) -> Float[Tensor, "E B"]:
    """Measure the signed angle between the normals of the two faces at each edge: positive where convex, 0 where flat.

    The sign makes the square smooth at 0, where an arc cosine has no gradient.
    """
    first = positions.index_select(0, topology.opposite_vertices[:, 0]) - starts
    second = positions.index_select(0, topology.opposite_vertices[:, 1]) - starts
    first_normal, second_normal = _cross(edges, first), _cross(second, edges)
    edge_length = (_dot(edges, edges) + COLLAPSED).sqrt()
    return torch.atan2(-edge_length * _dot(first_normal, second), _dot(first_normal, second_normal) + COLLAPSED)


def _hinge(amounts: Float[Tensor, "N B"], tolerance: float) -> Float[Tensor, " B"]:
    return (amounts.sum(dim=0) - tolerance).clamp(min=0).square()


def _dot(a: Float[Tensor, "N 3 B"], b: Float[Tensor, "N 3 B"]) -> Float[Tensor, "N B"]:
    return (a * b).sum(dim=1)


def _cross(a: Float[Tensor, "N 3 B"], b: Float[Tensor, "N 3 B"]) -> Float[Tensor, "N 3 B"]:
    # torch.cross is ten times slower along a strided dimension.
    (ax, ay, az), (bx, by, bz) = a.unbind(dim=1), b.unbind(dim=1)
    return torch.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], dim=1)
