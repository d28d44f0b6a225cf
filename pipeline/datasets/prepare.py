"""Read a dataset from wherever it comes."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pipeline.datasets.cifar10 import Cifar10Config, read_cifar10
from pipeline.datasets.folder import FolderConfig, read_folder
from pipeline.datasets.posed_folder import read_posed_folder
from pipeline.datasets.prepared import Dataset
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
    """

    kind: Literal["toybox", "cifar10", "folder", "posed_folder"]
    source: str
    toybox: ToyboxConfig
    cifar10: Cifar10Config
    folder: FolderConfig
    posed_folder: FolderConfig


def prepare(config: PrepareConfig) -> Dataset:
    """Read the whole dataset. Raises DataError, naming file and remedy, for anything that cannot be used."""
    match config.kind:
        case "toybox":
            return make_toybox(config.toybox)
        case "cifar10":
            return read_cifar10(Path(config.source), config.cifar10)
        case "folder":
            return read_folder(Path(config.source), config.folder)
        case "posed_folder":
            return read_posed_folder(Path(config.source), config.posed_folder)
