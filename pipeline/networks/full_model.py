"""The full model: from a photograph to shape, pose, texture and background (paper section 3.2)."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from pipeline.config import from_json
from pipeline.geometry.camera import Pose
from pipeline.networks.encoders import POSITIONS, Encoder, EncoderConfig, FeatureEncoder, Features
from pipeline.networks.generators import ImageBackgroundGenerator, StripesGenerator, TextureGenerator
from pipeline.networks.pose_coordinates import Framing, PoseCoordinates, PoseRange
from pipeline.networks.pose_decoder import PoseDecoder, PoseRegression
from pipeline.networks.shapes import FreeFormShapes, OffsetShapes, ShapeConfig, ShapeDecoder
from pipeline.ranges import Count, Rim, TextureSize
from pipeline.rendering.renderer import Mesh, RendererConfig, render
from pipeline.tensor_files import load_tensors, load_weights, save_tensors


@dataclass(frozen=True)
class FullModelConfig:
    """Everything needed to build the networks of the full model."""

    two_stage: bool
    """Deform a learned base shape by a grid; false deforms an ellipsoid vertex by vertex (paper section 4.1.3)."""
    framing: Framing
    """`box` lets the object fill each rendering, like photographs cut to their boxes; `free` leaves it where it is."""
    encoder: EncoderConfig
    shapes_from: Literal["photographs", "features"]
    """What shapes are read off: photographs by an encoder (paper 3.2), or their feature maps by a linear layer."""
    code_size: Count
    """Size of the codes of shape, pose and background."""
    texture_code_size: Count
    """Size of the texture code; a small one makes photographs share the paint that tells front from rear."""
    hidden_size: Count
    """Hidden units of the shape decoder, of a pose head and of the background decoder's rows."""
    pose_heads: Count
    """Members of the pose ensemble, the student not counted."""
    pose_range: PoseRange
    box_rim: Rim
    """Share of vertices whose mean is a side of an object's box in the picture, at framing `free`; at 0 the outermost
    one alone is. Tips grow on boxes that single vertices stretch (docs/decisions/full-training.md)."""
    texture_size: TextureSize
    texture_channels: Count
    mirror_texture: bool
    stripes: bool
    """Whether backgrounds are horizontal stripes (paper 3.1.4); false lets them be any picture (paper Fig. 7d)."""
    shape: ShapeConfig
    renderer: RendererConfig


class Reconstruction(NamedTuple):
    """A batch of reconstructed objects and what is behind them."""

    vertices: Float[Tensor, "B V 3"]
    """World space, inside the unit cube."""
    texture_maps: Float[Tensor, "B 3 T T"]
    """RGB in [0, 1]."""
    pose: Pose
    backgrounds: Float[Tensor, "B 3 H W"]
    """RGB in [0, 1], constant along every row unless the model was built without stripes."""


