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
from pipeline.export.picture import sheet, write_png
from pipeline.export.report_meshes import base_exhibit, reconstruction_exhibits, seed_exhibits
from pipeline.export.report_metrics import curve_section, headline, metrics_section, pose_section
from pipeline.export.report_page import Section, page
from pipeline.export.report_pictures import Gallery, base_shape_section, example_section, seed_captions, step_section
from pipeline.export.viewer import Exhibit, viewer_section
from pipeline.export.views import ViewConfig, on_white
from pipeline.files import atomic_path
from pipeline.geometry.camera import CameraConfig
from pipeline.networks.pose_coordinates import Framing
from pipeline.ranges import Count, Natural
from pipeline.seeding import generator


@dataclass(frozen=True)
class ReportConfig:
    """What the page shows."""

    seed: Natural
    """Of the random choice of examples."""
    examples: Count
    """Random pictures shown, and as many of the best."""
    stepped: Count
    """Of the random pictures, how many are shown in 50-degree steps."""
    other_view: float
    """Turn in degrees from the estimated view to the other view of an example."""
    view: ViewConfig
    """Size and elevation of renderings."""


class ReportInputs(NamedTuple):
    """What the chain produced."""

    run: str
    photographs: Float[Tensor, "B 3 H W"]
    drawn: bool
    """Whether the project itself draws the photographs, so that figures may show them."""
    reconstructions: Reconstructions
    seeds: Float[Tensor, "S V 3"]
    """Base shapes of all seeds, with their faces, their scores and the one that was chosen."""
    seed_faces: Int[Tensor, "F 3"]
    seed_scores: Float[Tensor, " S"]
    chosen_seed: int
    base: Float[Tensor, "V 3"] | None
    """Base shape of the full model, with the faces of the reconstructions; None after single-stage training."""
    camera: CameraConfig
    framing: Framing
    """Of the photographs; `box` lets objects fill their other views too."""
    figures: Mapping[str, Any]
    """Of `evaluate`."""
    stage_figures: Mapping[str, Mapping[str, Any]]
    """Metrics of the other stages, by the stage's name."""
    curves: Mapping[str, Mapping[str, list[str]]]
    """Columns of each training's curve, by the stage's name."""
    table: Mapping[str, list[str]]
    """One row a picture, as `evaluate` wrote it."""


def write_report(inputs: ReportInputs, config: ReportConfig, page_folder: Path, figure_folder: Path) -> None:
    """Write `index.html` to one folder and figures to another, each folder whole or not at all."""
    best, random = choose_examples(inputs, config)
    gallery = Gallery(inputs.reconstructions, inputs.photographs, inputs.camera, inputs.framing, config.view)
    base_exhibits, base_sections = _base_shapes(inputs, gallery)
    exhibits = [
        *reconstruction_exhibits("best", "Best reconstructions", gallery, best, inputs.table),
        *reconstruction_exhibits("random", "Random reconstructions", gallery, random, inputs.table),
        *base_exhibits,
    ]
    sections = [
        viewer_section(exhibits, inputs.camera),
        *base_sections,
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
        write_png(folder / "examples.png", sheet(example_rows(gallery, random, inputs.drawn)))
        write_png(folder / "steps.png", sheet(step_rows(gallery, random[: config.stepped], inputs.table["test_index"])))
        rows = reconstruction_rows(gallery, best, "best", inputs.drawn, config.other_view)
        rows |= reconstruction_rows(gallery, random, "random", inputs.drawn, config.other_view)
        write_png(folder / "reconstructions.png", sheet(rows))


def _base_shapes(inputs: ReportInputs, gallery: Gallery) -> tuple[list[Exhibit], list[Section]]:
    """Show the base shapes of all seeds and after full training; nothing of a run that trained around none of them."""
    if inputs.base is None:
        return [], []
    seeds = gallery.seed_views(inputs.seeds, inputs.seed_faces)
    captions = seed_captions(inputs.seed_scores, inputs.chosen_seed)
    exhibits = seed_exhibits(inputs.seeds, inputs.seed_faces, captions, seeds, gallery.elevation)
    return [base_exhibit(inputs.base, gallery), *exhibits], [base_shape_section(seeds, captions, inputs.chosen_seed)]


def example_rows(gallery: Gallery, index: Int[Tensor, " K"], drawn: bool) -> dict[str, Float[Tensor, "K 3 H W"]]:
    """Show pictures as columns: the photograph if the project has drawn it, its reconstruction, the object alone."""
    corners = on_white(torch.stack([gallery.corners(position) for position in index.tolist()], dim=1))
    names = ("the object from one corner", "from the opposite corner", "its shape")
    reconstruction = {"reconstruction": _enlarged(gallery, gallery.reconstructions.tuned.images[index])}
    return _photographs(gallery, index, drawn, "") | reconstruction | dict(zip(names, corners, strict=True))


def reconstruction_rows(
    gallery: Gallery, index: Int[Tensor, " K"], choice: str, drawn: bool, other_view: float
) -> dict[str, Float[Tensor, "K 3 H W"]]:
    """Show pictures as columns: the photograph if the project has drawn it, its reconstructions, another view."""
    names = ("reconstruction", "fine-tuned", f"fine-tuned and turned by {other_view:g} degrees")
    renderings = gallery.renderings(index, other_view).unbind(dim=1)
    rows = {f"{choice}: {name}": _enlarged(gallery, row) for name, row in zip(names, renderings, strict=True)}
    return _photographs(gallery, index, drawn, f"{choice}: ") | rows


def step_rows(
    gallery: Gallery, index: Int[Tensor, " K"], numbers: Sequence[str]
) -> dict[str, Float[Tensor, "steps 3 H W"]]:
    """Show fine-tuned objects turned by 50 degrees from picture to picture."""
    return {
        f"test picture {numbers[position]}, in steps of 50 degrees": on_white(gallery.steps(position))
        for position in index.tolist()
    }


def _photographs(
    gallery: Gallery, index: Int[Tensor, " K"], drawn: bool, prefix: str
) -> dict[str, Float[Tensor, "K 3 H W"]]:
    return {f"{prefix}photograph": _enlarged(gallery, gallery.photographs[index])} if drawn else {}


def _enlarged(gallery: Gallery, pictures: Float[Tensor, "K 3 H W"]) -> Float[Tensor, "K 3 height width"]:
    return functional.interpolate(pictures, (gallery.size, gallery.size))


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
