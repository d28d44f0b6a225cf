"""View prior learning (Kato & Harada 2019): objects must look alike from estimated and from random views."""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional


class _ReverseGradient(torch.autograd.Function):
    @staticmethod
    def forward(_context: Any, values: Tensor) -> Tensor:  # pyright: ignore[reportIncompatibleMethodOverride]
        return values.view_as(values)

    @staticmethod
    def backward(_context: Any, gradient: Tensor) -> Tensor:  # pyright: ignore[reportIncompatibleMethodOverride]
        return -gradient


def reverse_gradient(values: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Return the values unchanged and pass their gradient back with the opposite sign.

    Placed between renderings and discriminator, one backward pass trains the discriminator and its adversary (paper
    section 3.2.3, term 4).
    """
    return _ReverseGradient.apply(values)


def view_prior_loss(estimated: Float[Tensor, " B"], random: Float[Tensor, " N"]) -> Float[Tensor, ""]:
    """Return the discriminator's mean binary cross-entropy, in nats; log 2 when it cannot tell the views apart.

    `estimated` are its logits for renderings at estimated views (label 1), `random` for renderings at random views
    (label 0).
    """
    return 0.5 * (functional.softplus(-estimated).mean() + functional.softplus(random).mean())
