"""Read a dataset from wherever it comes."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pipeline.datasets.cifar10 import Cifar10Config, read_cifar10
from pipeline.datasets.decoding import Fit
from pipeline.datasets.folder import FolderConfig, read_folder
from pipeline.datasets.pascal3d import Pascal3dConfig, read_pascal3d
from pipeline.datasets.posed_folder import read_viewpoints
from pipeline.datasets.prepared import Truth, write_images, write_pictures
from pipeline.datasets.toybox.toybox import ToyboxConfig, make_toybox


@dataclass(frozen=True)
class PrepareConfig:
    """Say where pictures come from and what becomes of them.

    Attributes:
        kind: what the source is; the section of the same name says what becomes of it.
        source: path of the folder or archive; for the toybox, of the code that makes it.
        toybox: pictures that are made.
        cifar10: the official archive.
        folder: photographs in a folder or archive.
        posed_folder: the same, cut to objects whose viewpoints are known, for evaluation.
        pascal3d: the official release of PASCAL3D+.
    """

    kind: Literal["toybox", "cifar10", "folder", "posed_folder", "pascal3d"]
    source: str
    toybox: ToyboxConfig
    cifar10: Cifar10Config
    folder: FolderConfig
    posed_folder: FolderConfig
    pascal3d: Pascal3dConfig

    @property
    def fit(self) -> Fit:
        """How a photograph that is not square becomes so; PASCAL3D+'s boxes are padded."""
        if self.kind == "pascal3d":
            return "pad"
        return self.posed_folder.fit if self.kind == "posed_folder" else self.folder.fit


def prepare(config: PrepareConfig, folder: Path) -> Truth:
    """Write the whole dataset's pictures to a folder and return its ground truth.

    Pictures of a folder or an archive are decoded and written one at a time. Raises DataError, naming file and remedy,
    for anything that cannot be used; the folder is then incomplete.
    """
    source = Path(config.source)
    match config.kind:
        case "toybox":
            images, truth = make_toybox(config.toybox)
            write_images(folder, images)
            return truth
        case "cifar10":
            write_images(folder, read_cifar10(source, config.cifar10).images)
            return {}
        case "folder":
            write_pictures(folder, read_folder(source, config.folder))
            return {}
        case "posed_folder":
            names = write_pictures(folder, read_folder(source, config.posed_folder))
            return read_viewpoints(source, names)
        case "pascal3d":
            images, truth = read_pascal3d(source, config.pascal3d)
            write_images(folder, images)
            return truth
