"""Free-form deformation by a 4x4x4 grid of control points (Sederberg & Parry 1986; paper 3.2.1)."""

import torch
from jaxtyping import Float
from torch import Tensor

GRID_SIZE = 4
CONTROL_POINTS = GRID_SIZE**3


def control_point_weights(vertices: Float[Tensor, "V 3"]) -> Float[Tensor, "V 64"]:
    """Evaluate the trivariate Bernstein polynomials of degree three at each vertex.

    `vertices` lie in the unit cube [-0.5, 0.5]^3. Column (4 i + j) 4 + k belongs to the control point at
    (i, j, k) / 3 - 0.5 along x, y, z. Rows are non-negative and sum to 1.
    """
    parameter = vertices + 0.5
    rest = 1 - parameter
    cubics = torch.stack([rest**3, 3 * parameter * rest**2, 3 * parameter**2 * rest, parameter**3], dim=-1)
    return torch.einsum("vi,vj,vk->vijk", cubics[:, 0], cubics[:, 1], cubics[:, 2]).flatten(1)


def deform(
    vertices: Float[Tensor, "V 3"], weights: Float[Tensor, "V 64"], offsets: Float[Tensor, "B 64 3"]
) -> Float[Tensor, "B V 3"]:
    """Move each vertex by the weighted sum of the displacements of the control points.

    `offsets` are world units from the regular grid; zero offsets return `vertices` to the last bit. Gradients flow to
    both.
    """
    # All shapes in one matrix product, many times as fast as one of three columns for each. Coordinates stay apart in
    # memory, which does the same for the shapes' extents.
    moved = offsets.transpose(1, 2).reshape(-1, CONTROL_POINTS) @ weights.T
    return moved.unflatten(0, (-1, 3)).transpose(1, 2) + vertices
