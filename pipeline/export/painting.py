"""Painting reconstructions with what their photographs show, at the photographs' own resolution up to a limit."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from pipeline.datasets.images import to_bytes
from pipeline.geometry.camera import CameraConfig, Pose, project, rotation_from_angles
from pipeline.ranges import Count, Fraction, Positive, TextureSize
from pipeline.rendering.interpolate import interpolate
from pipeline.rendering.lighting import vertex_normals
from pipeline.rendering.rasterize import rasterize
from pipeline.rendering.renderer import Mesh
from pipeline.rendering.texture import sample_sphere_texture

_GRAB_CUT_ROUNDS = 4

Unknowns = list[Tensor]


@dataclass(frozen=True)
class PaintingConfig:
    """How a photograph is painted on its reconstruction.

    A texture is the predicted one plus maps of 1, 2, 4, ... texels a side, whose values are taken for independent and
    normally distributed; what is painted is the most probable texture after the photograph has been seen. So its colour
    spreads to what it does not show, the more evenly the farther.
    """

    photograph_size: Count
    """Pixels along a side of the square photograph, of smaller ones as many as they have."""
    texture_size: TextureSize
    """Texels along a side of the painted map; of larger predicted maps as many as they have."""
    deviation: Positive
    """Of the values of each map; colours are in [0, 1]."""
    noise: Positive
    """Deviation of the photograph's colours from the texture's where the surface faces the camera."""
    symmetry: Fraction
    """What left and right of mirror-symmetric objects get of each other's values; 1 paints both alike."""
    border: Fraction
    """Distance from the outline, relative to the picture's side, within which colours decide what is the object."""
    iterations: Count
    """Steps of conjugate gradients."""


class _Seen(NamedTuple):
    """What each pixel of a photograph shows of an object."""

    directions: Float[Tensor, "1 H W 3"]
    """On the sphere of textures; zero beside the object."""
    facing: Float[Tensor, "H W"]
    """Cosine of the angle between the surface and the line of sight, at least 0."""
    covered: Bool[Tensor, "H W"]


def paint(
    mesh: Mesh,
    predicted: Float[Tensor, "3 T T"],
    pose: Pose,
    photograph: Float[Tensor, "3 H W"],
    camera: CameraConfig,
    mirror: bool,
    config: PaintingConfig,
) -> Float[Tensor, "3 size size"]:
    """Return the predicted texture of a batch of one mesh, changed to what the photograph shows, in [0, 1].

    Pixels count by the square of the cosine at which they see the surface. Those beside the outline that look like the
    surroundings do not count (`find_object`). `mirror` says that left and right of the object look alike.
    """
    seen = _look(mesh, pose, camera, photograph.shape[-1])
    visible = find_object(photograph, seen.covered, config.border) & seen.covered
    weight = seen.facing.square() * visible / config.noise**2
    size = max(config.texture_size, predicted.shape[-1])
    start = _stretch(predicted, size)
    symmetry = config.symmetry if mirror else 0.0

    def texture(maps: Unknowns) -> Float[Tensor, "3 size size"]:
        added = config.deviation * torch.stack([_stretch(values, size) for values in maps]).sum(dim=0)
        return start + added + symmetry * added.flip(-1)

    def loss(maps: Unknowns) -> Float[Tensor, ""]:
        error = sample_sphere_texture(texture(maps)[None], seen.directions)[0] - photograph
        return (weight * error.square()).sum() + torch.stack([values.square().sum() for values in maps]).sum()

    none = [torch.zeros(3, 2**level, 2**level) for level in range(size.bit_length())]
    maps = minimize_quadratic(loss, none, config.iterations)
    return texture(maps).clamp(0, 1)


