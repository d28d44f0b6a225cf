"""Image encoders of the full model."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from pipeline.errors import ConfigError
from pipeline.ranges import Count

POOLED_SIZE = 4
"""Maps are averaged to squares of so many positions a side: enough to keep where things are."""
POSITIONS = POOLED_SIZE**2
NORMALIZATION_GROUPS = 8
"""Sets of channels that are normalised apart, in every layer; so the first width, which later ones double, is a
multiple of it."""
CODE_NORM = 2.0
"""Root mean square norm of codes at the start: with 128 entries of deviation 1 decoders saturated."""
LEAST_COLOR_VARIANCE = 1e-4
"""A deviation of .01, 2.5 grey levels: whitening does not magnify what varies less."""
LEAST_FEATURE_DEVIATION = 1e-3
"""Features that vary less over the first photographs are not magnified further."""

Features = Sequence[Float[Tensor, "_ _ _ _"]]


@dataclass(frozen=True)
class EncoderConfig:
    """Shape of an encoder."""

    architecture: Literal["wide_resnet", "resnet18"]
    """`wide_resnet` for 32 px photographs (at laptop size for 64 px too), `resnet18` for larger ones (section 4.2)."""
    width: Count
    """Channels of the first group of blocks; every later group doubles them. ResNet-18 has 64, WRN-d-k has 16 k."""
    blocks: Count
    """Residual blocks in each group. ResNet-18 has 2, WRN-16-k has 2."""

    def __post_init__(self) -> None:
        """Raise ConfigError for channels that cannot be normalised in groups."""
        if self.width % NORMALIZATION_GROUPS:
            raise ConfigError(f"width is {self.width}; expected a multiple of {NORMALIZATION_GROUPS}")


class EncoderBlock(nn.Module):
    """Add two normalised 3x3 convolutions to a shortcut (pre-activation, as in wide residual networks).

    Group instead of batch normalisation: a picture's code must not depend on its neighbours in the batch, and the
    curriculum starts with batches that hold few different photographs.
    """

    def __init__(self, channels_in: int, channels_out: int, stride: int) -> None:
        super().__init__()
        self.normalize_1 = nn.GroupNorm(NORMALIZATION_GROUPS, channels_in)
        self.convolution_1 = nn.Conv2d(channels_in, channels_out, 3, stride, 1, bias=False)
        self.normalize_2 = nn.GroupNorm(NORMALIZATION_GROUPS, channels_out)
        self.convolution_2 = nn.Conv2d(channels_out, channels_out, 3, 1, 1, bias=False)
        self.shortcut = (
            nn.Identity()
            if stride == 1 and channels_in == channels_out
            else nn.Conv2d(channels_in, channels_out, 1, stride, bias=False)
        )

    def forward(self, maps: Float[Tensor, "B C H W"]) -> Float[Tensor, "B C2 H2 W2"]:
        """Return the block's output; a stride of two halves height and width."""
        activated = functional.relu(self.normalize_1(maps))
        residual = self.convolution_1(activated)
        residual = self.convolution_2(functional.relu(self.normalize_2(residual)))
        return self.shortcut(activated if isinstance(self.shortcut, nn.Conv2d) else maps) + residual


