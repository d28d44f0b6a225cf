"""Which photographs to reconstruct, and where what comes of them is written."""

import itertools
import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from pipeline.datasets.archives import is_hidden, walk
from pipeline.datasets.folder import ENDINGS
from pipeline.errors import DataError
from pipeline.files import sha256, write_text

FILES: Mapping[str, Sequence[str]] = {
    "mesh": (".glb", ".obj", ".mtl", "_texture.png"),
    "picture": ("_photograph.png", "_reconstruction.png"),
    "turntable": ("_turntable.gif",),
    "video": ("_turntable.mp4",),
    "pose": ("_pose.json",),
}
"""Endings of the files of each output."""
RECORD = "reconstruct.json"
"""Says in a folder of outputs which model made them, and how."""
ORIGIN = "_photograph.sha256"
"""Ending of the file that says which photograph outputs are made of."""
_PICTURES = tuple(ending for endings in FILES.values() for ending in endings if Path(ending).suffix in ENDINGS)
"""Endings of what is made of a photograph and could be taken for one."""


class Target(NamedTuple):
    """Where the outputs of a photograph are written: a path without an ending."""

    path: Path

    def file(self, ending: str) -> Path:
        """Return the path of one output."""
        return self.path.with_name(self.path.name + ending)

    def done(self, outputs: Sequence[str]) -> bool:
        """Tell whether all files of the outputs are there; each is written whole or not at all, but may be emptied."""
        return all(_holds_something(self.file(ending)) for output in outputs for ending in FILES[output])


class Task(NamedTuple):
    """A photograph and where its outputs are written."""

    photograph: Path
    target: Target

    def done(self, outputs: Sequence[str]) -> bool:
        """Tell whether the outputs are there. Raises DataError where some of them are of another photograph."""
        origin = self.target.file(ORIGIN)
        if not os.path.isfile(origin):  # noqa: PTH113 - Path's refuses names that are too long, as writing will
            return False
        if _read_origin(origin) != sha256(self.photograph):
            raise DataError(
                f"{self.target.path} is made of another photograph than {self.photograph} is now; name another folder, "
                f"or remove {origin.name} there to write over it"
            )
        return self.target.done(outputs)

    def claim(self, content_hash: str) -> None:
        """Say at the target of which photograph it is made from now on; what is there of another one is removed."""
        origin = self.target.file(ORIGIN)
        if not origin.is_file() or _read_origin(origin) != content_hash:
            for ending in itertools.chain(*FILES.values()):
                self.target.file(ending).unlink(missing_ok=True)
        write_text(origin, content_hash)


def _holds_something(file: Path) -> bool:
    return file.is_file() and file.stat().st_size > 0


def _read_origin(origin: Path) -> str:
    return origin.read_text(encoding="utf-8", errors="replace")  # a damaged one is of another photograph


def find_targets(out: Path, outputs: Sequence[str]) -> list[Target]:
    """List by name what a folder of outputs, as far as it exists, holds all of these outputs of."""
    ending = FILES[outputs[0]][0]
    found = (Target(file.with_name(file.name.removesuffix(ending))) for file in out.rglob(f"*{ending}"))
    return sorted(target for target in found if target.done(outputs))


def find_photographs(folder: Path) -> list[Path]:
    """List the photographs below a folder by name, without hidden ones and the pictures that were made of photographs.

    A link to nothing is listed, so that reading it is an error that is told. Raises DataError where there is no folder,
    where it has none, and for a folder in it that is a link.
    """
    if not folder.is_dir():
        what = "is neither a file nor a folder" if folder.exists() else "does not exist"
        raise DataError(f"{folder} {what}; give the path of a photograph or of a folder of photographs")
    files = list(visible_files(folder))
    made = {file.parent for file in files if file.name == RECORD}
    found = sorted(
        file
        for file in files
        if file.suffix.lower() in ENDINGS and (made.isdisjoint(file.parents) or not file.name.endswith(_PICTURES))
    )
    if not found:
        raise DataError(f"{folder} holds no photographs ({' '.join(sorted(ENDINGS))}); give another folder")
    return found


def visible_files(folder: Path) -> Iterator[Path]:
    """Yield the files and links to nothing below a folder that are not hidden.

    Raises DataError for a folder in it that is a link.
    """
    files = (path for path in walk(folder) if path.is_file() or not path.exists())
    return (file for file in files if not is_hidden(file.relative_to(folder)))


def passed_over(folder: Path, used: Iterable[Path]) -> Counter[str]:
    """Count by ending the files below a folder that are not hidden and none of those used."""
    return Counter(path.suffix.lower() for path in set(visible_files(folder)).difference(used))


def list_tasks(paths: Sequence[Path], out: Path) -> list[Task]:
    """List the photographs among files and, at any depth, folders, whose arrangement the outputs keep.

    Earlier outputs inside of a folder of photographs are left out. A photograph that is named twice is listed once.

    Raises DataError for a path that does not exist, a folder without photographs, and an `out` that is a file, the
    photographs' own folder or one above it, which may be read as one of photographs later, or inside or around another
    folder of outputs, which may be made in another way.
    """
    if out.is_file():
        raise DataError(f"{out} is a file; name a folder")
    records = [folder / RECORD for folder in out.resolve().parents] + list(out.glob(f"*/**/{RECORD}"))
    for record in filter(Path.is_file, records):
        raise DataError(f"{record.parent} is another folder of outputs, and {out} is inside or around it; name another")
    tasks: dict[tuple[str, Target], Task] = {}
    for task in (task for path in paths for task in _tasks(path, out)):
        tasks.setdefault((os.path.realpath(task.photograph), task.target), task)
    return list(tasks.values())


def _tasks(path: Path, out: Path) -> Iterator[Task]:
    folder = path.parent if path.is_file() else path
    if out.resolve() in (folder.resolve(), *folder.resolve().parents):
        raise DataError(
            f"{out} is the folder of the photographs or one above it; name another for what is written, such as meshes"
        )
    if path.is_file():
        yield Task(path, Target(out / _plain(path.name)))
        return
    for file in find_photographs(path):
        yield Task(file, Target((out / file.relative_to(path)).with_name(_plain(file.name))))


def _plain(name: str) -> str:
    """Return a file's name without its ending.

    Without spaces too, which readers of OBJ take for the end of a name, without backslashes, which some take for a
    folder's, without bytes that are no text in UTF-8, and not of dots alone, which name folders.
    """
    stem = re.sub(r"[\\\udc80-\udcff]", "_", "_".join(Path(name).stem.split()))
    return stem if stem.strip(".") else f"{stem}_"
