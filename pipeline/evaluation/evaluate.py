"""Measure one run: its reconstructions, and its viewpoints and shapes where the truth is known."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from jaxtyping import Float, Int, UInt8
from torch import Tensor

from pipeline.evaluation.alignment import fit_alignment, turn_pose, turn_vertices
from pipeline.evaluation.artifacts import STATES, Reconstructions, TrueObjects, Truth
from pipeline.evaluation.image_metrics import image_columns, image_figures
from pipeline.evaluation.multiview import MultiviewConfig
from pipeline.evaluation.pose_metrics import angle_columns, baseline_figures, pose_columns, pose_figures
from pipeline.evaluation.retrieval import retrieve
from pipeline.evaluation.shape import iou, vertex_deviation
from pipeline.evaluation.shape_metrics import ShapeMetricsConfig, TrueShapes, constant_mask_figure, silhouettes
from pipeline.evaluation.statistics import Columns, mean_figure, mean_figures
from pipeline.geometry.camera import Pose, pose_from_tensor
from pipeline.networks.feature_extractor import FeatureExtractor
from pipeline.networks.full_model import FullModel
from pipeline.ranges import Count, Natural
from pipeline.rendering.renderer import RendererConfig
from pipeline.seeding import generator

SECTIONS = {"predicted": "test", "tuned": "test_tuned"}


@dataclass(frozen=True)
class EvaluateConfig:
    """How a run is measured."""

    seed: Natural
    """Of random guesses, bootstrapped medians and points drawn from surfaces."""
    shape: ShapeMetricsConfig
    """How finely shapes are compared."""
    chance_draws: Count
    """Random guesses a picture for the chance rows."""
    batch_size: Count
    """Pictures in one pass through the feature extractor."""
    multiview: MultiviewConfig
    """How consistent objects are from all around."""


class ChainResult(NamedTuple):
    """What the chain learned, all in the learned frame."""

    reconstructions: Reconstructions
    training_pose: Pose
    """Recorded best poses of the training pictures that were visited."""
    training_index: Int[Tensor, " N"]
    """Position of each of these pictures in the training split."""
    base: Float[Tensor, "V 3"]
    """Base shape after remeshing, with its faces."""
    final_base: Float[Tensor, "V 3"] | None
    """Base shape after full training, in which it may go on learning, with the faces of the reconstructions; None in
    single-stage training, which has none."""
    base_faces: Int[Tensor, "F 3"]
    renderer: RendererConfig
    """Camera and size of the reconstructions, for their masks."""


class PoseEstimates(NamedTuple):
    """Poses in a frame that may be turned about the vertical axis against that of the truth."""

    training: Pose
    """Of training pictures."""
    training_index: Int[Tensor, " N"]
    """Position of each of these pictures in the training split."""
    test: Mapping[str, Pose]
    """Of all test pictures, by the section of the metrics that they are measured in."""


def evaluate_images(
    photographs: Float[Tensor, "B 3 H W"],
    training: UInt8[Tensor, "N 3 H W"],
    reconstructions: Reconstructions,
    extractor: FeatureExtractor,
    config: EvaluateConfig,
) -> tuple[dict[str, Any], Columns]:
    """Measure reconstructions before and after fine-tuning; return the figures and one row a picture.

    Beside them stand what retrieving a training photograph by its colours reaches, and how much shapes differ.
    """
    images = {state: reconstructions.at(state).images for state in STATES}
    images["retrieved"] = retrieve(photographs, training)
    columns = image_columns(photographs, images, extractor, config.batch_size)
    table = {"test_index": reconstructions.test_index, **_flatten({state: columns[state] for state in STATES})}
    spread = {state: mean_figure(vertex_deviation(reconstructions.at(state).vertices)) for state in STATES}
    return {"reconstruction": image_figures(columns), "vertex_deviation": spread}, table


def chain_result(
    reconstructions: Reconstructions,
    model: FullModel,
    trained: Mapping[str, Tensor],
    mesh: Mapping[str, Tensor],
) -> ChainResult:
    """Collect what the chain learned from the tensors of its artifacts: `trained` the full model, `mesh` remeshed."""
    base = model.shapes.base().detach() if model.config.two_stage else None
    visited = trained["train_visits"].nonzero().flatten()
    pose = pose_from_tensor(trained["train_pose"][visited])
    return ChainResult(reconstructions, pose, visited, mesh["vertices"], base, mesh["faces"], model.config.renderer)


def evaluate_truth(
    learned: ChainResult, training: Truth, test: Truth, config: EvaluateConfig
) -> tuple[dict[str, Any], Columns]:
    """Measure viewpoints, and shapes where they are known; return the figures and one row a picture.

    `training` is the whole training split: what is typical of it does not depend on which pictures the run visited. The
    learned frame is first turned about +y by the angle that suits the recorded poses of those that it did visit best.
    """
    predicted = {state: learned.reconstructions.at(state).pose for state in STATES}
    by_section = {SECTIONS[state]: pose for state, pose in predicted.items()}
    estimates = PoseEstimates(learned.training_pose, learned.training_index, by_section)
    angle, figures = measure_poses(training.pose, test.pose, estimates, config)
    truth = {f"truth_{name}": degrees for name, degrees in angle_columns(test.pose).items()}
    columns = {state: pose_columns(test.pose, turn_pose(pose, angle)) for state, pose in predicted.items()}
    table = {**truth, **_flatten(columns)}
    if training.objects is not None and test.objects is not None:
        figures["shape"], shape_table = _evaluate_shape(learned, training.objects, test.objects, angle, config)
        table |= shape_table
    return figures, table


def measure_poses(
    training: Pose, test: Pose, estimates: PoseEstimates, config: EvaluateConfig
) -> tuple[float, dict[str, Any]]:
    """Fit the turn that takes estimates to the truth, on those of training pictures, and measure all of them by it.

    `training` and `test` are the true poses of whole splits. Returns the turn in radians, and the sections `alignment`
    and `pose` of the metrics.
    """
    visited = training.at(estimates.training_index)
    angle = fit_alignment(visited, estimates.training)
    rng = generator(config.seed, "evaluate pose")
    figures: dict[str, Any] = baseline_figures(test, training, config.chance_draws, rng)
    figures["train"] = pose_figures(visited, turn_pose(estimates.training, angle), rng)
    for split, estimate in estimates.test.items():
        figures[split] = pose_figures(test, turn_pose(estimate, angle), rng)
    alignment = {"degrees": math.degrees(angle), "n": len(estimates.training_index)}
    return angle, {"alignment": alignment, "pose": figures}


def _evaluate_shape(
    learned: ChainResult, training: TrueObjects, test: TrueObjects, angle: float, config: EvaluateConfig
) -> tuple[dict[str, Any], Columns]:
    rng = generator(config.seed, "evaluate shape")
    shapes = TrueShapes(test, training, config.shape, rng)
    columns: dict[str, Columns] = {}
    figures: dict[str, Any] = {}
    for state, section in SECTIONS.items():
        reconstruction = learned.reconstructions.at(state)
        vertices = turn_vertices(reconstruction.vertices, angle)
        columns[state] = shapes.columns(vertices, [learned.reconstructions.faces], rng)
        masks = silhouettes(
            reconstruction, learned.reconstructions.faces, learned.reconstructions.directions, learned.renderer
        )
        columns[state]["mask_iou"] = iou(masks, test.masks)
        figures[section] = mean_figures(columns[state]) | shapes.proportion_figures(vertices)
    if learned.final_base is not None:  # single-stage training takes none
        figures["base"] = shapes.base_figures(turn_vertices(learned.base, angle), learned.base_faces, rng)
        final_base = turn_vertices(learned.final_base, angle)
        figures["final_base"] = shapes.base_figures(final_base, learned.reconstructions.faces, rng)
    figures["constant"] = {
        "voxel_iou": shapes.constant_figure(),
        "mask_iou": constant_mask_figure(training.masks, test.masks),
    }
    return figures, _flatten(columns)


def _flatten(columns: Mapping[str, Columns]) -> Columns:
    return {f"{name}_{state}": values for state, group in columns.items() for name, values in group.items()}
