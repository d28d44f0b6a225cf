"""The figures of all runs that were evaluated, whatever else became of them."""

from pathlib import Path

from pipeline.errors import DataError
from pipeline.export.runs_page import MeasuredRun
from pipeline.files import read_json


def measured_runs(project: Path) -> list[MeasuredRun]:
    """Return the figures of every run that was evaluated in a project's folder, whether params.yaml names it or not.

    Raises DataError where there is none, and for a file that is damaged.
    """
    metrics, pages = project / "results" / "metrics", runs_page(project).parent
    runs = []
    for path in sorted(metrics.glob("*.json")):
        figures, address = read_json(path), f"{path.stem}/index.html"
        if not isinstance(figures, dict):
            raise DataError(f"{path} is damaged: it holds no figures by name; remove it, and run again what writes it")
        if "reconstruction" in figures:  # else a baseline's
            runs.append(MeasuredRun(path.stem, address if (pages / address).is_file() else None, figures))
    if not runs:
        raise DataError(f"{metrics} has no figures of a run; make them with `make repro`, or name a --project")
    return runs


def runs_page(project: Path) -> Path:
    """Return where the page of all runs is written: beside the folders of the runs' pages, outside the graph."""
    return project / "results" / "report" / "index.html"
