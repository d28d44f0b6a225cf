"""Agreement of shapes: overlap of volumes and of silhouettes, and distance between surfaces."""

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor


def iou(first: Bool[Tensor, "B *grid"], second: Bool[Tensor, "B *grid"]) -> Float[Tensor, " B"]:
    """Measure intersection over union of voxel grids or of masks, range [0, 1]; two empty ones agree fully."""
    first, second = first.flatten(1), second.flatten(1)
    union = (first | second).sum(1)
    return torch.where(union > 0, (first & second).sum(1) / union.clamp_min(1), 1.0)


def sample_surface(
    vertices: Float[Tensor, "B V 3"], faces: Int[Tensor, "F 3"], count: int, generator: torch.Generator
) -> Float[Tensor, "B count 3"]:
    """Draw points uniformly by area from each surface."""
    corners = vertices[:, faces]
    edges = corners[:, :, 1:] - corners[:, :, :1]
    areas = torch.linalg.cross(edges[:, :, 0], edges[:, :, 1]).norm(dim=-1)
    chosen = torch.multinomial(areas, count, replacement=True, generator=generator)
    weights = torch.rand(len(vertices), count, 2, generator=generator, dtype=vertices.dtype)
    outside = weights.sum(-1, keepdim=True) > 1
    weights = torch.where(outside, 1 - weights, weights)
    batch = torch.arange(len(vertices))[:, None]
    return corners[batch, chosen, 0] + (edges[batch, chosen] * weights[..., None]).sum(2)


def chamfer_l1(first: Float[Tensor, "B K 3"], second: Float[Tensor, "B L 3"]) -> Float[Tensor, " B"]:
    """Measure the mean distance of each set's points to the nearest of the other, averaged over both directions.

    In units of the points; "L1" because distances are not squared (Mescheder et al. 2019).
    """
    distances = torch.cdist(first, second)
    return (distances.amin(2).mean(1) + distances.amin(1).mean(1)) / 2
