"""Scaling of shapes into the unit cube."""

from jaxtyping import Float
from torch import Tensor


def fit_unit_cube(vertices: Float[Tensor, "B V 3"]) -> Float[Tensor, "B V 3"]:
    """Centre each bounding box at the origin and scale its longest side to 1, so that shapes fit [-0.5, 0.5]^3.

    Proportions are kept. Gradients flow through the centre and the scale. Paper 3.1.1.
    """
    lower, upper = vertices.amin(dim=1, keepdim=True), vertices.amax(dim=1, keepdim=True)
    longest_side = (upper - lower).amax(dim=2, keepdim=True)
    return (vertices - (lower + upper) / 2) / longest_side
