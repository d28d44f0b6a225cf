"""Feature matching: the distance between the mean features of two batches (paper, appendix, eq. 3)."""

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.distributed import average
from pipeline.losses.image_distance import Features, feature_distance


def feature_matching(real: Features, generated: Features) -> Float[Tensor, ""]:
    """Measure how far the mean feature maps of two batches are apart (eq. 3), summed over the feature maps.

    The batches may differ in size. Of each a process gives its share, or the whole; what counts are the means over all
    processes. Gradients flow to both.
    """
    return feature_distance(_means(real), _means(generated)).squeeze(0)


def _means(features: Features) -> list[Float[Tensor, "1 _ _ _"]]:
    return [_mean(layer) for layer in features]


def _mean(layer: Float[Tensor, "B C H W"]) -> Float[Tensor, "1 C H W"]:
    # In memory order (channels last) and as one row a picture: five times as fast as the mean of the view.
    channels_last = layer.permute(0, 2, 3, 1)
    precision = torch.promote_types(layer.dtype, torch.float32)
    mean = channels_last.flatten(1).mean(dim=0, dtype=precision)
    return average(mean).view(1, *channels_last.shape[1:]).permute(0, 3, 1, 2)