def find_object(photograph: Float[Tensor, "3 H W"], covered: Bool[Tensor, "H W"], border: float) -> Bool[Tensor, "H W"]:
    """Correct a silhouette near its outline by the colours on either side of it (GrabCut: Rother et al., 2004).

    Nothing changes farther from the outline than `border`, relative to the picture's side. A silhouette without any
    pixel that far inside, or that leaves none outside, stays as it is.
    """
    reach = round(border * covered.shape[-1])
    disk = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    silhouette = covered.numpy().astype(np.uint8)
    inside, around = cv2.erode(silhouette, disk) > 0, cv2.dilate(silhouette, disk) > 0
    if not inside.any() or around.all():
        return covered
    labels = np.where(silhouette > 0, cv2.GC_PR_FGD, cv2.GC_PR_BGD)
    labels = np.where(inside, cv2.GC_FGD, np.where(around, labels, cv2.GC_BGD)).astype(np.uint8)
    pixels = to_bytes(photograph).permute(1, 2, 0).contiguous().numpy()
    cv2.setRNGSeed(0)  # of the clusters that the colour models start from
    colors = np.zeros((2, 1, 65))
    cv2.grabCut(pixels, labels, (0, 0, 1, 1), colors[0], colors[1], _GRAB_CUT_ROUNDS, cv2.GC_INIT_WITH_MASK)
    return torch.from_numpy((labels == cv2.GC_FGD) | (labels == cv2.GC_PR_FGD))


def minimize_quadratic(loss: Callable[[Unknowns], Float[Tensor, ""]], start: Unknowns, iterations: int) -> Unknowns:
    """Minimize a convex quadratic function of several tensors by conjugate gradients."""

    def gradient(values: Unknowns) -> Unknowns:
        values = [value.detach().requires_grad_() for value in values]
        return list(torch.autograd.grad(loss(values), values))

    at_start, zero = gradient(start), gradient([torch.zeros_like(value) for value in start])
    values, residual = start, [-part for part in at_start]
    direction, squared_norm = residual, _dot(residual, residual)
    for _ in range(iterations):
        if squared_norm == 0:
            break
        curvature = [part - offset for part, offset in zip(gradient(direction), zero, strict=True)]
        step = squared_norm / _dot(direction, curvature)
        values = _add(values, step, direction)
        residual = _add(residual, -step, curvature)
        squared_norm, previous = _dot(residual, residual), squared_norm
        direction = _add(residual, squared_norm / previous, direction)
    return values


def _look(mesh: Mesh, pose: Pose, camera: CameraConfig, size: int) -> _Seen:
    vertices, faces, directions = mesh
    fragments = rasterize(project(vertices, pose, camera), faces, size)
    eye = camera.distance * rotation_from_angles(pose.azimuth, pose.elevation, pose.roll)[:, 2]
    sight = functional.normalize(eye[:, None] - vertices, dim=-1)
    cosine = (vertex_normals(vertices, faces) * sight).sum(dim=-1, keepdim=True)
    found = interpolate(torch.cat([directions[None], cosine], dim=-1), faces, fragments)
    return _Seen(found[..., :3], found[0, ..., 3].clamp(min=0), fragments.face_index[0] >= 0)


def _stretch(values: Float[Tensor, "3 t t"], size: int) -> Float[Tensor, "3 T T"]:
    """Enlarge an equirectangular map bilinearly; its first and last column are neighbours."""
    factor = size // values.shape[-1]
    if factor == 1:
        return values
    padded = torch.cat([values[..., -1:], values, values[..., :1]], dim=-1)[None]
    return functional.interpolate(padded, size=(size, size + 2 * factor), mode="bilinear")[0, ..., factor:-factor]


def _dot(first: Sequence[Tensor], second: Sequence[Tensor]) -> Float[Tensor, ""]:
    return torch.stack([(a * b).sum() for a, b in zip(first, second, strict=True)]).sum()


def _add(values: Unknowns, factor: Tensor, others: Unknowns) -> Unknowns:
    return [value + factor * other for value, other in zip(values, others, strict=True)]
