"""A full model of a few thousand weights around an asymmetric body, and photographs of such bodies, for tests."""

from dataclasses import replace

import pytest
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from pipeline.datasets.images import to_bytes
from pipeline.geometry.camera import CameraConfig
from pipeline.geometry.icosphere import icosphere
from pipeline.geometry.normalize import fit_unit_cube
from pipeline.geometry.symmetry import mirror_index
from pipeline.losses.smoothness import SmoothnessConfig
from pipeline.networks.encoders import EncoderConfig
from pipeline.networks.feature_extractor import FeatureExtractor
from pipeline.networks.full_model import FullModel, FullModelConfig, Reconstruction
from pipeline.networks.pose_coordinates import PoseRange
from pipeline.networks.pose_decoder import PoseRegression
from pipeline.networks.scene_generator import (
    ConstraintConfig,
    GeneratorConfig,
    LearnedScenes,
    SceneConfig,
    SceneGenerator,
)
from pipeline.networks.shapes import BaseLearningConfig, ShapeConfig
from pipeline.networks.wide_resnet import WideResNet
from pipeline.rendering.renderer import Mesh, RendererConfig
from pipeline.seeding import generator, initialised
from pipeline.training.azimuths import ConsensusConfig
from pipeline.training.candidates import ExplorationConfig, ShapeSearchConfig
from pipeline.training.ends import EndsConfig
from pipeline.training.first_poses import FirstPosesConfig
from pipeline.training.full_losses import LossConfig
from pipeline.training.full_trainer import EllipsoidConfig, FullTrainingConfig
from pipeline.training.lessons import LessonsConfig
from pipeline.training.viewpoints import LightConfig
from pipeline.training.warm_up import WarmUpConfig

CHANNELS = 3 + 16 + 32 + 64
"""Of the tiny extractor's maps."""
MODEL = FullModelConfig(
    two_stage=True,
    framing="free",
    encoder=EncoderConfig("wide_resnet", 8, 1),
    shapes_from="features",
    code_size=16,
    texture_code_size=4,
    hidden_size=16,
    pose_heads=2,
    pose_range=PoseRange((0.0, 30.0), (-10.0, 10.0), (-0.2, 0.2), (0.7, 1.0)),
    box_rim=0.0,
    texture_size=16,
    texture_channels=4,
    mirror_texture=True,
    stripes=True,
    shape=ShapeConfig(
        mirror=True,
        grid_reach=0.1,
        dimension_reach=0.2,
        base_learning=BaseLearningConfig(4.0, 2.0, mirror=True, thinnest=1.0),
        offset_reach=0.1,
    ),
    renderer=RendererConfig(CameraConfig(2.7, 30.0), 32, 2),
)
ENDS = EndsConfig(
    shown="equally",
    after=(),
    box_size=0.85,
    components=8,
    repainting_floor=0.3,
    consistency=2.0,
    side_reach=60.0,
    rounds=3,
    ridge=4.0,
    folds=2,
    photographs=1000,
)
TRAINING = FullTrainingConfig(
    iterations=4,
    batch_size=4,
    learning_rate=1e-3,
    betas=(0.5, 0.99),
    cool_down=0.0,
    photographs_per_iteration=2.0,
    model=MODEL,
    ellipsoid=EllipsoidConfig((0.5, 0.5, 1.0), 2),
    warm_up=WarmUpConfig(
        iterations=2,
        batch_size=4,
        learning_rate=1e-3,
        betas=(0.9, 0.99),
        light=LightConfig(0.5, 0.5),
        shape_spread=0.3,
        paint=0.3,
        noise=0.1,
    ),
    first_poses=FirstPosesConfig(
        renderings=8,
        pose_reach=0.5,
        box_jitter=0.1,
        box_size=0.85,
        temperature=1.0,
        concentration=20.0,
        consensus=ConsensusConfig(
            rounds=1,
            smaller_end=0.4,
            components=4,
            repainting_floor=0.3,
            ridge=0.3,
            folds=2,
            sharpness=3.0,
        ),
        photographs=100,
    ),
    lessons=LessonsConfig(iterations=2, batch_size=4, learning_rate=1e-3, betas=(0.9, 0.99)),
    ends=ENDS,
    settle=0.5,
    exploration=ExplorationConfig(
        map_weights=(0.1, 1.0, 2.0),
        random_poses=1,
        turned_poses=2,
        raised_poses=3,
        flipped_poses=3,
        perturbed_poses=2,
        shapes=ShapeSearchConfig(random=1, perturbed=1, step=(0.02, 0.2), spread=0.5),
        pose_step=(0.02, 0.2),
        azimuth_reach=180.0,
    ),
    loss=LossConfig(
        deepest_map=0.5,
        feature_matching=0.1,
        pose_regression=1.0,
        mirrored_regression=1.0,
        rendered_regression=1.0,
        shape_regression=1.0,
        rendered_shape_regression=1.0,
        shape_prior=1.0,
        total_variation=0.1,
        copied_background=1.0,
        view_prior=0.1,
        smoothness=SmoothnessConfig(1.0, 0.0, 0.0, 0.01, 0.0, 0.0),
        base_roughness=1.0,
        base_thinness=1.0,
    ),
    discriminator_width=4,
    curve_every=2,
    checkpoint_every=2,
)


