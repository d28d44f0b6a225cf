"""Agreement of shapes: overlap of volumes and of silhouettes, and distance between surfaces."""

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn import functional

SPARE = 4
SHARES = 20


def iou(first: Bool[Tensor, "B *grid"], second: Bool[Tensor, "B *grid"]) -> Float[Tensor, " B"]:
    """Measure intersection over union of voxel grids or of masks, range [0, 1]; two empty ones agree fully."""
    first, second = first.flatten(1), second.flatten(1)
    union = (first | second).sum(1)
    return torch.where(union > 0, (first & second).sum(1) / union.clamp_min(1), 1.0)


def pairwise_iou(first: Bool[Tensor, "A *grid"], second: Bool[Tensor, "B *grid"]) -> Float[Tensor, "A B"]:
    """Measure intersection over union of every voxel grid, or mask, with every other."""
    one, other = first.flatten(1).float(), second.flatten(1).float()
    both = one @ other.T  # numbers of voxels, which are exact in float32
    union = one.sum(1)[:, None] + other.sum(1) - both
    return torch.where(union > 0, both / union.clamp_min(1), 1.0)


def fit_constant(shapes: Bool[Tensor, "B *grid"]) -> Bool[Tensor, "*grid"]:
    """Find the one voxel grid or mask that overlaps most with all of those given: what ignoring the pictures can reach.

    It holds what at least a certain share of them fill. Of shares in steps of 5 %, that of the greatest mean IoU.
    """
    filled = shapes.double().mean(0)
    candidates = torch.stack([filled >= step / SHARES for step in range(1, SHARES)])
    return candidates[pairwise_iou(candidates, shapes).mean(1).argmax()]


def vertex_deviation(vertices: Float[Tensor, "B V 3"]) -> Float[Tensor, " B"]:
    """Measure how much deformations of one mesh differ: the mean distance of vertices from their means over the batch.

    In units of the vertices. All zeros: every picture has got the same shape.
    """
    return (vertices - vertices.mean(dim=0)).norm(dim=-1).mean(dim=1)


def proportions(vertices: Float[Tensor, "B V 3"]) -> Float[Tensor, "B 2"]:
    """Return the logarithms of width and height over length: how wide (x) and high (y) a shape is for its depth (z)."""
    extents = vertices.amax(dim=1) - vertices.amin(dim=1)
    return (extents[:, :2] / extents[:, 2:]).log()


def sample_surface(
    vertices: Float[Tensor, "B V 3"], faces: Int[Tensor, "F 3"], count: int, rng: torch.Generator
) -> tuple[Float[Tensor, "B count 3"], Float[Tensor, "B count 3"]]:
    """Draw points uniformly by area from each surface; return them and their outward unit normals."""
    corners = vertices[:, faces]
    edges = corners[:, :, 1:] - corners[:, :, :1]
    crosses = torch.linalg.cross(edges[:, :, 0], edges[:, :, 1])
    chosen = torch.multinomial(crosses.norm(dim=-1), count, replacement=True, generator=rng)
    weights = torch.rand(len(vertices), count, 2, generator=rng, dtype=vertices.dtype)
    weights = torch.where(weights.sum(-1, keepdim=True) > 1, 1 - weights, weights)
    batch = torch.arange(len(vertices))[:, None]
    points = corners[batch, chosen, 0] + (edges[batch, chosen] * weights[..., None]).sum(2)
    return points, functional.normalize(crosses[batch, chosen], dim=-1)


def sample_outer_surface(
    vertices: Float[Tensor, "B V 3"],
    faces: Int[Tensor, "F 3"],
    voxels: Bool[Tensor, "B K K K"],
    count: int,
    rng: torch.Generator,
) -> Float[Tensor, "B count 3"]:
    """Draw points by area from the surface that can be touched from outside, for shapes made of overlapping parts.

    A point is hidden if one voxel's width along its normal the shape goes on. `SPARE` times as many points are drawn as
    kept; should fewer be exposed, hidden ones fill up.
    """
    points, normals = sample_surface(vertices, faces, SPARE * count, rng)
    resolution = voxels.shape[-1]
    outside = ((points + normals / resolution + 0.5) * resolution).floor().long()
    inside_grid = ((outside >= 0) & (outside < resolution)).all(-1)
    x, y, z = outside.clamp(0, resolution - 1).unbind(-1)
    hidden = voxels[torch.arange(len(points))[:, None], x, y, z] & inside_grid
    order = hidden.long().argsort(dim=1, stable=True)[:, :count]
    return points.gather(1, order[..., None].expand(-1, -1, 3))


def chamfer_l1(first: Float[Tensor, "B K 3"], second: Float[Tensor, "B L 3"]) -> Float[Tensor, " B"]:
    """Measure the mean distance of each set's points to the nearest of the other, averaged over both directions.

    In units of the points; "L1" because distances are not squared (Mescheder et al. 2019).
    """
    distances = torch.cdist(first, second)
    return (distances.amin(2).mean(1) + distances.amin(1).mean(1)) / 2
