"""Noise -> shape, texture and background of a category (paper 3.1, Fig. 4)."""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from pipeline.geometry.normalize import fit_unit_cube
from pipeline.geometry.symmetry import symmetrize
from pipeline.networks.generators import (
    ImageBackgroundGenerator,
    PaletteTextureGenerator,
    ShapeGenerator,
    StripesGenerator,
    TextureGenerator,
)


@dataclass(frozen=True)
class GeneratorConfig:
    """Sizes of the three generators.

    Attributes:
        latent_size: length of the noise vector.
        shape_hidden: width of the shape generator.
        offset_scale: factor on the vertex offsets; larger values move vertices faster at the same learning rate.
        texture_channels: channels of the texture generator's last block.
        texture_size: side of the texture map in texels, a power of two.
        background_hidden: channels of the background generator.
        mirror_texture: whether the texture is the same on both sides of the symmetry plane.
    """

    latent_size: int
    shape_hidden: int
    offset_scale: float
    texture_channels: int
    texture_size: int
    background_hidden: int
    mirror_texture: bool


@dataclass(frozen=True)
class ConstraintConfig:
    """Which constraints of paper 3.1 hold; each of Fig. 5's ablations switches one off."""

    smoothness: bool
    symmetry: bool
    texture_simplicity: bool
    background_simplicity: bool


class Scene(NamedTuple):
    """A batch of generated objects before backgrounds.

    Attributes:
        vertices: world space, inside the unit cube.
        texture_maps: RGB in [0, 1].
        backgrounds: RGB in [0, 1].
    """

    vertices: Float[Tensor, "B V 3"]
    texture_maps: Float[Tensor, "B 3 T T"]
    backgrounds: Float[Tensor, "B 3 H W"]


class SceneGenerator(nn.Module):
    """Generate textured objects on backgrounds from noise (paper 3.1.1 to 3.1.4)."""

    initial_vertices: Float[Tensor, "V 3"]
    mirror_index: Int[Tensor, " V"]

    def __init__(
        self,
        config: GeneratorConfig,
        constraints: ConstraintConfig,
        colors: int,
        image_size: int,
        initial_vertices: Float[Tensor, "V 3"],
        mirror_index: Int[Tensor, " V"],
    ) -> None:
        super().__init__()
        self.symmetry = constraints.symmetry
        self.latent_size = config.latent_size
        self.register_buffer("initial_vertices", initial_vertices, persistent=False)
        self.register_buffer("mirror_index", mirror_index, persistent=False)
        self.shape = ShapeGenerator(config.latent_size, config.shape_hidden, len(initial_vertices), config.offset_scale)
        self.texture = _texture_generator(config, constraints, colors)
        self.background = _background_generator(config, constraints, image_size)

    def vertices(self, noise: Float[Tensor, "B K"]) -> Float[Tensor, "B V 3"]:
        """Return the shapes alone."""
        offsets = self.shape(noise)
        if self.symmetry:
            offsets = symmetrize(offsets, self.mirror_index)
        return fit_unit_cube(self.initial_vertices + offsets)

    def forward(self, noise: Float[Tensor, "B K"]) -> Scene:
        """Return shapes, textures and backgrounds generated from one noise vector each."""
        return Scene(self.vertices(noise), self.texture(noise), self.background(noise))

    def sample_noise(self, count: int, rng: torch.Generator) -> Float[Tensor, "B K"]:
        """Draw standard normal noise."""
        return torch.randn(count, self.latent_size, generator=rng, device=rng.device)


def _texture_generator(config: GeneratorConfig, constraints: ConstraintConfig, colors: int) -> nn.Module:
    if constraints.texture_simplicity:
        return PaletteTextureGenerator(
            config.latent_size, config.texture_channels, config.texture_size, colors, config.mirror_texture
        )
    return TextureGenerator(config.latent_size, config.texture_channels, config.texture_size, config.mirror_texture)


def _background_generator(config: GeneratorConfig, constraints: ConstraintConfig, image_size: int) -> nn.Module:
    if constraints.background_simplicity:
        return StripesGenerator(config.latent_size, config.background_hidden, image_size)
    return ImageBackgroundGenerator(config.latent_size, config.texture_channels, image_size)
