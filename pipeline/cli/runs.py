"""Where the artifacts of a run lie; dvc.yaml writes them there."""

from dataclasses import dataclass
from pathlib import Path

from pipeline.config import nearest, scalar
from pipeline.errors import ConfigError, DataError
from pipeline.export.runs_page import MeasuredRun
from pipeline.files import read_json


@dataclass(frozen=True)
class Run:
    """A run of params.yaml in a project's folder."""

    project: Path
    name: str
    size: str
    dataset: str
    features_name: str

    @property
    def params(self) -> Path:
        """The parameter file."""
        return self.project / "params.yaml"

    @property
    def model(self) -> Path:
        """The trained full model. Raises DataError where it has not been trained."""
        return self._written(self.project / "models" / "full" / f"{self.name}.safetensors", "train_full")

    @property
    def features(self) -> Path:
        """The feature extractor. Raises DataError where it has not been trained."""
        path = self.project / "models" / "features" / f"{self.features_name}.safetensors"
        return self._written(path, "train_full")

    @property
    def page(self) -> Path:
        """The report's page. Raises DataError where it has not been written."""
        return self._written(self.project / "results" / "report" / self.name / "index.html", "report")

    def _written(self, path: Path, stage: str) -> Path:
        if not path.is_file():
            raise DataError(f"{path} does not exist; make it with `dvc repro {stage}@{self.name}`")
        return path


def find_run(project: Path, name: str | None) -> Run:
    """Return a run of the project's params.yaml, the first one where no name is given.

    Raises ConfigError for a name that is not there, with the nearest one that is.
    """
    params = project / "params.yaml"
    runs = scalar(params, "runs")
    if not runs:
        raise ConfigError(f"{params} has no runs; add one with `make run ROW=...`")
    name = name if name is not None else next(iter(runs))
    if name not in runs:
        raise ConfigError(f"{params} has no run '{name}'{nearest(name, runs)}; `make run ROW=...` turns one on")
    return Run(project, name, runs[name]["size"], runs[name]["dataset"], runs[name]["features"])


def measured_runs(project: Path) -> list[MeasuredRun]:
    """Return the figures of every run that was evaluated in a project's folder, whether params.yaml names it or not.

    Raises DataError where there is none.
    """
    metrics, pages = project / "results" / "metrics", runs_page(project).parent
    runs = []
    for path in sorted(metrics.glob("*.json")):
        figures, address = read_json(path), f"{path.stem}/index.html"
        if "reconstruction" in figures:  # else a baseline's
            runs.append(MeasuredRun(path.stem, address if (pages / address).is_file() else None, figures))
    if not runs:
        raise DataError(f"{metrics} has no figures of a run; make them with `make repro`, or name a --project")
    return runs


def runs_page(project: Path) -> Path:
    """Where the page of all runs is written: beside the folders of the runs' pages, outside the graph."""
    return project / "results" / "report" / "index.html"
