"""The shape section of a run's metrics: volumes, surfaces and masks against the ground truth."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from pipeline.evaluation.artifacts import Snapshot, TrueObjects
from pipeline.evaluation.shape import chamfer_l1, fit_constant, iou, proportions, sample_outer_surface
from pipeline.evaluation.statistics import Columns, Figure, correlation_figure, mean_figure
from pipeline.geometry.normalize import fit_unit_cube
from pipeline.geometry.voxels import voxelize
from pipeline.ranges import Count
from pipeline.rendering.renderer import Mesh, RendererConfig, render

_FACES_AT_ONCE = 2**21
"""Of all shapes from whose surfaces points are drawn together; a face takes about 200 bytes."""


@dataclass(frozen=True)
class ShapeMetricsConfig:
    """How finely shapes are compared."""

    voxel_resolution: Count
    """Voxels along each side of the unit cube."""
    surface_points: Count
    """Points drawn from each surface for the Chamfer distance."""


class TrueShapes:
    """The true shapes of the test pictures, voxelized and sampled once, and what is typical of the training split."""

    def __init__(
        self, truth: TrueObjects, training: TrueObjects, config: ShapeMetricsConfig, rng: torch.Generator
    ) -> None:
        self._config = config
        self.vertices, self.faces = truth.vertices, truth.faces
        self.voxels = voxelize(truth.vertices, truth.faces, config.voxel_resolution)
        self.points = sample_outer_surface(truth.vertices, truth.faces, self.voxels, config.surface_points, rng)
        occupied = voxelize(training.vertices, training.faces, config.voxel_resolution)
        self.mean_shape: Bool[Tensor, "K K K"] = occupied.double().mean(0) >= 0.5
        self.constant: Bool[Tensor, "K K K"] = fit_constant(occupied)

    def columns(
        self, vertices: Float[Tensor, "B V 3"], faces: Sequence[Int[Tensor, "_ 3"]], rng: torch.Generator
    ) -> Columns:
        """Compare one shape per picture, already in the frame of the truth, with the picture's true shape.

        `faces` are those that all shapes share, or one entry a shape. Shapes are scaled into the unit cube again,
        because turning them may have changed their bounding box.
        """
        parts = zip(vertices.split(len(vertices) // len(faces)), faces, strict=True)
        voxels, points = zip(*(self._sample(shapes, own, rng) for shapes, own in parts), strict=True)
        return {
            "voxel_iou": iou(torch.cat(voxels), self.voxels),
            "chamfer_l1": _chamfer_in_parts(torch.cat(points), self.points),
        }

    def proportion_figures(self, vertices: Float[Tensor, "B V 3"]) -> dict[str, Figure]:
        """Correlate relative widths and heights of shapes, in the frame of the truth, with those of the true shapes.

        What no constant shape can do, and what volumes hardly show.
        """
        names = ("width_correlation", "height_correlation")
        found, true = (proportions(shapes).unbind(dim=1) for shapes in (vertices, self.vertices))
        return dict(zip(names, map(correlation_figure, found, true), strict=True))

    def base_figures(
        self, base: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"], rng: torch.Generator
    ) -> dict[str, Any]:
        """Compare the one base shape, already aligned, with every test picture's shape and with the mean shape."""
        voxels, points = self._sample(base[None], faces, rng)
        return {
            "voxel_iou": mean_figure(iou(voxels.expand_as(self.voxels), self.voxels)),
            "chamfer_l1": mean_figure(_chamfer_in_parts(points.expand_as(self.points), self.points)),
            "mean_shape_iou": iou(voxels, self.mean_shape[None]).item(),
        }

    def constant_figure(self) -> Figure:
        """Compare the one shape that suits the training split best with every test picture's shape."""
        return mean_figure(iou(self.constant.expand_as(self.voxels), self.voxels))

    def _sample(
        self, vertices: Float[Tensor, "B V 3"], faces: Int[Tensor, "F 3"], rng: torch.Generator
    ) -> tuple[Bool[Tensor, "B K K K"], Float[Tensor, "B count 3"]]:
        """Scale shapes into the unit cube; return the voxels that they fill, and points on their surfaces."""
        resolution, count = self._config.voxel_resolution, self._config.surface_points
        voxels, points = [], []
        for fitted in fit_unit_cube(vertices).split(max(1, _FACES_AT_ONCE // len(faces))):
            voxels.append(voxelize(fitted, faces, resolution))
            points.append(sample_outer_surface(fitted, faces, voxels[-1], count, rng))
        return torch.cat(voxels), torch.cat(points)


def constant_mask_figure(training: Bool[Tensor, "N H W"], truth: Bool[Tensor, "B H W"]) -> Figure:
    """Compare the one mask that suits the training split best with every test picture's mask."""
    return mean_figure(iou(fit_constant(training).expand_as(truth), truth))


def silhouettes(
    reconstruction: Snapshot,
    faces: Int[Tensor, "F 3"],
    directions: Float[Tensor, "V 3"],
    config: RendererConfig,
) -> Bool[Tensor, "B H W"]:
    """Render the masks of reconstructed objects: pixels covered by at least half."""
    white = torch.ones(len(reconstruction.vertices), 3, 2, 2)
    mesh = Mesh(reconstruction.vertices, faces, directions)
    return render(mesh, white, reconstruction.pose, None, None, config).silhouettes >= 0.5


def _chamfer_in_parts(first: Float[Tensor, "B K 3"], second: Float[Tensor, "B K 3"]) -> Float[Tensor, " B"]:
    parts = zip(first.split(16), second.split(16), strict=True)
    return torch.cat([chamfer_l1(one, other) for one, other in parts])
