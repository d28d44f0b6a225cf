"""Keep the paint of objects out of what is read off photographs (ours).

Colours say nothing of azimuths. `mean_colors` describes them, so that opposite azimuths can be given photographs of the
same colours; `paintless_features` measures features in units of how much repainting changes them.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from pipeline.distributed import divide
from pipeline.networks.feature_extractor import FeatureExtractor

_MAP_SIZE = 8
"""Positions a side, at most, that feature maps are averaged to, so that thousands of pictures fit into memory."""
_BATCH = 250
_PROJECTION_ROUNDS = 4
"""Of subspace iteration: few, because each passes over the features of all photographs twice."""
_LEAST_DEVIATION = 1e-4
"""Of colours in [0, 1], below which photographs are painted alike."""


def mean_colors(images: Float[Tensor, "N 3 H W"]) -> Float[Tensor, "N K"]:
    """Describe the paint: colours of the middle, their deviations, and what the border adds to the mean, whitened.

    Whitened values are cut at three deviations. These are nine numbers, fewer where there are fewer photographs.
    """
    size = images.shape[-1]
    inner = slice(size // 4, size - size // 4)
    middle = images[:, :, inner, inner].flatten(2)
    border = images.flatten(2).mean(2) - middle.mean(2) / 4
    colors = torch.cat([middle.mean(2), middle.std(2), border], 1)
    colors = colors - colors.mean(dim=0)
    directions, sizes, _ = torch.linalg.svd(colors, full_matrices=False)
    directions = directions[:, sizes > _LEAST_DEVIATION * math.sqrt(len(colors))]
    return (directions * math.sqrt(len(colors))).clamp(-3, 3)


def paintless_features(
    images: Float[Tensor, "N 3 H W"],
    extractor: FeatureExtractor,
    components: int,
    repainting_floor: float,
    rng: torch.Generator,
) -> Float[Tensor, "2 N components"]:
    """Return features of photographs and of their mirror images, whitened by how much repainting changes them."""
    features = _flat_features([images, images.flip(-1)], extractor)
    components = min(components, len(images) // 2)
    mean = torch.stack([one.mean(dim=0) for one in features]).mean(dim=0)
    for one in features:
        one -= mean
    basis = _principal_directions(features, components, rng)
    first, second = _flat_features([repaint(images, rng), repaint(images, rng)], extractor, basis)
    change = first - second
    covariance = change.T @ change / (2 * len(change))
    floor = repainting_floor * covariance.trace() / components
    values, vectors = torch.linalg.eigh(covariance + floor * torch.eye(components, device=images.device))
    whitened = basis @ (vectors * values.rsqrt())
    return torch.stack([one @ whitened for one in features])


def repaint(images: Float[Tensor, "N 3 H W"], rng: torch.Generator) -> Float[Tensor, "N 3 H W"]:
    """Change gamma, contrast, brightness and saturation of pictures at random, and mix their channels."""

    def normal(deviation: float, *shape: int) -> Tensor:
        return deviation * torch.randn(len(images), *shape, generator=rng, device=images.device)

    images = images.clamp(min=1e-3) ** normal(0.5, 1, 1, 1).exp()
    mean = images.mean(dim=(1, 2, 3), keepdim=True)
    images = mean + (images - mean) * normal(0.4, 1, 1, 1).exp() + normal(0.2, 1, 1, 1)
    gray = images.mean(dim=1, keepdim=True)
    images = gray + (images - gray) * normal(0.5, 1, 1, 1).exp()
    mixing = torch.eye(3, device=images.device) + normal(0.25, 3, 3)
    mixing = mixing / mixing.sum(dim=2, keepdim=True)
    return torch.einsum("nij,njhw->nihw", mixing, images).clamp(0, 1)


def _flat_features(
    pictures: list[Float[Tensor, "N 3 H W"]], extractor: FeatureExtractor, basis: Float[Tensor, "D K"] | None = None
) -> list[Float[Tensor, "N K"]]:
    """Return directions of all feature maps but the first, averaged over a grid: colours and edges are paint.

    Where a basis is given they are its coordinates: all of their numbers are gigabytes for thousands of pictures.
    Processes divide the sets of pictures.
    """

    def describe_batch(batch: Float[Tensor, "B 3 H W"]) -> Float[Tensor, "B K"]:
        maps = [functional.normalize(layer.float(), dim=1) for layer in extractor(batch)[2:]]
        grids = [functional.adaptive_avg_pool2d(layer, min(_MAP_SIZE, layer.shape[-1])) for layer in maps]
        flat = torch.cat([grid.flatten(1) for grid in grids], 1)
        return (flat if basis is None else flat @ basis).cpu()

    def describe(index: int) -> Float[Tensor, "N K"]:
        images = pictures[index]
        described = torch.empty(0)
        for start in range(0, len(images), _BATCH):
            batch = describe_batch(images[start : start + _BATCH])
            if start == 0:
                described = batch.new_empty(len(images), batch.shape[1])
            described[start : start + _BATCH] = batch
        return described

    return [features.to(pictures[0].device) for features in divide(describe, len(pictures))]


def _principal_directions(
    centered: list[Float[Tensor, "N D"]], count: int, rng: torch.Generator
) -> Float[Tensor, "D components"]:
    """Return the leading right singular vectors of all rows by subspace iteration, from a random start."""
    start = torch.randn(centered[0].shape[1], count, generator=rng, device=rng.device)
    directions = torch.linalg.qr(start).Q
    for _ in range(_PROJECTION_ROUNDS):
        images = torch.stack([one.T @ (one @ directions) for one in centered]).sum(dim=0)
        directions = torch.linalg.qr(images).Q
    return directions
