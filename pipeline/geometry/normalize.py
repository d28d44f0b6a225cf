"""Bounding boxes, and scaling of shapes into the unit cube."""

from typing import NamedTuple

from jaxtyping import Float
from torch import Tensor

_RIM = 0.1
"""Share of a set of points that is its rim on one side: the outermost ones along an axis."""

_LEAST_WIDTH = 1e-9
"""From rim to rim, below which points do not stretch."""


class Box(NamedTuple):
    """The bounding boxes of some sets of points."""

    center: Float[Tensor, "B 1 K"]
    sides: Float[Tensor, "B 1 K"]


def bounding_box(points: Float[Tensor, "B V K"]) -> Box:
    """Return bounding boxes. Gradients flow to the outermost points."""
    lower, upper = points.amin(dim=1, keepdim=True), points.amax(dim=1, keepdim=True)
    return Box((lower + upper) / 2, upper - lower)


def spread_gradients(box: Box, points: Float[Tensor, "B V K"]) -> Box:
    """Return the points' boxes with gradients that are spread over their rims.

    A box then moves and grows with the means of its two rims along each axis: where all points are moved or stretched
    along the axes alike, those are the derivatives. By the derivatives of `bounding_box` each of the few outermost
    points of a shape moves and scales all the others, and growing a tip is the cheapest way to move it
    (docs/decisions.md).
    """
    if not points.requires_grad:
        return box
    count = max(1, round(_RIM * points.shape[1]))
    upper = points.topk(count, dim=1).values.mean(dim=1, keepdim=True)
    lower = points.topk(count, dim=1, largest=False).values.mean(dim=1, keepdim=True)
    middle, width = (lower + upper) / 2, upper - lower
    growth = (width - width.detach()) / width.detach().clamp_min(_LEAST_WIDTH)
    moved = (middle - middle.detach()) + (box.center - middle).detach() * growth
    return Box(box.center + moved, box.sides * (1 + growth))


def fit_unit_cube(vertices: Float[Tensor, "B V 3"]) -> Float[Tensor, "B V 3"]:
    """Centre each bounding box at the origin and scale its longest side to 1, so that shapes fit [-0.5, 0.5]^3.

    Proportions are kept. Gradients flow through the centre and the scale, see `spread_gradients`. Paper 3.1.1.
    """
    center, sides = spread_gradients(bounding_box(vertices.detach()), vertices)
    return (vertices - center) / sides.amax(dim=2, keepdim=True)
