"""A baseline of reconstruction without any 3D: the training photograph with the most similar colours."""

import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from pipeline.datasets.images import to_colors

_LEVELS = 4
"""Levels of each channel; a histogram has their third power."""
_CHUNK = 250


def retrieve(photographs: Float[Tensor, "B 3 H W"], training: UInt8[Tensor, "N 3 H W"]) -> Float[Tensor, "B 3 H W"]:
    """Return for each photograph the training photograph whose colour histogram is nearest in L1.

    Training photographs may stay on disk: they are read a few at a time.
    """
    known = torch.cat([histograms(to_colors(chunk)) for chunk in training.split(_CHUNK)])
    wanted = histograms(photographs).split(_CHUNK)
    nearest = torch.cat([torch.cdist(chunk, known, p=1).argmin(dim=1) for chunk in wanted])
    return to_colors(training[nearest])


def histograms(images: Float[Tensor, "B 3 H W"]) -> Float[Tensor, "B bins"]:
    """Return the shares of the colours, each channel of RGB in [0, 1] rounded down to one of four levels."""
    levels = (images * _LEVELS).long().clamp(0, _LEVELS - 1)
    colors = ((levels[:, 0] * _LEVELS + levels[:, 1]) * _LEVELS + levels[:, 2]).flatten(1)
    counts = torch.zeros(len(colors), _LEVELS**3, device=images.device)
    return counts.scatter_add_(1, colors, torch.ones_like(colors, dtype=counts.dtype)) / colors.shape[1]
