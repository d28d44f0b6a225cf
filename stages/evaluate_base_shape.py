"""Draw the base shapes of all seeds, and measure them where the truth is known."""

from dataclasses import dataclass
from pathlib import Path

from jaxtyping import Float
from torch import Tensor

from pipeline.config import load
from pipeline.evaluation.artifacts import load_truth
from pipeline.evaluation.base_shape import base_shape_figures
from pipeline.export.picture import sheet, write_png
from pipeline.export.views import SEED_AZIMUTHS, ViewConfig, on_white, render_clay
from pipeline.files import write_json
from pipeline.geometry.camera import CameraConfig
from pipeline.networks.seed_choice import choose_seed
from pipeline.ranges import Count
from pipeline.tensor_files import load_tensors
from stages.command_line import parse, run


@dataclass(frozen=True)
class EvaluateBaseShapeConfig:
    """How base shapes are compared and shown."""

    voxel_resolution: Count
    """Voxels along each side of the unit cube."""
    camera: CameraConfig
    view: ViewConfig


def main() -> None:
    """Write a picture with one row a seed, and the figures as JSON: without known truth there are none."""
    arguments = parse(__doc__, truth=Path, category=str, base_shape=Path, chosen=str, out=Path, figure=Path)
    config = load(arguments.params, EvaluateBaseShapeConfig, arguments.sections)
    tensors, _ = load_tensors(arguments.base_shape)
    seeds, faces, scores = (tensors[name] for name in ("seed_vertices", "faces", "seed_scores"))
    views = [on_white(render_clay(seed, faces, SEED_AZIMUTHS, config.camera, config.view)) for seed in seeds]
    chosen = choose_seed(arguments.chosen, scores.tolist(), arguments.base_shape.stem)
    write_png(arguments.figure, sheet(dict(zip(seed_names(scores, chosen), views, strict=True))))
    truth, figures = load_truth(arguments.truth, arguments.category), {}
    if truth is not None:
        training, test = truth
        if training.objects is not None and test.objects is not None:
            figures = base_shape_figures(seeds, faces, chosen, training.objects, test.objects, config.voxel_resolution)
    write_json(arguments.out, figures)


def seed_names(scores: Float[Tensor, " S"], chosen: int) -> list[str]:
    """Say every seed's score, and which one was chosen."""
    names = [f"seed {seed}, score {score:.2f}" for seed, score in enumerate(scores.tolist())]
    names[chosen] += ", chosen"
    return names


if __name__ == "__main__":
    run(main)
