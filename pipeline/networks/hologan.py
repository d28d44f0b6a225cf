"""HoloGAN (Nguyen-Phuoc et al. 2019): pictures from noise through 3D features that are turned before they are drawn.

A baseline: it learns from the same photographs, but has no shape that could be taken out. What differs from its paper
is in docs/decisions/baselines.md.
"""

import json
import math
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from pipeline.config import from_json
from pipeline.device import constant
from pipeline.geometry.camera import rotation_from_angles
from pipeline.ranges import Count
from pipeline.tensor_files import load_tensors, load_weights, save_tensors

START = 4
VOLUME = 16
"""Voxels along each side of the learned constant, and of the features that are turned."""


@dataclass(frozen=True)
class HoloGANConfig:
    """Sizes of generator and discriminator."""

    latent_size: Count
    """Length of the noise vector."""
    width: Count
    """Channels of the turned features, and of the generator's last layer; 64 in the paper."""
    discriminator_width: Count
    """Channels of the discriminator's first layer, doubled by each later one; 64 in the paper."""
    image_size: Literal[32, 64]
    """Side of the pictures in pixels: 32 or 64; the paper's larger ones need its style discriminators."""


class AdaptiveNormalization(nn.Module):
    """Give every channel of every sample a mean and a deviation that its noise vector decides (AdaIN)."""

    def __init__(self, latent_size: int, channels: int) -> None:
        super().__init__()
        self.style = nn.Linear(latent_size, 2 * channels)

    def forward(
        self, features: Float[Tensor, "B C *places"], latent: Float[Tensor, "B K"]
    ) -> Float[Tensor, "B C *places"]:
        """Return features of mean `shift` and deviation `|1 + scale|` over all places."""
        sizes = (len(features), -1, *[1] * (features.ndim - 2))
        scale, shift = (part.view(sizes) for part in self.style(latent).chunk(2, dim=1))
        return (1 + scale) * functional.instance_norm(features) + shift


