"""Agreement of a reconstructed picture with the photograph, pixel by pixel."""

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

WINDOW = 11
SIGMA = 1.5
STABILIZERS = (0.01**2, 0.03**2)
LEAST_ERROR = 1e-10


def psnr(first: Float[Tensor, "B 3 H W"], second: Float[Tensor, "B 3 H W"]) -> Float[Tensor, " B"]:
    """Measure the peak signal-to-noise ratio in decibels of images in [0, 1]; identical images get 100."""
    error = (first - second).square().mean((1, 2, 3))
    return -10 * error.clamp_min(LEAST_ERROR).log10()


def ssim(first: Float[Tensor, "B 3 H W"], second: Float[Tensor, "B 3 H W"]) -> Float[Tensor, " B"]:
    """Measure the structural similarity of images in [0, 1] (Wang et al. 2004): range (-1, 1], 1 when identical.

    Gaussian window of 11 pixels and sigma 1.5, stabilizers (.01, .03), only windows that lie inside the picture, mean
    over windows and colour channels.
    """
    moments = torch.stack([first, second, first * first, second * second, first * second])
    blurred = _blur(moments.flatten(0, 2)[:, None]).unflatten(0, moments.shape[:3])
    mean_first, mean_second, square_first, square_second, product = blurred[..., 0, :, :].unbind(0)
    variance = square_first - mean_first.square() + square_second - mean_second.square()
    covariance = product - mean_first * mean_second
    luminance = (2 * mean_first * mean_second + STABILIZERS[0]) / (
        mean_first.square() + mean_second.square() + STABILIZERS[0]
    )
    structure = (2 * covariance + STABILIZERS[1]) / (variance + STABILIZERS[1])
    return (luminance * structure).mean((1, 2, 3))


def _blur(images: Float[Tensor, "B 1 H W"]) -> Float[Tensor, "B 1 height width"]:
    positions = torch.arange(WINDOW, dtype=images.dtype, device=images.device) - WINDOW // 2
    kernel = torch.exp(-positions.square() / (2 * SIGMA**2))
    kernel = kernel / kernel.sum()
    return functional.conv2d(functional.conv2d(images, kernel[None, None, :, None]), kernel[None, None, None, :])
