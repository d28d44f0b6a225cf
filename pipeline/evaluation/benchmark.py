"""Measure the predictions of any method by what a run of this pipeline is measured by, under the same keys."""

from jaxtyping import Bool, UInt8
from torch import Tensor

from pipeline.config import merge
from pipeline.datasets.images import to_colors
from pipeline.errors import DataError
from pipeline.evaluation.alignment import turn_vertices
from pipeline.evaluation.artifacts import TrueObjects, Truth
from pipeline.evaluation.evaluate import EvaluateConfig, measure_poses
from pipeline.evaluation.image_metrics import pixel_columns
from pipeline.evaluation.predictions import SPLIT, Meshes, Predictions
from pipeline.evaluation.shape import iou
from pipeline.evaluation.shape_metrics import TrueShapes, constant_mask_figure
from pipeline.evaluation.statistics import Figures, mean_figure, mean_figures
from pipeline.seeding import generator


def benchmark_figures(
    predictions: Predictions,
    training: Truth,
    test: Truth,
    photographs: UInt8[Tensor, "N 3 H W"],
    config: EvaluateConfig,
) -> Figures:
    """Measure poses, masks, meshes and images, as far as they are there, beside what chance and constants reach.

    `photographs` are those of the test split. Meshes are turned as suits the poses of training pictures. Raises
    DataError for masks and meshes where the true ones are not known.
    """
    figures: Figures = {}
    angle = 0.0
    if predictions.poses is not None:
        angle, figures = measure_poses(training.pose, test.pose, predictions.poses, config)
    if predictions.masks is not None:
        figures = merge(figures, _mask_figures(predictions.masks, _objects(training), _objects(test)))
    if predictions.meshes is not None:
        found = _mesh_figures(predictions.meshes, angle, _objects(training), _objects(test), config)
        figures = merge(figures, found)
    if predictions.images is not None:
        figures = merge(figures, _image_figures(predictions.images, photographs))
    return figures


def _objects(truth: Truth) -> TrueObjects:
    if truth.objects is None:
        raise DataError("true masks and meshes are not known here; leave out 'masks', 'vertices' and 'faces'")
    return truth.objects


def _mask_figures(masks: Bool[Tensor, "N H W"], training: TrueObjects, test: TrueObjects) -> Figures:
    found = {"mask_iou": mean_figure(iou(masks, test.masks))}
    return {"shape": {SPLIT: found, "constant": {"mask_iou": constant_mask_figure(training.masks, test.masks)}}}


def _mesh_figures(
    meshes: Meshes, angle: float, training: TrueObjects, test: TrueObjects, config: EvaluateConfig
) -> Figures:
    rng = generator(config.seed, "evaluate shape")
    shapes = TrueShapes(test, training, config.shape, rng)
    vertices = turn_vertices(meshes.vertices, angle)
    found = mean_figures(shapes.columns(vertices, meshes.faces, rng)) | shapes.proportion_figures(vertices)
    return {"shape": {SPLIT: found, "constant": {"voxel_iou": shapes.constant_figure()}}}


def _image_figures(images: UInt8[Tensor, "N H W 3"], photographs: UInt8[Tensor, "N 3 H W"]) -> Figures:
    columns = pixel_columns(to_colors(photographs), to_colors(images.permute(0, 3, 1, 2)))
    return {"reconstruction": {"predicted": mean_figures(columns)}}
