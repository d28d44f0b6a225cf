"""Batch normalisation over the whole batch, whichever processes hold its pictures."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from pipeline.distributed import average, whole, world


class BatchNorm2d(nn.BatchNorm2d):
    """Normalise by the mean and the variance of the batch of all processes.

    PyTorch's SyncBatchNorm does so on GPUs alone. Weights, buffers and evaluation mode are those of PyTorch's layer;
    in a single process training is too.
    """

    def forward(self, maps: Float[Tensor, "B C H W"]) -> Float[Tensor, "B C H W"]:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Return the normalised maps. Gradients flow, through the statistics too, to the maps of all processes."""
        if not self.training or world().size == 1:
            return super().forward(maps)
        # In double precision the squares of means that are far from zero do not swallow the variance.
        variance, mean = (value.double() for value in torch.var_mean(maps.float(), dim=(0, 2, 3), correction=0))
        mean, square = average(torch.stack([mean, variance + mean.square()]))
        variance = square - mean.square()
        self._track(mean, variance, whole(maps.numel() // maps.shape[1]))
        scale = self.weight * (variance + self.eps).rsqrt().float()
        centered = maps.float() - mean.float()[:, None, None]
        return (centered * scale[:, None, None] + self.bias[:, None, None]).to(maps.dtype)

    @torch.no_grad()
    def _track(self, mean: Float[Tensor, " C"], variance: Float[Tensor, " C"], count: int) -> None:
        """Update the running statistics as PyTorch does: with the unbiased variance."""
        assert self.running_mean is not None
        assert self.running_var is not None
        assert self.num_batches_tracked is not None
        assert self.momentum is not None
        self.num_batches_tracked += 1
        self.running_mean.lerp_(mean.float(), self.momentum)
        self.running_var.lerp_((variance * count / (count - 1)).float(), self.momentum)
