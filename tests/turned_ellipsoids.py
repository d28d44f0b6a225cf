"""Ellipsoids that are seen from known places, and answers about them in a frame that is turned."""

import math

import torch
from torch import Tensor

from pipeline.evaluation.alignment import turn_pose, turn_vertices
from pipeline.evaluation.artifacts import Reconstructions, Snapshot, TrueObjects, Truth
from pipeline.evaluation.evaluate import ChainResult, EvaluateConfig
from pipeline.evaluation.multiview import MultiviewConfig
from pipeline.evaluation.shape_metrics import ShapeMetricsConfig, silhouettes
from pipeline.geometry.camera import CameraConfig, Pose
from pipeline.geometry.icosphere import icosphere
from pipeline.rendering.renderer import RendererConfig

COUNT, TRAINING_COUNT = 12, 20
VISITED = torch.arange(8, TRAINING_COUNT)
RENDERER = RendererConfig(camera=CameraConfig(distance=2.7, field_of_view=30.0), size=16, supersampling=2)
CONFIG = EvaluateConfig(
    seed=0,
    shape=ShapeMetricsConfig(voxel_resolution=16, surface_points=400),
    chance_draws=36,
    batch_size=5,
    multiview=MultiviewConfig(objects=COUNT, step=50, elevation=10.0, ridge=0.1, examples=2),
)
FRAME = math.radians(90)


def seen_from(azimuth: Tensor, seed: int) -> Pose:
    """Return poses within a few degrees of these azimuths in degrees."""
    noise = torch.rand(2, len(azimuth), generator=torch.Generator().manual_seed(seed)) * 0.2 - 0.1
    zeros = torch.zeros(len(azimuth))
    return Pose(azimuth.deg2rad() + noise[0], 0.2 + noise[1], zeros, torch.zeros(len(azimuth), 2), zeros + 0.8)


def ellipsoids(sizes: Tensor) -> Tensor:
    return icosphere(2)[0].float() / 2 * sizes[:, None]


def reconstruction(pose: Pose, vertices: Tensor, shade: float) -> Snapshot:
    images = torch.full((len(vertices), 3, 16, 16), shade)
    return Snapshot(pose, vertices, torch.zeros_like(images), images)


def shown_ellipsoids() -> Truth:
    """Show long ellipsoids, most of them from a side and a quarter from the front."""
    wider = torch.linspace(-0.05, 0.05, COUNT)
    sizes = torch.stack([0.5 + wider, 0.38 + 20 * wider.square(), torch.ones(COUNT)], dim=1)
    vertices, (directions, faces) = ellipsoids(sizes), icosphere(2)
    pose = seen_from(torch.where(torch.arange(COUNT) % 4 == 0, 10.0, 100.0), 0)
    masks = silhouettes(reconstruction(pose, vertices, 0), faces, directions.float(), RENDERER)
    return Truth(pose, TrueObjects(masks, vertices, faces))


def training_ellipsoids() -> Truth:
    """Show flat ellipsoids from the front in the left half of pictures, and fewer high ones from behind on top.

    Only four of the flat ones are visited during training, but all of the others.
    """
    flat = torch.arange(TRAINING_COUNT) < 12
    vertices = ellipsoids(torch.where(flat[:, None], torch.tensor([1.0, 0.4, 0.8]), torch.tensor([0.4, 1.0, 0.4])))
    masks = torch.zeros(TRAINING_COUNT, 16, 16, dtype=torch.bool)
    masks[flat, :, :8], masks[~flat, :8] = True, True
    return Truth(seen_from(torch.where(flat, 0.0, 180.0), 1), TrueObjects(masks, vertices, icosphere(2)[1]))


def turned_answers(training: Truth, truth: Truth) -> ChainResult:
    """Give the right answers in a frame turned by 90 degrees; before fine-tuning a third of the poses are flipped."""
    directions, faces = icosphere(2)
    assert truth.objects is not None
    pose, vertices = turn_pose(truth.pose, -FRAME), turn_vertices(truth.objects.vertices, -FRAME)
    wrong = pose._replace(azimuth=pose.azimuth + math.pi * (torch.arange(COUNT) % 3 == 0))
    reconstructions = Reconstructions(
        reconstruction(wrong, vertices, 0.5),
        reconstruction(pose, vertices, 0.25),
        torch.zeros(COUNT, 3, 4, 4),
        faces,
        directions.float(),
        torch.arange(COUNT),
    )
    recorded = turn_pose(training.pose.at(VISITED), -FRAME)
    return ChainResult(reconstructions, recorded, VISITED, vertices[COUNT // 2], vertices[0], faces, RENDERER)
