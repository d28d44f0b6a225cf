"""Feature matching: the distance between the mean features of two batches (paper, appendix, eq. 3)."""

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.distributed import average_all
from pipeline.losses.image_distance import Features, feature_distance


def feature_matching(real: Features, generated: Features) -> Float[Tensor, ""]:
    """Measure how far the mean feature maps of two batches are apart (eq. 3), summed over the feature maps.

    The batches may differ in size. Of each a process gives its share, or the whole; what counts are the means over all
    processes. Gradients flow to both.
    """
    layers = [*real, *generated]
    means = average_all([_mean(layer) for layer in layers])
    maps = [_as_map(mean, layer) for mean, layer in zip(means, layers, strict=True)]
    return feature_distance(maps[: len(real)], maps[len(real) :]).squeeze(0)


def _mean(layer: Float[Tensor, "B C H W"]) -> Float[Tensor, " _"]:
    # In memory order (channels last) and as one row a picture: five times as fast as the mean of the view.
    precision = torch.promote_types(layer.dtype, torch.float32)
    return layer.permute(0, 2, 3, 1).flatten(1).mean(dim=0, dtype=precision)


def _as_map(mean: Float[Tensor, " _"], layer: Float[Tensor, "B C H W"]) -> Float[Tensor, "1 C H W"]:
    _, channels, height, width = layer.shape
    return mean.view(1, height, width, channels).permute(0, 3, 1, 2)