def base_mesh() -> Mesh:
    """Return a long body, mirror-symmetric about x = 0, whose rear half is taller than its front."""
    directions, faces = icosphere(2)
    taller = 1 + 0.6 * torch.sigmoid(-4 * directions[:, 2:])
    return Mesh(fit_unit_cube((directions * torch.tensor([0.4, 0.4, 1.0]) * taller)[None]), faces, directions)


def tiny_model(**changes: object) -> FullModel:
    """Build the tiny model, with some entries of its config replaced."""
    with initialised(0):
        return FullModel(replace(MODEL, **changes), base_mesh(), torch.float32, CHANNELS)


def inferred(model: FullModel, images: Float[Tensor, "B 3 32 32"]) -> Reconstruction:
    """Return what a tiny model in evaluation mode reads off photographs and their features."""
    return model.eval().infer(images, tiny_extractor()(images))


def tiny_extractor() -> FeatureExtractor:
    """Return a small extractor with random weights."""
    with initialised(1):
        return FeatureExtractor(WideResNet(10, 1, 2), 2.0)


def photographs(count: int) -> tuple[UInt8[Tensor, "N 3 32 32"], Float[Tensor, "N 7"]]:
    """Photograph the base mesh at random poses; return pictures and pose coordinates."""
    coordinates = tiny_model().poses.draw(count, generator(2))
    return photographs_of(coordinates), coordinates


def photographs_of(
    coordinates: Float[Tensor, "N 7"],
    pose_range: PoseRange = MODEL.pose_range,
    shape: Float[Tensor, "N K"] | None = None,
) -> UInt8[Tensor, "N 3 32 32"]:
    """Render the base mesh, or deformations of it, front red and rear blue, at poses."""
    model, count = tiny_model(pose_range=pose_range), len(coordinates)
    vertices = model.shapes(torch.zeros(count, model.shapes.parameter_count) if shape is None else shape)
    columns = torch.linspace(0, 1, 32)
    front = 1 - (2 * columns - 1).abs()
    texture_map = torch.stack([front, 0.3 * torch.ones(32), 1 - front])[:, None].expand(3, 32, 32)
    pictures = model.render(
        Reconstruction(
            vertices,
            texture_map.expand(count, -1, -1, -1),
            model.poses(coordinates, vertices),
            torch.full((count, 3, 32, 32), 0.8),
        )
    )
    return to_bytes(pictures)


def tiny_scenes() -> LearnedScenes:
    """Build generators whose shapes are nearly the base mesh, and whose textures and backgrounds are untrained.

    With these seeds colours are various enough for a warm-up to find objects in other pictures.
    """
    base = base_mesh()
    generator = GeneratorConfig(8, 8, 0.1, 4, 8, 8, mirror_texture=True)
    constraints = ConstraintConfig(smoothness=True, symmetry=True, texture_simplicity=True, background_simplicity=True)
    config = SceneConfig(generator, constraints, 2, MODEL.renderer.size)
    generators = []
    for seed in (4, 5):
        with initialised(seed):
            generators.append(SceneGenerator(config, base.vertices[0], mirror_index(base.directions)).eval())
    return LearnedScenes(generators, base.faces, base.directions)


def exact_regression(coordinates: Tensor) -> PoseRegression:
    """Return what a head says that knows the poses."""
    twice = 2 * torch.atan2(coordinates[..., 1], coordinates[..., 0])
    return PoseRegression(coordinates[..., :2], torch.stack([twice.cos(), twice.sin()], -1), coordinates[..., 2:])


def scramble_paint(extractor: FeatureExtractor, monkeypatch: pytest.MonkeyPatch) -> None:
    """Exchange the pictures and the network's first maps within each batch."""
    look = extractor.forward

    def scrambled(pictures: Tensor) -> list[Tensor]:
        colors, edges, *deep = look(pictures)
        return [colors.flip(0), edges.flip(0), *deep]

    monkeypatch.setattr(extractor, "forward", scrambled)
