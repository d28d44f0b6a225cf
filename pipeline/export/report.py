"""The report of a run: one HTML page to open from disk, and figures of renderings alone."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

from pipeline.evaluation.artifacts import Reconstructions
from pipeline.export.picture import enlarge, tile, write_png
from pipeline.export.report_meshes import base_exhibit, reconstruction_exhibits, seed_exhibits
from pipeline.export.report_metrics import curve_section, headline, metrics_section, pose_section
from pipeline.export.report_page import Section, page
from pipeline.export.report_pictures import Gallery, base_shape_section, example_section, step_section
from pipeline.export.viewer import viewer_section
from pipeline.export.views import ViewConfig, on_white
from pipeline.files import atomic_path
from pipeline.geometry.camera import CameraConfig
from pipeline.networks.pose_coordinates import Framing
from pipeline.seeding import generator


@dataclass(frozen=True)
class ReportConfig:
    """What the page shows.

    Attributes:
        seed: of the random choice of examples.
        examples: random pictures shown, and as many of the best.
        stepped: of the random pictures, how many are shown in 50-degree steps.
        frames: renderings in one turn of a turntable.
        other_view: turn in degrees from the estimated view to the other view of an example.
        view: size and elevation of renderings.
    """

    seed: int
    examples: int
    stepped: int
    frames: int
    other_view: float
    view: ViewConfig


class ReportInputs(NamedTuple):
    """What the chain produced.

    Attributes:
        drawn: whether the project itself draws the photographs, so that figures may show them.
        framing: of the photographs; `box` lets objects fill their other views too.
        base: base shape of the full model, with the faces of the reconstructions.
        figures: of `evaluate`.
        stage_figures: metrics of the other stages, by the stage's name.
        curves: columns of each training's curve, by the stage's name.
        table: one row a picture, as `evaluate` wrote it.
        seeds: base shapes of all seeds, with their faces and scores; the lowest score was chosen.
    """

    run: str
    photographs: Float[Tensor, "B 3 H W"]
    drawn: bool
    reconstructions: Reconstructions
    seeds: Float[Tensor, "S V 3"]
    seed_faces: Int[Tensor, "F 3"]
    seed_scores: Float[Tensor, " S"]
    base: Float[Tensor, "V 3"]
    camera: CameraConfig
    framing: Framing
    figures: Mapping[str, Any]
    stage_figures: Mapping[str, Mapping[str, Any]]
    curves: Mapping[str, Mapping[str, list[str]]]
    table: Mapping[str, list[str]]


def write_report(inputs: ReportInputs, config: ReportConfig, page_folder: Path, figure_folder: Path) -> None:
    """Write `index.html` to one folder and figures to another, each folder whole or not at all."""
    best, random = choose_examples(inputs, config)
    gallery = Gallery(inputs.reconstructions, inputs.photographs, inputs.camera, inputs.framing, config.view)
    seeds = gallery.seed_views(inputs.seeds, inputs.seed_faces)
    exhibits = [
        *reconstruction_exhibits("best", "Best reconstructions", gallery, best, inputs.table),
        *reconstruction_exhibits("random", "Random reconstructions", gallery, random, inputs.table),
        base_exhibit(inputs.base, gallery),
        *seed_exhibits(inputs.seeds, inputs.seed_faces, inputs.seed_scores, seeds, config.view.elevation),
    ]
    sections = [
        viewer_section(exhibits, inputs.camera),
        base_shape_section(seeds, inputs.seed_scores),
        example_section("best", "Best reconstructions", gallery, best, inputs.table, config.other_view),
        example_section("random", "Random reconstructions", gallery, random, inputs.table, config.other_view),
        step_section(gallery, random[: config.stepped], inputs.table["test_index"]),
        *pose_section(inputs.figures, inputs.table),
        curve_section(inputs.curves),
        metrics_section(inputs.figures, inputs.stage_figures),
    ]
    write_page(page_folder, inputs, sections)
    with atomic_path(figure_folder) as folder:
        folder.mkdir()
        write_png(folder / "base_shapes.png", tile(on_white(seeds), gap=4, shade=1.0))
        renderings = gallery.renderings(torch.cat([best, random]), config.other_view)
        factor = max(1, config.view.size // renderings.shape[-1])
        write_png(folder / "reconstructions.png", tile(enlarge(renderings.transpose(0, 1), factor), gap=4, shade=1.0))
        steps = torch.stack([gallery.steps(index) for index in random[: config.stepped].tolist()])
        write_png(folder / "steps.png", tile(on_white(steps), gap=4, shade=1.0))
        write_png(folder / "examples.png", tile(example_rows(gallery, random, inputs.drawn), gap=4, shade=1.0))


def example_rows(gallery: Gallery, index: Int[Tensor, " K"], drawn: bool) -> Float[Tensor, "R K 3 H W"]:
    """Show pictures as columns: the photograph if the project has drawn it, its reconstruction, the object alone."""
    objects = on_white(torch.stack([gallery.corners(position) for position in index.tolist()], dim=1))
    pictures = torch.stack([gallery.photographs[index]] * drawn + [gallery.reconstructions.tuned.images[index]])
    enlarged = functional.interpolate(pictures.flatten(0, 1), objects.shape[-2:])
    return torch.cat([enlarged.unflatten(0, pictures.shape[:2]), objects])


def choose_examples(inputs: ReportInputs, config: ReportConfig) -> tuple[Int[Tensor, " K"], Int[Tensor, " K"]]:
    """Choose the pictures reconstructed best, by feature distance after fine-tuning, and others at random."""
    distance = torch.tensor([float(value) for value in inputs.table["feature_distance_tuned"]])
    order = torch.randperm(len(distance), generator=generator(config.seed, "report examples"))
    return distance.argsort(stable=True)[: config.examples], order[: config.examples]


def write_page(folder: Path, inputs: ReportInputs, sections: Sequence[Section]) -> None:
    """Write the page into its folder."""
    introduction = (
        f"What the chain learned from photographs of one category, on {len(inputs.photographs)} test pictures."
    )
    text = page(f"Run {inputs.run}", introduction, headline(inputs.figures), sections)
    with atomic_path(folder) as temporary:
        temporary.mkdir()
        (temporary / "index.html").write_text(text, encoding="utf-8", newline="\n")
