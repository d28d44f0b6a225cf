"""The Chamfer distance between two batches of pictures (paper, appendix, eq. 3)."""

from jaxtyping import Float, Int
from torch import Tensor

from pipeline.losses.image_distance import Features, feature_distance, pairwise_feature_distance


def chamfer(real: Features, generated: Features) -> Float[Tensor, ""]:
    """Measure how far every picture of either batch is from its nearest in the other (eq. 3).

    Each direction is a mean over its batch, and the two are added. Neighbours are chosen without gradients; gradients
    flow through the distances of the chosen pairs, to both arguments.
    """
    distances = pairwise_feature_distance(real, generated)
    nearest_generated, nearest_real = distances.argmin(dim=1), distances.argmin(dim=0)
    real_to_generated = feature_distance(real, _select(generated, nearest_generated))
    generated_to_real = feature_distance(_select(real, nearest_real), generated)
    return real_to_generated.mean() + generated_to_real.mean()


def _select(features: Features, index: Int[Tensor, " B"]) -> list[Float[Tensor, "B _ _ _"]]:
    # Selecting from the memory layout (channels last) keeps it: selecting from the view would lay it out anew.
    return [layer.permute(0, 2, 3, 1).index_select(0, index).permute(0, 3, 1, 2) for layer in features]
