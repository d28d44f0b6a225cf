"""Networks that others trained on ImageNet, given as a file, whose feature maps compare pictures (paper 4.2)."""

import zipfile
import zlib
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from tokenize import TokenError

import numpy as np
import torch
from jaxtyping import Float
from safetensors import SafetensorError, safe_open
from torch import Tensor, nn
from torch.nn import functional

from pipeline.errors import DataError
from pipeline.tensor_files import load_tensors

_DAMAGE_OF_ARRAYS = (EOFError, RuntimeError, SyntaxError, TokenError, TypeError, ValueError, zlib.error)
"""What readers of an archive's arrays raise besides."""


@dataclass(frozen=True)
class Architecture:
    """Say what a network is made of and what its authors' weights expect."""

    layers: Callable[[], nn.Sequential]
    """Builds the convolutional part, whose layers have the names of the weights."""
    prefix: str
    """Of those names in the file."""
    maps: tuple[str, ...]
    """Names of the five layers whose outputs are the feature maps."""
    mean: tuple[float, float, float]
    """Subtracted from RGB in [0, 1]."""
    std: tuple[float, float, float]
    """The difference is divided by it."""
    first_of_bgr: str | None
    """The first layer's name where it expects blue before red; None where it expects RGB."""


class Fire(nn.Module):
    """Squeeze channels by a 1x1 convolution, expand them by a 1x1 and a 3x3 one (Iandola et al. 2016)."""

    def __init__(self, channels_in: int, squeezed: int, expanded: int) -> None:
        super().__init__()
        self.conv1x1_1 = nn.Conv2d(channels_in, squeezed, 1)
        self.conv1x1_2 = nn.Conv2d(squeezed, expanded, 1)
        self.conv3x3_2 = nn.Conv2d(squeezed, expanded, 3, padding=1)

    def forward(self, x: Float[Tensor, "B _ H W"]) -> Float[Tensor, "B _ H W"]:
        """Return twice `expanded` rectified channels."""
        squeezed = functional.relu(self.conv1x1_1(x))
        return functional.relu(torch.cat([self.conv1x1_2(squeezed), self.conv3x3_2(squeezed)], dim=1))


def alexnet() -> nn.Sequential:
    """Build the five convolutional layers of AlexNet in the one-column form of Krizhevsky (2014)."""
    return nn.Sequential(
        *(nn.Conv2d(3, 64, 11, stride=4, padding=2), nn.ReLU(), nn.MaxPool2d(3, 2)),
        *(nn.Conv2d(64, 192, 5, padding=2), nn.ReLU(), nn.MaxPool2d(3, 2)),
        *(nn.Conv2d(192, 384, 3, padding=1), nn.ReLU()),
        *(nn.Conv2d(384, 256, 3, padding=1), nn.ReLU()),
        *(nn.Conv2d(256, 256, 3, padding=1), nn.ReLU()),
    )


def squeezenet() -> nn.Sequential:
    """Build SqueezeNet v1.0 up to its last pooling; pooling windows may reach beyond a border."""
    return nn.Sequential(
        OrderedDict(
            [
                *(("conv1", nn.Conv2d(3, 96, 7, stride=2)), ("relu1", nn.ReLU())),
                ("pool1", nn.MaxPool2d(3, 2, ceil_mode=True)),
                *(("fire2", Fire(96, 16, 64)), ("fire3", Fire(128, 16, 64)), ("fire4", Fire(128, 32, 128))),
                ("pool4", nn.MaxPool2d(3, 2, ceil_mode=True)),
                *(("fire5", Fire(256, 32, 128)), ("fire6", Fire(256, 48, 192))),
                *(("fire7", Fire(384, 48, 192)), ("fire8", Fire(384, 64, 256))),
            ]
        )
    )


ARCHITECTURES = {
    "alexnet": Architecture(
        alexnet, "features.", ("1", "4", "7", "9", "11"), (0.485, 0.456, 0.406), (0.229, 0.224, 0.225), None
    ),
    "squeezenet": Architecture(
        squeezenet,
        "",
        ("relu1", "fire4", "fire6", "fire7", "fire8"),
        (123 / 255, 117 / 255, 104 / 255),
        (1 / 255, 1 / 255, 1 / 255),
        "conv1",
    ),
}


