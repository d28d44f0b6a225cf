"""Mirror-symmetric deformations of an icosphere: the kinds of surface that base-shape learning leaves behind."""

from collections.abc import Callable

import torch
from torch import Tensor

from pipeline.geometry.icosphere import icosphere
from pipeline.geometry.normalize import fit_unit_cube


def bump(directions: Tensor, x: float, y: float, z: float, width: float) -> Tensor:
    """Weigh directions by nearness to (x, y, z) and its mirror image: (V, 1)."""
    mirrored = torch.stack([directions[:, 0].abs(), directions[:, 1], directions[:, 2]], dim=1)
    center = torch.nn.functional.normalize(torch.tensor([x, y, z], dtype=directions.dtype), dim=0)
    return (-(mirrored - center).square().sum(dim=1, keepdim=True) / (2 * width**2)).exp()


def dented(directions: Tensor) -> Tensor:
    """Press the sides, the top and the bottom of a sphere inwards."""
    dents = (
        0.7 * bump(directions, 1, 0, 0, 0.4)
        + 0.6 * bump(directions, 0, 1, 0, 0.4)
        + 0.5 * bump(directions, 0, -1, 0, 0.3)
    )
    return directions * (1 - dents)


def car(directions: Tensor) -> Tensor:
    """Shape a box with a cabin: flat sides, hard corners and concave edges before and behind the cabin."""
    box = torch.sign(directions) * directions.abs() ** 0.4 * torch.tensor([0.8, 0.45, 1.8], dtype=directions.dtype)
    cabin = torch.sigmoid(12 * (0.9 - box[:, 2].abs())) * (directions[:, 1] > 0.2)
    return box + torch.stack([-0.2 * box[:, 0] * cabin, 0.5 * cabin, 0 * cabin], dim=1)


def horse(directions: Tensor) -> Tensor:
    """Pull four legs, a neck and a head out of an ellipsoid: long, thin and stretched polygons."""
    body = directions * torch.tensor([0.45, 0.5, 1.1], dtype=directions.dtype)
    front, back = bump(directions, 0.45, -0.6, 0.65, 0.14), bump(directions, 0.45, -0.6, -0.65, 0.14)
    head = bump(directions, 0, 0.5, 0.9, 0.2)
    down, forward = torch.tensor([0.0, -1.3, 0]), torch.tensor([0.0, 0.7, 0.9])
    return body + (front + back) * down.to(body) + head * forward.to(body)


def finned(directions: Tensor) -> Tensor:
    """Squeeze the top of a sphere into a thin upright fin whose two sides touch."""
    top = torch.sigmoid(20 * (directions[:, 1:2] - 0.5))
    squeeze = torch.cat([1 - 0.995 * top, 1 + 0.6 * top, torch.ones_like(top)], dim=1)
    return directions * squeeze


SHAPES: dict[str, Callable[[Tensor], Tensor]] = {"dented": dented, "car": car, "horse": horse, "finned": finned}


def deformed_sphere(name: str, subdivisions: int = 3) -> tuple[Tensor, Tensor, Tensor]:
    """Return vertices in the unit cube (V, 3), faces (F, 3) and directions (V, 3) of a shape."""
    directions, faces = icosphere(subdivisions)
    return fit_unit_cube(SHAPES[name](directions)[None])[0], faces, directions
