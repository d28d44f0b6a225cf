"""The page of all runs: one table of their figures, with links to their pages."""

import re
from collections.abc import Mapping, Sequence
from html import escape
from itertools import groupby
from pathlib import Path
from statistics import mean, stdev
from typing import Any, NamedTuple

from pipeline.evaluation.tables import figure_rows
from pipeline.export.report_page import Section, figure_cell, page, table
from pipeline.files import write_text

# Headings, with the figure's name and its digits after the point.
COLUMNS = {
    "poses within 30°": ("pose.test.acc_pi6", 3),
    "poses, fine-tuned": ("pose.test_tuned.acc_pi6", 3),
    "poses, constant": ("pose.constant.acc_pi6", 3),
    "base IoU": ("shape.base.voxel_iou", 3),
    "base IoU after training": ("shape.final_base.voxel_iou", 3),
    "shape IoU": ("shape.test.voxel_iou", 3),
    "shapes differ by": ("vertex_deviation.predicted", 3),
    "mask IoU": ("shape.test.mask_iou", 3),
    "mask IoU, fine-tuned": ("shape.test_tuned.mask_iou", 3),
    "feature distance": ("reconstruction.predicted.feature_distance", 2),
    "distance, fine-tuned": ("reconstruction.tuned.feature_distance", 2),
    "distance, retrieved": ("reconstruction.retrieved.feature_distance", 2),
    "SSIM, fine-tuned": ("reconstruction.tuned.ssim", 3),
}
INTRODUCTION = (
    "Each figure stands over its standard error; a row of several seeds has their mean and standard deviation (SD). A "
    "dash stands where a figure was not measured: poses and shapes need a dataset whose truth is known. Constant is "
    "the one pose that suits the training split best, retrieved the training photograph whose colours are most alike."
)

Cell = Mapping[str, Any]
"""A value with its standard error and n, which some figures lack, or with its deviation over seeds."""


class MeasuredRun(NamedTuple):
    """A run's figures as `evaluate` wrote them, and the address of its page where there is one."""

    name: str
    address: str | None
    figures: Mapping[str, Any]

    @property
    def experiment(self) -> str:
        """What runs share that differ in their seed alone; a base shape that they are trained around keeps its own."""
        own, around, base_shape = self.name.partition("-around-")
        return re.sub(r"-seed\d+(?=(-hologan|-colmap)?$)", "", own) + around + base_shape

    def by_name(self) -> Mapping[str, Cell]:
        """Return the figures by their dotted names."""
        rows = figure_rows(self.figures)
        return {label: {"value": value, "standard_error": error, "n": n} for label, value, error, n in rows}


def write_runs_page(path: Path, runs: Sequence[MeasuredRun]) -> None:
    """Write one table of all runs, atomically: first those whose pages are here; seeds stand together."""
    rows, summaries = [], []
    own = {run.experiment for run in runs if run.address is not None}
    ordered = sorted(runs, key=lambda run: (run.experiment not in own, run.experiment, run.name))
    for experiment, members in groupby(ordered, lambda run: run.experiment):
        names, figures = zip(*((_link(run), _measured(run)) for run in members), strict=True)
        rows += [[name, _count(one), *_cells(one)] for name, one in zip(names, figures, strict=True)]
        if len(figures) > 1:
            summaries.append(f"{escape(experiment)}, {len(figures)} seeds")
            rows.append([summaries[-1], "", *_cells(_over_seeds(figures))])
    body = f'<div class="runs">{table(["run", "n", *COLUMNS], rows, summaries)}</div>'
    text = page(
        "All runs", f"{len(runs)} runs with figures.", [], [Section("runs", "On test pictures", INTRODUCTION, body)]
    )
    write_text(path, text)


def _link(run: MeasuredRun) -> str:
    if run.address is None:
        return escape(run.name)
    return f'<a href="{escape(run.address, quote=True)}">{escape(run.name)}</a>'


def _measured(run: MeasuredRun) -> list[Cell | None]:
    """Look the columns up among a run's figures."""
    found = run.by_name()
    return [found.get(label) for label, _ in COLUMNS.values()]


def _cells(figures: Sequence[Cell | None]) -> list[str]:
    digits = (digits for _, digits in COLUMNS.values())
    return [figure_cell(figure, digits=count) for figure, count in zip(figures, digits, strict=True)]


def _count(figures: Sequence[Cell | None]) -> str:
    """Say how many pictures were measured."""
    return str(next((figure["n"] for figure in figures if figure is not None), "–"))


def _over_seeds(figures: Sequence[Sequence[Cell | None]]) -> list[Cell | None]:
    """Return mean and standard deviation of each column that all seeds have."""
    columns = []
    for column in zip(*figures, strict=True):
        values = [figure["value"] for figure in column if figure is not None]
        spread = {"value": mean(values), "deviation": stdev(values)} if len(values) == len(column) else None
        columns.append(spread)
    return columns
