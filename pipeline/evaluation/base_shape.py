"""Base shapes of all seeds against the ground truth, before anything else is learned: what ablations of it compare."""

import math
from typing import Any

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from pipeline.evaluation.alignment import turn_vertices
from pipeline.evaluation.artifacts import TrueObjects
from pipeline.evaluation.shape import pairwise_iou
from pipeline.evaluation.statistics import mean_figure
from pipeline.geometry.normalize import fit_unit_cube
from pipeline.geometry.voxels import voxelize

TURNS = 24


def base_shape_figures(
    seeds: Float[Tensor, "S V 3"],
    faces: Int[Tensor, "F 3"],
    chosen: int,
    training: TrueObjects,
    test: TrueObjects,
    resolution: int,
) -> dict[str, Any]:
    """Measure the volume IoU of every seed's base shape with the true shapes of the test pictures.

    Base shapes have no poses to align them by: each is turned about +y to the one of 24 angles at which it overlaps
    most with the training split's shapes, on average. `voxel_iou` summarizes the seeds (n of them), `chosen` the test
    pictures under the seed that the label-free score chose.
    """
    known, truth = (voxelize(true.vertices, true.faces, resolution) for true in (training, test))
    overlaps = pairwise_iou(_aligned(seeds, faces, known), truth)
    means = overlaps.mean(1)
    return {
        "voxel_iou": mean_figure(means),
        "chosen": {"voxel_iou": mean_figure(overlaps[chosen])},
        "seeds": {str(seed): overlap for seed, overlap in enumerate(means.tolist())},
    }


def _aligned(
    seeds: Float[Tensor, "S V 3"], faces: Int[Tensor, "F 3"], known: Bool[Tensor, "B K K K"]
) -> Bool[Tensor, "S K K K"]:
    """Voxelize shapes in the turn about +y that suits the known ones best."""
    angles = [2 * math.pi * turn / TURNS for turn in range(TURNS)]
    turned = (fit_unit_cube(turn_vertices(seeds, angle)) for angle in angles)
    voxels = torch.stack([voxelize(shapes, faces, known.shape[-1]) for shapes in turned])
    overlaps = pairwise_iou(voxels.flatten(0, 1), known).mean(1).unflatten(0, (TURNS, -1))
    return voxels[overlaps.argmax(dim=0), torch.arange(len(seeds))]