class FullModel(nn.Module):
    """Reconstruct textured objects from single photographs (paper section 3.2)."""

    base_vertices: Float[Tensor, "V 3"]
    faces: Int[Tensor, "F 3"]
    directions: Float[Tensor, "V 3"]

    def __init__(self, config: FullModelConfig, base: Mesh, precision: torch.dtype, channels: int) -> None:
        """Build the networks around a base mesh of batch size one: the base shape or the initial ellipsoid.

        `precision` is the encoders', `channels` the number of those of all feature maps.
        """
        super().__init__()
        self.config = config
        self.register_buffer("base_vertices", base.vertices[0])
        self.register_buffer("faces", base.faces)
        self.register_buffer("directions", base.directions)
        code, hidden = config.code_size, config.hidden_size
        self.shapes = (FreeFormShapes if config.two_stage else OffsetShapes)(base, config.shape)
        self.poses = PoseCoordinates(config.pose_range, config.renderer.camera, config.box_rim, config.framing == "box")
        self.shape_encoder = (
            FeatureEncoder(channels, code)
            if config.shapes_from == "features"
            else Encoder(config.encoder, code, precision)
        )
        self.pose_encoder = Encoder(config.encoder, code, precision)
        self.texture_encoder = Encoder(config.encoder, config.texture_code_size, precision)
        self.background_encoder = Encoder(config.encoder, code, precision)
        self.shape_decoder = ShapeDecoder(code, hidden, self.shapes.parameter_count)
        self.pose_decoder = PoseDecoder(code, hidden, config.pose_heads)
        self.texture_decoder = TextureGenerator(
            config.texture_code_size, config.texture_channels, config.texture_size, config.mirror_texture
        )
        self.background_decoder = (
            StripesGenerator(code, hidden, config.renderer.size)
            if config.stripes
            else ImageBackgroundGenerator(code, config.texture_channels, config.renderer.size)
        )

    def standardize(self, images: Float[Tensor, "B 3 H W"], features: Features) -> None:
        """Whiten the texture encoder's colours and rescale all codes over these photographs, before training.

        Codes get mean 0 and one size. Colours are the textures' alone: shapes and poses show in brightness.
        """
        self.texture_encoder.whiten(images)
        for encoder in (self.shape_encoder, self.pose_encoder, self.texture_encoder, self.background_encoder):
            if isinstance(encoder, FeatureEncoder):
                encoder.standardize(features)
            else:
                encoder.standardize(images)

    @torch.no_grad()
    def infer(self, images: Float[Tensor, "B 3 H W"], features: Features) -> Reconstruction:
        """Reconstruct photographs in [0, 1], which have these features, in the poses it reads off them.

        The model has to be in evaluation mode.
        """
        vertices = self.shapes(self.read_shapes(images, features))
        pose = self.poses(self.read_poses(images), vertices)
        return Reconstruction(vertices, self.read_textures(images), pose, self.read_backgrounds(images))

    def read_shapes(self, images: Float[Tensor, "B 3 H W"], features: Features) -> Float[Tensor, "B K"]:
        """Return the shape parameters it reads off photographs in [0, 1] or off their features."""
        return self.shape_decoder(self.shape_encoder(features if self.config.shapes_from == "features" else images))

    def read_textures(self, images: Float[Tensor, "B 3 H W"]) -> Float[Tensor, "B 3 T T"]:
        """Return the texture maps it reads off photographs in [0, 1]."""
        return self.texture_decoder(self.texture_encoder(images))

    def read_backgrounds(self, images: Float[Tensor, "B 3 H W"]) -> Float[Tensor, "B 3 H W"]:
        """Return the backgrounds it reads off photographs in [0, 1]."""
        return self.background_decoder(self.background_encoder(images))

    @torch.no_grad()
    def read_poses(self, images: Float[Tensor, "B 3 H W"]) -> Float[Tensor, "B 7"]:
        """Return the student's pose coordinates; of mirror-symmetric shapes the mean of both pictures' readings.

        The other picture is the photograph's mirror image, in which such an object's pose is known.
        """
        said = self.pose_decoder(self.pose_encoder(images))
        if self.config.shape.mirror:
            mirrored = self.pose_decoder(self.pose_encoder(images.flip(-1))).mirror(self.poses)
            said = PoseRegression(*((one + other) / 2 for one, other in zip(said, mirrored, strict=True)))
        return said.coordinates

    def render(self, reconstruction: Reconstruction) -> Float[Tensor, "B 3 H W"]:
        """Render reconstructions without directional light, because textures hold the shading (paper section 3.2)."""
        vertices, texture_maps, pose, backgrounds = reconstruction
        mesh = Mesh(vertices, self.faces, self.directions)
        return render(mesh, texture_maps, pose, backgrounds, None, self.config.renderer).images


def save_full_model(path: Path, model: FullModel, others: Mapping[str, Tensor]) -> None:
    """Save a model, with other tensors beside its weights."""
    save_tensors(path, {**model.state_dict(), **others}, {"config": json.dumps(asdict(model.config), sort_keys=True)})


def load_full_model(path: Path, device: torch.device) -> FullModel:
    """Load a model that `save_full_model` saved, in evaluation mode and in float32.

    Raises DataError where its weights are not those of this code's networks.
    """
    tensors, metadata = load_tensors(path)
    config = from_json(metadata["config"], FullModelConfig, path)
    base = Mesh(tensors["base_vertices"][None], tensors["faces"], tensors["directions"])
    channels = tensors["shape_encoder.project.weight"].shape[1] // POSITIONS  # of feature maps, where shapes read them
    model = FullModel(config, base, torch.float32, channels)
    load_weights(model, tensors, path)
    return model.to(device).eval()
