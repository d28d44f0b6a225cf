"""Wide residual networks for small pictures."""

from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.utils.fusion import fuse_conv_bn_eval

from pipeline.errors import DataError
from pipeline.networks.batch_normalization import BatchNorm2d
from pipeline.tensor_files import load_tensors


class ResidualBlock(nn.Module):
    """Add two normalised, rectified 3x3 convolutions to their input (pre-activation order)."""

    def __init__(self, channels_in: int, channels_out: int, stride: int) -> None:
        super().__init__()
        self.normalization_1: nn.Module = BatchNorm2d(channels_in)
        self.convolution_1 = nn.Conv2d(channels_in, channels_out, 3, stride, padding=1, bias=False)
        self.normalization_2: nn.Module = BatchNorm2d(channels_out)
        self.convolution_2 = nn.Conv2d(channels_out, channels_out, 3, padding=1, bias=False)
        self.projection = (
            nn.Conv2d(channels_in, channels_out, 1, stride, bias=False) if channels_in != channels_out else None
        )

    def forward(self, x: Float[Tensor, "B _ _ _"]) -> Float[Tensor, "B _ _ _"]:
        """Return the sum of the shortcut and the two convolutions' output."""
        activated = functional.relu(self.normalization_1(x))
        shortcut = x if self.projection is None else self.projection(activated)
        hidden = functional.relu(self.normalization_2(self.convolution_1(activated)))
        return shortcut + self.convolution_2(hidden)


class WideResNet(nn.Module):
    """Classify pictures with the WRN-depth-width of Zagoruyko & Komodakis (2016).

    Depth is 6 N + 4 for N blocks in each of three groups of 16, 32 and 64 times `width` channels, at full, half and
    quarter resolution. Input is RGB in [0, 1]; normalisation by the buffers `mean` and `std` happens inside.
    """

    maps = 3
    mean: Float[Tensor, "1 3 1 1"]
    std: Float[Tensor, "1 3 1 1"]

    def __init__(self, depth: int, width: int, classes: int) -> None:
        super().__init__()
        if depth < 10 or (depth - 4) % 6:
            raise ValueError(f"a wide residual network has depth 6 N + 4 >= 10, not {depth}")
        self.depth, self.width, self.classes = depth, width, classes
        self.register_buffer("mean", torch.full((1, 3, 1, 1), 0.5))
        self.register_buffer("std", torch.full((1, 3, 1, 1), 0.25))
        channels = [16, 16 * width, 32 * width, 64 * width]
        self.stem = nn.Conv2d(3, channels[0], 3, padding=1, bias=False)
        self.groups = nn.ModuleList(
            nn.Sequential(
                ResidualBlock(channels[i], channels[i + 1], 1 if i == 0 else 2),
                *(ResidualBlock(channels[i + 1], channels[i + 1], 1) for _ in range((depth - 4) // 6 - 1)),
            )
            for i in range(3)
        )
        self.normalization = BatchNorm2d(channels[3])
        self.classifier = nn.Linear(channels[3], classes)
        self._initialise()

    def _initialise(self) -> None:
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, mode="fan_out", nonlinearity="relu")
        nn.init.zeros_(self.classifier.bias)

    @property
    def description(self) -> dict[str, str]:
        """What is needed to build the network again."""
        return {"depth": str(self.depth), "width": str(self.width), "classes": str(self.classes)}

    def features(self, images: Float[Tensor, "B 3 H W"], count: int = 3) -> list[Float[Tensor, "B _ _ _"]]:
        """Return the outputs of the first `count` groups, each right before the next sub-sampling."""
        x = self.stem(((images - self.mean) / self.std).to(self.mean.dtype))
        outputs = []
        for group in self.groups[:count]:
            x = group(x)
            outputs.append(x)
        return outputs

    def forward(self, images: Float[Tensor, "B 3 H W"]) -> Float[Tensor, "B classes"]:
        """Return class scores (logits) of RGB pictures in [0, 1]."""
        x = functional.relu(self.normalization(self.features(images)[-1]))
        return self.classifier(x.mean(dim=(2, 3)))


class ChannelAffine(nn.Module):
    """Scale and shift every channel: what a batch normalisation does in evaluation mode."""

    scale: Float[Tensor, "C 1 1"]
    shift: Float[Tensor, "C 1 1"]

    def __init__(self, normalization: nn.BatchNorm2d) -> None:
        super().__init__()
        mean, variance = normalization.running_mean, normalization.running_var
        assert mean is not None
        assert variance is not None
        scale = normalization.weight / torch.sqrt(variance + normalization.eps)
        self.register_buffer("scale", scale.detach()[:, None, None])
        self.register_buffer("shift", (normalization.bias - mean * scale).detach()[:, None, None])

    def forward(self, x: Float[Tensor, "B C H W"]) -> Float[Tensor, "B C H W"]:
        """Apply the scale and the shift in one pass over memory."""
        return torch.addcmul(self.shift, x, self.scale)


def fold_normalizations(network: nn.Module) -> None:
    """Replace the batch normalisations of residual blocks, in place, by what they do in evaluation mode.

    They go into the convolution before them, or into a scale and a shift per channel.
    """
    for block in network.modules():
        if isinstance(block, ResidualBlock):
            first, second = block.normalization_1, block.normalization_2
            assert isinstance(first, nn.BatchNorm2d)
            assert isinstance(second, nn.BatchNorm2d)
            block.normalization_1 = ChannelAffine(first)
            block.convolution_1 = fuse_conv_bn_eval(block.convolution_1, second)
            block.normalization_2 = nn.Identity()


def load_wide_resnet(path: Path, device: torch.device) -> WideResNet:
    """Build the network that `train_features` stored, with its classifier, in evaluation mode.

    Raises DataError where the file holds something else.
    """
    tensors, metadata = load_tensors(path)
    try:
        network = WideResNet(int(metadata["depth"]), int(metadata["width"]), int(metadata["classes"]))
        network.load_state_dict(tensors)
    except (DataError, ValueError, RuntimeError):
        raise DataError(f"{path} holds no wide residual network; make it with the stage train_features") from None
    return network.eval().to(device)
