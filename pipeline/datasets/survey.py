"""What a folder or an archive of photographs is, told by names alone."""

from pathlib import Path, PurePosixPath
from typing import Literal, NamedTuple

from tqdm import tqdm

from pipeline.datasets import cifar10, pascal3d, posed_folder
from pipeline.datasets.archives import read_tree
from pipeline.datasets.folder import Categories

OFFICIAL_CIFAR10 = "cifar-10-python.tar.gz"


class Contents(NamedTuple):
    """What a source holds."""

    path: Path
    """Of the source."""
    kind: Literal["cifar10", "folder", "posed_folder", "pascal3d"]
    """How `prepare_data` reads it."""
    categories: frozenset[str]
    """Those that have pictures; empty for PASCAL3D+, of which parameters name those that are read."""


def survey(path: Path) -> Contents:
    """Look at the names of all files and folders once, and read none.

    Raises DataError for a source that is damaged and, unless it is CIFAR-10 or PASCAL3D+, for one without categories or
    with one that has no pictures in one split.
    """
    if path.is_file() and path.name == OFFICIAL_CIFAR10:
        return Contents(path, "cifar10", frozenset(cifar10.CATEGORIES))
    names = {"annotations": False, "batches": False, "table": False}
    categories = Categories()
    with tqdm(desc=f"looking through {path.name}", unit="", delay=1, disable=None) as progress:

        def note(name: PurePosixPath) -> bool:
            names["annotations"] |= name.match(pascal3d.ANNOTATIONS)
            names["batches"] |= name.match(cifar10.BATCHES)
            names["table"] |= posed_folder.is_table(name)
            categories.note_file(name)
            progress.update()
            return False

        for folder, _ in read_tree(path, wanted=note):
            categories.note_folder(folder)
    if names["annotations"]:
        return Contents(path, "pascal3d", frozenset())
    if names["batches"] and path.is_file():
        return Contents(path, "cifar10", frozenset(cifar10.CATEGORIES))
    categories.require_all(path)
    return Contents(path, "posed_folder" if names["table"] else "folder", categories.names)
