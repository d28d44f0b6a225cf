"""Read a dataset from wherever it comes."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from pipeline.config import entries, load, scalar
from pipeline.datasets.cifar10 import Cifar10Config, read_cifar10
from pipeline.datasets.decoding import Fit
from pipeline.datasets.folder import FolderConfig, read_folder
from pipeline.datasets.pascal3d import Pascal3dConfig, read_pascal3d
from pipeline.datasets.posed_folder import read_angles, require_rows, viewpoints
from pipeline.datasets.prepared import TruthBySplit, write_images, write_pictures
from pipeline.datasets.toybox.toybox import ToyboxConfig, make_toybox
from pipeline.errors import ConfigError
from pipeline.naming import require_known

Pictures = ToyboxConfig | Cifar10Config | FolderConfig | Pascal3dConfig
KINDS: Mapping[str, type[Pictures]] = {
    "toybox": ToyboxConfig,
    "cifar10": Cifar10Config,
    "folder": FolderConfig,
    "posed_folder": FolderConfig,
    "pascal3d": Pascal3dConfig,
}
"""What sources may be, and what says what becomes of their pictures."""


@dataclass(frozen=True)
class PrepareConfig:
    """Say where pictures come from and what becomes of them."""

    kind: str
    """What the source is: pictures that are made, the official archive of CIFAR-10, photographs in a folder or archive,
    the same with viewpoints for evaluation, or the official release of PASCAL3D+."""
    source: Path
    """Path of the folder or archive; for the toybox, of the code that makes it."""
    pictures: Pictures
    """What becomes of them."""

    @property
    def fit(self) -> Fit:
        """How a photograph that is not square becomes so; PASCAL3D+'s boxes are padded."""
        if isinstance(self.pictures, FolderConfig):
            return self.pictures.fit
        return "pad" if self.kind == "pascal3d" else "crop"


def load_prepare(path: Path, name: str) -> PrepareConfig:
    """Read a data set of params.yaml: the settings of its kind, `prepare_data.<kind>`, and those of its own.

    Settings of another kind, which it may have had before, are not read. Raises ConfigError as `load` does.
    """
    key = f"datasets.{name}"
    kind, source = (scalar(path, f"{key}.{part}") for part in ("kind", "source"))
    require_known(str(kind), KINDS, f"{path}: {key}.kind is")
    if not isinstance(source, str):
        raise ConfigError(f"{path}: '{key}.source' must be text, not {source!r}")
    entry = entries(path, "datasets")[name]
    for part in entry:
        require_known(part, ("kind", "source", *KINDS), f"{path}: {key} has no")
    own = [f"{key}.{kind}"] if kind in entry else []
    return PrepareConfig(kind, Path(source), load(path, KINDS[kind], [f"prepare_data.{kind}", *own]))


def prepare(config: PrepareConfig, folder: Path) -> TruthBySplit:
    """Write the whole dataset's pictures to a folder and return its ground truth.

    Pictures of a folder or an archive are decoded and written one at a time. Raises DataError, naming file and remedy,
    for anything that cannot be used; the folder is then incomplete.
    """
    match config.kind, config.pictures:
        case "toybox", ToyboxConfig() as settings:
            images, truth = make_toybox(settings)
            write_images(folder, images)
            return truth
        case "cifar10", Cifar10Config() as settings:
            write_images(folder, read_cifar10(config.source, settings).images)
            return {}
        case "folder", FolderConfig() as settings:
            write_pictures(folder, read_folder(config.source, settings))
            return {}
        case "posed_folder", FolderConfig() as settings:
            angles = read_angles(config.source)
            pictures = require_rows(config.source, angles, read_folder(config.source, settings))
            return viewpoints(angles, write_pictures(folder, pictures))
        case "pascal3d", Pascal3dConfig() as settings:
            images, truth = read_pascal3d(config.source, settings)
            write_images(folder, images)
            return truth
        case kind, _:
            raise AssertionError(kind)
