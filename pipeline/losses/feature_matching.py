"""Feature matching: the distance between the mean features of two batches (paper, appendix, eq. 2)."""

from jaxtyping import Float
from torch import Tensor

from pipeline.losses.image_distance import Features, feature_distance


def feature_matching(real: Features, generated: Features) -> Float[Tensor, ""]:
    """Measure how far the mean feature maps of two batches are apart (eq. 2), summed over the feature maps.

    The batches may differ in size. Gradients flow to both.
    """
    return feature_distance(_means(real), _means(generated)).squeeze(0)


def _means(features: Features) -> list[Float[Tensor, "1 _ _ _"]]:
    return [layer.float().mean(dim=0, keepdim=True) for layer in features]
