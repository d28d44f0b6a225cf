"""Where trained models, the artifacts of a run, and prepared datasets lie."""

from dataclasses import dataclass
from pathlib import Path

from pipeline.config import entries, load, scalar
from pipeline.datasets.decoding import Fit
from pipeline.errors import ConfigError, DataError
from pipeline.naming import did_you_mean, require_known

_REPRO = "make it with `make repro`, which brings all runs up to date"


def _existing(path: Path, what_to_do: str) -> Path:
    if not path.is_file():
        raise DataError(f"{path} {'is no file' if path.exists() else 'does not exist'}; {what_to_do}")
    return path


@dataclass(frozen=True)
class Trained:
    """A trained model that params.yaml in a project's folder names."""

    project: Path
    name: str
    size: str
    """The entry of `sizes` whose fine-tuning suits it."""

    @property
    def params(self) -> Path:
        """The parameter file."""
        return self.project / "params.yaml"

    @property
    def title(self) -> str:
        """What messages and pages call it."""
        return f"the model of '{self.name}'"


@dataclass(frozen=True)
class Run(Trained):
    """An entry of `runs`; dvc.yaml writes its artifacts."""

    dataset: str
    features_name: str

    @property
    def model(self) -> Path:
        """The trained full model. Raises DataError where it has not been trained."""
        path = self.project / "models" / "full" / f"{self.name}.safetensors"
        return _existing(path, f"{_REPRO}, or take one that comes with the code, by --pretrained")

    @property
    def features(self) -> Path:
        """The feature extractor. Raises DataError where it has not been trained."""
        return _existing(self.project / "models" / "features" / f"{self.features_name}.safetensors", _REPRO)

    @property
    def page(self) -> Path:
        """The report's page. Raises DataError where it has not been written."""
        return _existing(self.project / "results" / "report" / self.name / "index.html", _REPRO)


@dataclass(frozen=True)
class _PretrainedConfig:
    model: str
    features: str
    size: str
    fit: Fit


@dataclass(frozen=True)
class Pretrained(Trained):
    """An entry of `pretrained`: files that come with the code, or are kept by a user."""

    fit: Fit
    """How a photograph that is not square becomes so."""
    model_name: str
    """Path within the project, as that of the features."""
    features_name: str

    @property
    def title(self) -> str:
        """What messages and pages call it."""
        return f"the pretrained model '{self.name}'"

    @property
    def model(self) -> Path:
        """The trained full model. Raises DataError where it is not there."""
        return self._named("model", self.model_name)

    @property
    def features(self) -> Path:
        """The feature extractor. Raises DataError where it is not there."""
        return self._named("features", self.features_name)

    def _named(self, key: str, name: str) -> Path:
        what_to_do = f"restore it with `git restore`, or correct `pretrained.{self.name}.{key}` in {self.params}"
        return _existing(self.project / name, what_to_do)


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
    """Return a trained model that is kept as a file.

    Raises ConfigError for a name, and for a size of it, that is not there, with the nearest one that is.
    """
    params = project / "params.yaml"
    require_known(name, entries(params, "pretrained"), f"{params}: pretrained has no")
    config = load(params, _PretrainedConfig, [f"pretrained.{name}"])
    require_known(config.size, entries(params, "sizes"), f"{params}: 'pretrained.{name}.size' names no entry of sizes:")
    return Pretrained(project, name, config.size, config.fit, config.model, config.features)


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
