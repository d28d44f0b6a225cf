"""The frozen feature extractor in whose maps pictures are compared, whichever network it is made from."""

import copy
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import torch
from jaxtyping import Float, UInt8
from torch import Tensor, nn

from pipeline.networks.pretrained import PretrainedNetwork, load_pretrained
from pipeline.networks.wide_resnet import WideResNet, fold_normalizations, load_wide_resnet
from pipeline.tensor_files import load_tensors, save_tensors

Network = WideResNet | PretrainedNetwork


class FeatureExtractor(nn.Module):
    """Turn pictures into the feature maps in which they are compared (paper, appendix, "Reconstruction loss").

    A frozen copy of a trained network; the batch normalisations of its feature maps are folded into their neighbours.
    Gradients flow to the pictures alone. The network's maps have the precision the module was moved `to`.

    The pictures themselves, times `color_weight`, come before the network's maps: features learned for recognition
    alone leave colours free to drift (docs/decisions/base-shape.md). The paper's distance has a weight of 0.
    """

    def __init__(self, network: Network, color_weight: float) -> None:
        super().__init__()
        self.color_weight = color_weight
        self.maps = 1 + network.maps
        self.network = copy.deepcopy(network).eval()
        fold_normalizations(self.network)
        self.requires_grad_(False)
        self.network.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]

    @property
    def precision(self) -> torch.dtype:
        """The type of the network's numbers."""
        return next(self.network.parameters()).dtype

    def forward(self, images: Float[Tensor, "B 3 H W"], count: int | None = None) -> list[Float[Tensor, "B _ _ _"]]:
        """Return the weighted pictures, RGB in [0, 1], and the network's feature maps, from fine to coarse.

        Only the first `count` of these `maps` are computed, all of them where it is None.
        """
        images = images.contiguous(memory_format=torch.channels_last)
        count = self.maps if count is None else count
        return [self.color_weight * images, *self.network.features(images, count - 1)]


def save_feature_extractor(path: Path, network: Network, color_weight: float, metadata: Mapping[str, str]) -> None:
    """Write a trained network's weights, in half precision, with what is needed to build the extractor again."""
    state = network.state_dict()
    tensors = {name: tensor.half() if tensor.is_floating_point() else tensor for name, tensor in state.items()}
    save_tensors(path, tensors, {**metadata, **network.description, "color_weight": str(color_weight)})


def load_feature_extractor(path: Path, device: torch.device, precision: torch.dtype) -> FeatureExtractor:
    """Load the frozen feature extractor `save_feature_extractor` wrote, to compute in float32 or bfloat16.

    Raises DataError where the file is not one.
    """
    _, metadata = load_tensors(path)
    pretrained = "architecture" in metadata
    network = load_pretrained(path) if pretrained else load_wide_resnet(path, torch.device("cpu"))
    return FeatureExtractor(network, float(metadata["color_weight"])).to(device, precision)


@torch.no_grad()
def extract(
    extractor: Callable[[Float[Tensor, "B 3 H W"]], Sequence[Float[Tensor, "B _ _ _"]]],
    images: Float[Tensor, "B 3 H W"] | UInt8[Tensor, "B 3 H W"],
    batch_size: int,
) -> list[Float[Tensor, "B _ _ _"]]:
    """Compute the features of photographs once, to be kept: in half precision, channels last, on the images' device.

    Images are RGB, in [0, 1] or 8-bit. A 32x32 picture takes 121 kB under WRN-16-2. `extractor` is a FeatureExtractor,
    or takes what it needs from one.
    """
    kept: list[Tensor] = []
    for start in range(0, len(images), batch_size):
        batch = images[start : start + batch_size]
        layers = extractor(batch.float() / 255 if batch.dtype == torch.uint8 else batch)
        if not kept:
            kept = [
                torch.empty(
                    (len(images), *layer.shape[1:]),
                    dtype=torch.float16,
                    device=images.device,
                    memory_format=torch.channels_last,
                )
                for layer in layers
            ]
        for whole, layer in zip(kept, layers, strict=True):
            whole[start : start + batch_size] = layer
    return kept