class HoloGenerator(nn.Module):
    """Draw objects from noise, from given sides.

    A learned constant grows through 3D deconvolutions to 16^3 voxels, is turned, and is flattened by a projection unit:
    depth becomes channels and a 1x1 convolution mixes them. 2D deconvolutions then grow it to the picture.
    """

    def __init__(self, config: HoloGANConfig) -> None:
        super().__init__()
        latent, width = config.latent_size, config.width
        self.config = config
        stages = (config.image_size // VOLUME).bit_length() - 1
        solid = [8 * width, 2 * width, width]
        flat = [VOLUME * width, *(width * 4 ** (stages - 1 - stage) for stage in range(stages))]
        self.constant = nn.Parameter(torch.zeros(solid[0], START, START, START))
        self.solid_styles = nn.ModuleList(AdaptiveNormalization(latent, channels) for channels in solid)
        self.grow_solid = nn.ModuleList(nn.ConvTranspose3d(a, b, 3, 2, 1, 1) for a, b in pairwise(solid))
        self.projection = nn.Conv2d(VOLUME * width, flat[0], 1)
        self.grow_flat = nn.ModuleList(nn.ConvTranspose2d(a, b, 4, 2, 1) for a, b in pairwise(flat))
        self.flat_styles = nn.ModuleList(AdaptiveNormalization(latent, channels) for channels in flat[1:])
        self.output = nn.Conv2d(flat[-1], 3, 3, 1, 1)
        _initialise(self)

    def forward(
        self, latent: Float[Tensor, "B K"], azimuth: Float[Tensor, " B"], elevation: Float[Tensor, " B"]
    ) -> Float[Tensor, "B 3 H W"]:
        """Return pictures in [-1, 1], with objects seen from azimuths and elevations in radians."""
        solid = self.constant.expand(len(latent), -1, -1, -1, -1)
        solid = functional.relu(self.solid_styles[0](solid, latent))
        for grow, style in zip(self.grow_solid, self.solid_styles[1:], strict=True):
            solid = functional.relu(style(grow(solid), latent))
        flat = functional.relu(self.projection(rotate_volume(solid, azimuth, elevation).flatten(1, 2)))
        for grow, style in zip(self.grow_flat, self.flat_styles, strict=True):
            flat = functional.relu(style(grow(flat), latent))
        return self.output(flat).tanh()

    def sample_latent(self, count: int, rng: torch.Generator) -> Float[Tensor, "B K"]:
        """Draw noise uniformly from [-1, 1]."""
        return 2 * torch.rand(count, self.config.latent_size, generator=rng, device=rng.device) - 1


class HoloDiscriminator(nn.Module):
    """Tell photographs from generated pictures, and read off a generated one the noise it was made from."""

    def __init__(self, config: HoloGANConfig) -> None:
        super().__init__()
        stages = (config.image_size // START).bit_length() - 1
        widths = [3, *(config.discriminator_width * 2**stage for stage in range(stages))]
        self.first = nn.Conv2d(3, widths[1], 5, 2, 2)
        self.convolutions = nn.ModuleList(nn.Conv2d(a, b, 5, 2, 2) for a, b in pairwise(widths[1:]))
        size = widths[-1] * START**2
        self.score = nn.Linear(size, 1)
        self.latent = nn.Sequential(
            nn.Linear(size, 128), nn.LeakyReLU(0.2), nn.Linear(128, config.latent_size), nn.Tanh()
        )
        _initialise(self)
        for convolution in self.convolutions:
            nn.utils.parametrizations.spectral_norm(convolution)

    def forward(self, images: Float[Tensor, "B 3 H W"]) -> tuple[Float[Tensor, " B"], Float[Tensor, "B K"]]:
        """Return logits, positive for photographs, and noise vectors, of pictures in [-1, 1]."""
        maps = functional.leaky_relu(self.first(images), 0.2)
        for convolution in self.convolutions:
            maps = functional.leaky_relu(functional.instance_norm(convolution(maps)), 0.2)
        flat = maps.flatten(1)
        return self.score(flat).squeeze(1), self.latent(flat)


@torch.no_grad()
def draw_views(
    network: HoloGenerator, latent: Float[Tensor, "B K"], azimuths: Float[Tensor, " N"], elevation: float
) -> Float[Tensor, "B N 3 H W"]:
    """Draw every object from all azimuths (radians) at one elevation (degrees); pictures are in [0, 1]."""
    heights = latent.new_full((len(latent),), math.radians(elevation))
    views = [network(latent, azimuth.expand(len(latent)), heights) for azimuth in azimuths]
    return (torch.stack(views, dim=1) + 1) / 2


def save_hologan(path: Path, network: HoloGenerator) -> None:
    """Write a trained generator with what is needed to build it again."""
    save_tensors(path, network.state_dict(), {"config": json.dumps(asdict(network.config), sort_keys=True)})


def load_hologan(path: Path, device: torch.device) -> HoloGenerator:
    """Load the generator that `save_hologan` wrote, in evaluation mode."""
    tensors, metadata = load_tensors(path)
    network = HoloGenerator(from_json(metadata["config"], HoloGANConfig, path))
    load_weights(network, tensors, path)
    return network.to(device).eval()


def rotate_volume(
    features: Float[Tensor, "B C D H W"], azimuth: Float[Tensor, " B"], elevation: Float[Tensor, " B"]
) -> Float[Tensor, "B C D H W"]:
    """Resample features of world space along the camera's axes, trilinearly; zeros where the volume ends.

    Columns are x (right), rows -y (row 0 at the top), depth is z (the last slice is nearest to the viewer). The turn is
    that of `rotation_from_angles` without roll. Gradients flow to the features and the angles.
    """
    rotation = rotation_from_angles(azimuth, elevation, torch.zeros_like(azimuth))
    upside_down = torch.diag(constant((1.0, -1.0, 1.0), rotation))
    to_world = upside_down @ rotation.transpose(1, 2) @ upside_down
    transform = torch.cat([to_world, torch.zeros_like(to_world[..., :1])], dim=2)
    grid = functional.affine_grid(transform, list(features.shape), align_corners=False)
    return functional.grid_sample(features, grid, align_corners=False)


def _initialise(network: nn.Module) -> None:
    """Draw weights as DCGAN does; biases are zero, so that styles start near mean 0 and deviation 1."""
    for name, parameter in network.named_parameters():
        if name.endswith("bias"):
            nn.init.zeros_(parameter)
        else:
            nn.init.normal_(parameter, std=0.02)
