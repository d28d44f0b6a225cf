"""The distance of pictures in feature space (paper, appendix, eq. 2)."""

from collections.abc import Sequence
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

Features = Sequence[Float[Tensor, "_ _ _ _"]]


def feature_distance(first: Features, second: Features) -> Float[Tensor, " B"]:
    """Measure how far pictures are apart, pair by pair: eq. 2 summed over the feature maps.

    A map's share is the Euclidean norm over channels of the difference, averaged over positions. Gradients flow to
    both arguments; where two features are equal the gradient is zero. Lower precisions are taken as float32.
    """
    shares = [
        _NormOfDifference.apply(_positions_last(a), _positions_last(b)).mean(dim=1)
        for a, b in zip(first, second, strict=True)
    ]
    return torch.stack(shares).sum(dim=0)


class _NormOfDifference(torch.autograd.Function):
    """The norm over the last dimension; PyTorch's own derivative passes over the maps five times as often."""

    @staticmethod
    def forward(ctx: Any, first: Tensor, second: Tensor) -> Tensor:
        if torch.promote_types(first.dtype, second.dtype).itemsize < torch.float32.itemsize:
            first = first.float()
        difference = second - first
        norm = torch.linalg.vector_norm(difference, dim=-1)
        ctx.save_for_backward(difference, norm)
        return norm

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, Tensor | None]:  # pyright: ignore[reportIncompatibleMethodOverride]
        difference, norm = ctx.saved_tensors
        scale = torch.where(norm > 0, gradients[0] / norm, 0.0)
        gradient = difference * scale[..., None]
        of_first, of_second = ctx.needs_input_grad
        return -gradient if of_first else None, gradient if of_second else None


@torch.no_grad()
def pairwise_feature_distance(first: Features, second: Features) -> Float[Tensor, "B_first B_second"]:
    """Measure the distance of every picture of the first batch to every one of the second, without gradients.

    The same distance as `feature_distance`, through one matrix product per position: up to rounding (about 1e-3 of the
    norm of a feature), enough to choose neighbours. Lower precisions are taken as float32.
    """
    total = torch.zeros(len(first[0]), len(second[0]), device=first[0].device)
    for a, b in zip(first, second, strict=True):
        rows_first, rows_second = _rows_first(a), _rows_first(b)
        height, width = rows_first.shape[:2]
        for row_first, row_second in zip(rows_first, rows_second, strict=True):
            total += torch.cdist(row_first.float(), row_second.float()).sum(dim=0) / (height * width)
    return total


def _positions_last(features: Float[Tensor, "B C H W"]) -> Float[Tensor, "B positions C"]:
    return features.flatten(2).transpose(1, 2)


def _rows_first(features: Float[Tensor, "B C H W"]) -> Float[Tensor, "H W B C"]:
    return features.permute(2, 3, 0, 1)