class PretrainedNetwork(nn.Module):
    """Compute five rectified feature maps of RGB pictures in [0, 1].

    Each map is multiplied by its entry of the buffer `scale`, which is 1 until it is set.
    """

    mean: Float[Tensor, "3 1 1"]
    std: Float[Tensor, "3 1 1"]
    scale: Float[Tensor, " maps"]

    def __init__(self, name: str) -> None:
        """Build the architecture of that name, with untrained weights."""
        super().__init__()
        architecture = ARCHITECTURES[name]
        self.maps = len(architecture.maps)
        self.description = {"architecture": name}
        self._map_names = architecture.maps
        self.layers = architecture.layers()
        for buffer, values in (("mean", architecture.mean), ("std", architecture.std)):
            self.register_buffer(buffer, torch.tensor(values)[:, None, None], persistent=False)
        self.register_buffer("scale", torch.ones(self.maps))

    def features(self, images: Float[Tensor, "B 3 H W"], count: int) -> list[Float[Tensor, "B _ _ _"]]:
        """Return the first `count` maps; a picture needs 32 pixels a side."""
        x = ((images - self.mean) / self.std).to(self.mean.dtype)
        maps: list[Tensor] = []
        for name, layer in self.layers.named_children():
            if len(maps) == count:
                break
            x = layer(x)
            if name in self._map_names:
                maps.append(x * self.scale[len(maps)])
        return maps


def read_pretrained(path: Path) -> PretrainedNetwork:
    """Read the weights of one of the `ARCHITECTURES` from a .npz or .safetensors file; other tensors are left out.

    Raises DataError, naming what is missing, where the file cannot be read or holds no such network.
    """
    tensors = _read(path)
    missing = []
    for name, architecture in ARCHITECTURES.items():
        network, first = PretrainedNetwork(name), architecture.first_of_bgr
        wanted = network.layers.state_dict()
        own = {layer: tensors[key] for layer in wanted if (key := architecture.prefix + layer) in tensors}
        lacking = [layer for layer, weight in wanted.items() if layer not in own or own[layer].shape != weight.shape]
        if not lacking:
            if first is not None:
                own[f"{first}.weight"] = own[f"{first}.weight"].flip(1)
            network.layers.load_state_dict(own)
            return network.eval()
        missing.append(f"{architecture.prefix}{lacking[0]} {tuple(wanted[lacking[0]].shape)} of {name}")
    raise DataError(f"{path} has no {' and no '.join(missing)}; data/README.md says which weights are taken")


def load_pretrained(path: Path) -> PretrainedNetwork:
    """Build the network that `train_features` stored. Raises DataError where the file holds something else."""
    tensors, metadata = load_tensors(path)
    try:
        network = PretrainedNetwork(metadata["architecture"])
        network.load_state_dict(tensors)
    except (DataError, KeyError, RuntimeError):
        raise DataError(f"{path} holds no pretrained network; make it with the stage train_features") from None
    return network.eval()


def _read(path: Path) -> Mapping[str, Tensor]:
    if not path.is_file():
        raise DataError(f"{path} does not exist; give the path of a network's weights")
    wanted = {network.prefix + layer for network in ARCHITECTURES.values() for layer in network.layers().state_dict()}
    try:
        if path.suffix == ".npz":
            with np.load(path, allow_pickle=False) as archive:
                return {name: torch.from_numpy(archive[name]) for name in wanted.intersection(archive.files)}
        with safe_open(path, framework="pt") as stored:
            return {name: stored.get_tensor(name) for name in wanted.intersection(stored.keys())}
    except (SafetensorError, zipfile.BadZipFile, OSError, *_DAMAGE_OF_ARRAYS) as error:
        reason = " ".join(str(error).split())
        raise DataError(
            f"{path} cannot be read as .npz or .safetensors ({reason}); convert it to one of them"
        ) from None
