"""Which photographs to reconstruct, and where what comes of them is written."""

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from pipeline.datasets.archives import walk
from pipeline.datasets.folder import ENDINGS, is_hidden
from pipeline.errors import DataError

FILES: Mapping[str, Sequence[str]] = {
    "mesh": (".glb", ".obj", ".mtl", "_texture.png"),
    "picture": ("_photograph.png", "_reconstruction.png"),
    "turntable": ("_turntable.gif",),
    "video": ("_turntable.mp4",),
    "pose": ("_pose.json",),
}
"""Endings of the files of each output."""


class Target(NamedTuple):
    """Where the outputs of a photograph are written: a path without an ending."""

    path: Path

    def file(self, ending: str) -> Path:
        """Return the path of one output."""
        return self.path.with_name(self.path.name + ending)

    def done(self, outputs: Sequence[str]) -> bool:
        """Whether all files of the outputs are there; each is written whole or not at all."""
        return all(self.file(ending).is_file() for output in outputs for ending in FILES[output])


class Task(NamedTuple):
    """A photograph and where its outputs are written."""

    photograph: Path
    target: Target


def find_targets(out: Path, outputs: Sequence[str]) -> list[Target]:
    """List by name what a folder of outputs, as far as it exists, holds all of these outputs of."""
    ending = FILES[outputs[0]][0]
    found = (Target(file.with_name(file.name.removesuffix(ending))) for file in out.rglob(f"*{ending}"))
    return sorted(target for target in found if target.done(outputs))


def find_photographs(folder: Path, without: Path | None = None) -> list[Path]:
    """List the photographs below a folder by name, without hidden ones and those below another folder.

    Raises DataError where there is no folder, where it has none, and for a folder in it that is a link.
    """
    if not folder.is_dir():
        raise DataError(f"{folder} does not exist; give the path of a photograph or of a folder of photographs")
    images = (file for file in visible_files(folder) if file.suffix.lower() in ENDINGS)
    found = sorted(file for file in images if without is None or without not in file.resolve().parents)
    if not found:
        raise DataError(f"{folder} holds no photographs ({' '.join(sorted(ENDINGS))}); give another folder")
    return found


def visible_files(folder: Path) -> Iterator[Path]:
    """Yield the files below a folder that are not hidden. Raises DataError for a folder in it that is a link."""
    return (path for path in walk(folder) if path.is_file() and not is_hidden(path.relative_to(folder)))


def list_tasks(paths: Sequence[Path], out: Path) -> list[Task]:
    """List the photographs among files and, at any depth, folders, whose arrangement the outputs keep.

    Where `out` is a folder inside one of photographs, what lies in it is left out, so that a call can be repeated. A
    photograph that is named twice is listed once.

    Raises DataError for a path that does not exist, a folder without photographs, two photographs of one name, and an
    `out` that is the photographs' own folder, in which nothing would tell them from what is written.
    """
    tasks: dict[Target, Task] = {}
    for task in (task for path in paths for task in _tasks(path, out)):
        photograph, target = task
        other = tasks.setdefault(target, task).photograph
        if other.resolve() != photograph.resolve():
            raise DataError(f"{other} and {photograph} would both be written as {target.file('.glb')}; rename one")
    return list(tasks.values())


def _tasks(path: Path, out: Path) -> Iterator[Task]:
    folder = path.parent if path.is_file() else path
    if out.resolve() == folder.resolve():
        raise DataError(f"{out} is the folder of the photographs; name another for what is written, such as meshes")
    if path.is_file():
        yield Task(path, Target(out / _plain(path.name)))
        return
    inside = path.resolve() in out.resolve().parents
    for file in find_photographs(path, without=out.resolve() if inside else None):
        yield Task(file, Target((out / file.relative_to(path)).with_name(_plain(file.name))))


def _plain(name: str) -> str:
    """Return a file's name without its ending.

    Without spaces too, which readers of OBJ take for the end of a name, and without bytes that are no text in UTF-8.
    """
    return re.sub(r"[\udc80-\udcff]", "_", "_".join(Path(name).stem.split()))
