"""The Chamfer distance between two batches of pictures (paper, appendix, eq. 4)."""

from jaxtyping import Bool, Float, Int
from torch import Tensor

from pipeline.distributed import gather, world
from pipeline.losses.image_distance import Features, feature_distance, pairwise_feature_distance


def chamfer(real: Features, generated: Features) -> Float[Tensor, ""]:
    """Measure how far every picture of either batch is from its nearest in the other (eq. 4).

    Each direction is a mean over its batch, and the two are added. Neighbours are chosen without gradients; gradients
    flow through the distances of the chosen pairs, to both arguments.

    Processes that share the batch all give the whole of `real` and their share of `generated`. Each measures the pairs
    of its own generated pictures; the average over processes is the distance.
    """
    distances = pairwise_feature_distance(real, generated)
    nearest_real, nearest_generated = distances.argmin(dim=0), gather(distances.T).T.argmin(dim=1)
    position, here = _own(nearest_generated, len(distances.T))
    real_to_generated = feature_distance(real, _select(generated, position)) * here * world().size
    generated_to_real = feature_distance(_select(real, nearest_real), generated)
    return real_to_generated.mean() + generated_to_real.mean()


def _own(index: Int[Tensor, " B"], count: int) -> tuple[Int[Tensor, " B"], Bool[Tensor, " B"]]:
    """Return positions in this process's share of `count` pictures, and whether the pictures are among them."""
    position = index - world().rank * count
    return position.clamp(0, count - 1), (position >= 0) & (position < count)


def _select(features: Features, index: Int[Tensor, " B"]) -> list[Float[Tensor, "B _ _ _"]]:
    # Selecting from the memory layout (channels last) keeps it: selecting from the view would lay it out anew.
    return [layer.permute(0, 2, 3, 1).index_select(0, index).permute(0, 3, 1, 2) for layer in features]
