"""Noise -> shape, texture and background of a category (paper 3.1, Fig. 4)."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from pipeline.config import from_json
from pipeline.geometry.normalize import fit_unit_cube
from pipeline.geometry.symmetry import symmetrize
from pipeline.networks.generators import (
    ImageBackgroundGenerator,
    PaletteTextureGenerator,
    ShapeGenerator,
    StripesGenerator,
    TextureGenerator,
)
from pipeline.networks.seed_choice import load_seed
from pipeline.ranges import Count, Positive, TextureSize
from pipeline.tensor_files import load_tensors, load_weights


@dataclass(frozen=True)
class GeneratorConfig:
    """Sizes of the three generators."""

    latent_size: Count
    """Length of the noise vector."""
    shape_hidden: Count
    """Width of the shape generator."""
    offset_scale: Positive
    """Factor on the vertex offsets; larger values move vertices faster at the same learning rate."""
    texture_channels: Count
    """Channels of the last block of the texture generator, and of that of backgrounds of any kind."""
    texture_size: TextureSize
    """Side of the texture map in texels, a power of two."""
    background_hidden: Count
    """Channels of the generator of striped backgrounds."""
    mirror_texture: bool
    """Whether the texture is the same on both sides of the symmetry plane."""


@dataclass(frozen=True)
class ConstraintConfig:
    """Which constraints of paper 3.1 hold; each of Fig. 5's ablations switches one off."""

    smoothness: bool
    symmetry: bool
    texture_simplicity: bool
    background_simplicity: bool


@dataclass(frozen=True)
class SceneConfig:
    """Everything needed to build the generators."""

    generator: GeneratorConfig
    constraints: ConstraintConfig
    colors: int
    """Size of the texture palette, N_c."""
    image_size: int
    """Side of the backgrounds in pixels."""


class Scene(NamedTuple):
    """A batch of generated objects, and the backgrounds behind them."""

    vertices: Float[Tensor, "B V 3"]
    """World space, inside the unit cube."""
    texture_maps: Float[Tensor, "B 3 T T"]
    """RGB in [0, 1]."""
    backgrounds: Float[Tensor, "B 3 H W"]
    """RGB in [0, 1]."""


class SceneGenerator(nn.Module):
    """Generate textured objects on backgrounds from noise (paper 3.1.1 to 3.1.4)."""

    initial_vertices: Float[Tensor, "V 3"]
    mirror_index: Int[Tensor, " V"]

    def __init__(
        self, config: SceneConfig, initial_vertices: Float[Tensor, "V 3"], mirror_index: Int[Tensor, " V"]
    ) -> None:
        """Start from an ellipsoid; `mirror_index` names each vertex's mirror image."""
        super().__init__()
        sizes = config.generator
        self.config = config
        self.register_buffer("initial_vertices", initial_vertices)
        self.register_buffer("mirror_index", mirror_index)
        self.shape = ShapeGenerator(sizes.latent_size, sizes.shape_hidden, len(initial_vertices), sizes.offset_scale)
        self.texture = _texture_generator(config)
        self.background = _background_generator(config)

    def vertices(self, noise: Float[Tensor, "B K"]) -> Float[Tensor, "B V 3"]:
        """Return the shapes alone."""
        offsets = self.shape(noise)
        if self.config.constraints.symmetry:
            offsets = symmetrize(offsets, self.mirror_index)
        return fit_unit_cube(self.initial_vertices + offsets)

    def forward(self, noise: Float[Tensor, "B K"]) -> Scene:
        """Return shapes, textures and backgrounds generated from one noise vector each."""
        return Scene(self.vertices(noise), self.texture(noise), self.background(noise))

    def sample_noise(self, count: int, rng: torch.Generator) -> Float[Tensor, "B K"]:
        """Draw standard normal noise."""
        return torch.randn(count, self.config.generator.latent_size, generator=rng, device=rng.device)


class LearnedScenes(NamedTuple):
    """What base-shape learning leaves: every seed's generators, and the mesh that their vertices belong to."""

    generators: list[SceneGenerator]
    """In evaluation mode; those of the chosen base shape first."""
    faces: Int[Tensor, "F 3"]
    """Counter-clockwise from outside."""
    directions: Float[Tensor, "V 3"]
    """Unit vectors, the texture domain."""


def scene_tensors(generators: Sequence[SceneGenerator]) -> dict[str, Tensor]:
    """Stack the weights of generators that differ in nothing else, to be written into one file."""
    states = [generator.state_dict() for generator in generators]
    return {name: torch.stack([state[name] for state in states]) for name in states[0]}


def scene_metadata(generator: SceneGenerator) -> dict[str, str]:
    """Return what has to stand beside the weights in a file to build the generators again."""
    return {"scene": json.dumps(asdict(generator.config), sort_keys=True)}


def load_scenes(path: Path, mesh: Path, image_size: int, device: torch.device) -> LearnedScenes:
    """Load what `learn_base_shape` wrote, first the seed whose base shape `remesh` made the mesh of.

    Backgrounds are scaled to `image_size` pixels, for base shapes may have been learned from pictures of another size.
    Raises DataError where it was written by other code.
    """
    tensors, metadata = load_tensors(path)
    config = from_json(metadata["scene"], SceneConfig, path)
    chosen = load_seed(mesh)
    order = sorted(range(len(tensors["seed_scores"])), key=lambda seed: seed != chosen)
    generators = [_build(config, tensors, seed, path).to(device).eval() for seed in order]
    if config.image_size != image_size:
        for generator in generators:
            generator.background = nn.Sequential(generator.background, nn.Upsample(image_size, mode="bilinear"))
    return LearnedScenes(generators, tensors["faces"].to(device), tensors["directions"].to(device))


def _build(config: SceneConfig, tensors: Mapping[str, Tensor], seed: int, path: Path) -> SceneGenerator:
    generator = SceneGenerator(config, tensors["initial_vertices"][seed], tensors["mirror_index"][seed])
    load_weights(generator, {name: weights[seed] for name, weights in tensors.items()}, path)
    return generator


def _texture_generator(config: SceneConfig) -> nn.Module:
    sizes = config.generator
    if config.constraints.texture_simplicity:
        return PaletteTextureGenerator(
            sizes.latent_size, sizes.texture_channels, sizes.texture_size, config.colors, sizes.mirror_texture
        )
    return TextureGenerator(sizes.latent_size, sizes.texture_channels, sizes.texture_size, sizes.mirror_texture)


def _background_generator(config: SceneConfig) -> nn.Module:
    sizes = config.generator
    if config.constraints.background_simplicity:
        return StripesGenerator(sizes.latent_size, sizes.background_hidden, config.image_size)
    return ImageBackgroundGenerator(sizes.latent_size, sizes.texture_channels, config.image_size)
