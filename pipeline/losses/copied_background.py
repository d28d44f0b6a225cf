"""Texels that copy the background: what they paint is not the object (ours)."""

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from pipeline.distributed import average_all

_BANDS = 4
"""Parts of a background, from top to bottom, of which the mean colours count."""
_FAINT = 1e-3
"""Added to variances: a colour in [0, 1] that deviates by much less than .03 copies nothing."""


def copied_background(
    texture_maps: Float[Tensor, "B 3 T T"], backgrounds: Float[Tensor, "B 3 H W"]
) -> Float[Tensor, ""]:
    """Measure by how much texels follow their backgrounds more closely than whole objects do.

    A grassy field says little of the horse that stands on it, but all of what is seen between its legs. So over a batch
    each texel is correlated with the background's colour, channel by channel, at each of four heights. The mean
    correlation of all texels is what photographs share, such as their exposure; what lies above it counts, squared and
    averaged, from 0 to 1. Of a batch a process gives its share; what counts are the correlations over all processes.
    Gradients flow to the texture maps alone.
    """
    bands = functional.adaptive_avg_pool2d(backgrounds.detach(), (_BANDS, 1)).squeeze(-1)
    products = torch.einsum("bcij,bck->kcij", texture_maps, bands) / len(bands)
    moments = [products, texture_maps.mean(0), texture_maps.square().mean(0), bands.mean(0), bands.square().mean(0)]
    product, texel, texel_square, band, band_square = average_all(moments)
    covariance = product - torch.einsum("cij,ck->kcij", texel, band)
    deviation = torch.einsum("cij,ck->kcij", _deviation(texel, texel_square), _deviation(band, band_square))
    correlation = covariance / deviation
    excess = correlation - correlation.mean(dim=(2, 3), keepdim=True)
    return excess.clamp_min(0).square().mean()


def _deviation(mean: Float[Tensor, "*shape"], square: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    return ((square - mean.square()).clamp_min(0) + _FAINT).sqrt()