class Encoder(nn.Module):
    """Encode photographs as vectors of `code_size` numbers (paper section 3.2).

    The wide residual network keeps 32 px in its first group and has three groups; ResNet-18 starts with a strided 7x7
    convolution and a pooling and has four. `precision`, float32 or bfloat16, is that in which it multiplies; weights
    and codes have float32.
    """

    color_mean: Float[Tensor, " 3"]
    color_mixing: Float[Tensor, "3 3"]

    def __init__(self, config: EncoderConfig, code_size: int, precision: torch.dtype) -> None:
        super().__init__()
        self.precision = precision
        self.register_buffer("color_mean", torch.full((3,), 0.5))
        self.register_buffer("color_mixing", 2 * torch.eye(3))
        deep = config.architecture == "resnet18"
        widths = [config.width * 2**group for group in range(4 if deep else 3)]
        self.stem = nn.Sequential(
            *(
                (nn.Conv2d(3, config.width, 7, 2, 3, bias=False), nn.MaxPool2d(3, 2, 1))
                if deep
                else (nn.Conv2d(3, config.width, 3, 1, 1, bias=False),)
            )
        )
        groups = [_group(config.width, config.width, config.blocks, stride=1)]
        groups += [_group(narrow, wide, config.blocks, stride=2) for narrow, wide in pairwise(widths)]
        self.groups = nn.Sequential(*groups)
        self.normalize = nn.GroupNorm(NORMALIZATION_GROUPS, widths[-1])
        self.project = nn.Linear(widths[-1] * POSITIONS, code_size)

    def forward(self, images: Float[Tensor, "B 3 H W"]) -> Float[Tensor, "B K"]:
        """Return the codes of images in [0, 1]; 4x4 averages keep where things are (a smaller last map is spread)."""
        colors = torch.einsum("kc,bchw->bkhw", self.color_mixing, images - self.color_mean[:, None, None])
        with torch.autocast(images.device.type, torch.bfloat16, enabled=self.precision == torch.bfloat16):
            maps = functional.relu(self.normalize(self.groups(self.stem(colors))))
        return self.project(_pool(maps))

    @torch.no_grad()
    def whiten(self, images: Float[Tensor, "B 3 H W"]) -> None:
        """Mix colour channels so that over these images they are uncorrelated, with mean 0 and deviation 1 or less.

        Hue varies a few times less than brightness, and a network learns last what varies least.
        """
        colors = images.transpose(0, 1).flatten(1)
        variances, axes = torch.linalg.eigh(torch.cov(colors))
        self.color_mean.copy_(colors.mean(dim=1))
        self.color_mixing.copy_(axes * variances.clamp(min=LEAST_COLOR_VARIANCE).rsqrt() @ axes.T)

    @torch.no_grad()
    def standardize(self, images: Float[Tensor, "B 3 H W"]) -> None:
        """Rescale the last layer so that over these images every entry of the code has mean 0 and the same deviation.

        Codes then have a root mean square norm of `CODE_NORM`, and decoders hear from the first step on how photographs
        differ and not what they have in common.
        """
        _standardize(self.project, self(images))


class FeatureEncoder(nn.Module):
    """Map the feature maps of photographs to codes by one linear layer, which learns from few pictures."""

    mean: Float[Tensor, " pooled"]
    deviation: Float[Tensor, " pooled"]

    def __init__(self, channels: int, code_size: int) -> None:
        """Take how many channels all maps have together."""
        super().__init__()
        self.register_buffer("mean", torch.zeros(channels * POSITIONS))
        self.register_buffer("deviation", torch.ones(channels * POSITIONS))
        self.project = nn.Linear(channels * POSITIONS, code_size)

    def forward(self, features: Features) -> Float[Tensor, "B K"]:
        """Return the codes of photographs with these features; pooling to 4x4 keeps where things are."""
        return self.project((_pooled(features) - self.mean) / self.deviation)

    @torch.no_grad()
    def standardize(self, features: Features) -> None:
        """Let every pooled feature and every entry of the code have mean 0 and one deviation over these photographs."""
        deviation, mean = torch.std_mean(_pooled(features), dim=0)
        self.mean.copy_(mean)
        self.deviation.copy_(deviation.clamp(min=LEAST_FEATURE_DEVIATION))
        _standardize(self.project, self(features))


def _pooled(features: Features) -> Float[Tensor, "B pooled"]:
    return torch.cat([_pool(layer) for layer in features], dim=1)


def _pool(maps: Float[Tensor, "B C H W"]) -> Float[Tensor, "B pooled"]:
    return functional.adaptive_avg_pool2d(maps.float(), POOLED_SIZE).flatten(1)


def _standardize(projection: nn.Linear, codes: Float[Tensor, "B K"]) -> None:
    mean, scale = codes.mean(dim=0), CODE_NORM / codes.shape[1] ** 0.5 / codes.std(dim=0).clamp(min=1e-6)
    projection.weight *= scale[:, None]
    projection.bias.copy_((projection.bias - mean) * scale)


def _group(channels_in: int, channels_out: int, blocks: int, stride: int) -> nn.Sequential:
    first = EncoderBlock(channels_in, channels_out, stride)
    return nn.Sequential(first, *(EncoderBlock(channels_out, channels_out, 1) for _ in range(blocks - 1)))
