"""Where trained models, the artifacts of a run, and prepared datasets lie."""

from dataclasses import dataclass
from pathlib import Path

from pipeline.config import entries, load, scalar
from pipeline.datasets.decoding import Fit
from pipeline.errors import ConfigError, DataError
from pipeline.naming import did_you_mean, require_known


@dataclass(frozen=True)
class Run:
    """A run of params.yaml in a project's folder; dvc.yaml writes its artifacts."""

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
        path = self.project / "models" / "full" / f"{self.name}.safetensors"
        return _written(path, f"{_REPRO}, or take one that comes with the code, by --pretrained")

    @property
    def features(self) -> Path:
        """The feature extractor. Raises DataError where it has not been trained."""
        return _written(self.project / "models" / "features" / f"{self.features_name}.safetensors", _REPRO)

    @property
    def page(self) -> Path:
        """The report's page. Raises DataError where it has not been written."""
        return _written(self.project / "results" / "report" / self.name / "index.html", _REPRO)


@dataclass(frozen=True)
class _PretrainedConfig:
    """An entry of `pretrained`."""

    model: str
    """Path of the full model."""
    features: str
    """Path of the feature extractor."""
    size: str
    """The entry of `sizes` whose fine-tuning suits it."""
    fit: Fit
    """How a photograph that is not square becomes so."""


@dataclass(frozen=True)
class Pretrained:
    """A trained model that comes with a project: an entry of `pretrained` in its params.yaml."""

    project: Path
    name: str
    config: _PretrainedConfig

    @property
    def params(self) -> Path:
        """The parameter file."""
        return self.project / "params.yaml"

    @property
    def size(self) -> str:
        """The entry of `sizes` whose fine-tuning suits it."""
        return self.config.size

    @property
    def model(self) -> Path:
        """The trained full model. Raises DataError where it is not there."""
        return self._named(self.config.model)

    @property
    def features(self) -> Path:
        """The feature extractor. Raises DataError where it is not there."""
        return self._named(self.config.features)

    def _named(self, path: str) -> Path:
        return _written(self.project / path, f"`pretrained.{self.name}` in {self.params} names it")


_REPRO = "make it with `make repro`, which brings all runs up to date"


def _written(path: Path, what_to_do: str) -> Path:
    if not path.is_file():
        raise DataError(f"{path} does not exist; {what_to_do}")
    return path


def find_run(project: Path, name: str | None) -> Run:
    """Return a run of the project's params.yaml, the first one where no name is given.

    Raises ConfigError for a name that is not there, with the nearest one that is.
    """
    params = project / "params.yaml"
    runs = entries(params, "runs")
    if not runs:
        raise ConfigError(f"{params} has no runs; add one with `make run ROW=...`")
    name = name if name is not None else next(iter(runs))
    if name not in runs:
        raise ConfigError(f"{params} has no run '{name}'{did_you_mean(name, runs)}; `make run ROW=...` turns one on")
    size, dataset, features = (scalar(params, f"runs.{name}.{key}") for key in ("size", "dataset", "features"))
    return Run(project, name, size, dataset, features)


def find_pretrained(project: Path, name: str) -> Pretrained:
    """Return a trained model that comes with the project.

    Raises ConfigError for a name that is not there, with the nearest one that is.
    """
    params = project / "params.yaml"
    require_known(name, entries(params, "pretrained"), f"{params}: pretrained has no")
    return Pretrained(project, name, load(params, _PretrainedConfig, [f"pretrained.{name}"]))


def truth_folder(project: Path, dataset: str) -> Path:
    """Return the ground truth of a dataset.

    Where it is not there, raises ConfigError for a dataset that is not on, with the nearest one that is, and else
    DataError, as it has not been prepared.
    """
    folder = project / "data" / "truth" / dataset
    if not folder.is_dir():
        params = project / "params.yaml"
        require_known(dataset, entries(params, "datasets"), f"{params}: datasets has no")
        raise DataError(f"{folder} does not exist; make it with `dvc repro prepare_data@{dataset}`")
    return folder


def photographs_file(project: Path, dataset: str, split: str, category: str) -> Path:
    """Return where the pictures of one split of a category are."""
    return project / "data" / "prepared" / dataset / split / f"{category}.npy"
