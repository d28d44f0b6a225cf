"""What every source of pictures is brought into, and how it is written."""

import io
import math
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from jaxtyping import UInt8

from pipeline.datasets.truth import GroundTruth, Viewpoints
from pipeline.errors import DataError
from pipeline.files import atomic_path, write_json

SPLITS = ("train", "test")

Arrays = Mapping[str, Mapping[str, UInt8[np.ndarray, "_ H W 3"]]]
"""RGB pictures by split and category, all of one square size; both splits have the same categories."""
TruthBySplit = Mapping[str, Mapping[str, GroundTruth | Viewpoints]]
"""Ground truth of those categories that have one, by split."""
Names = Mapping[str, Mapping[str, Sequence[str]]]
"""Names of the pictures in the order they are stored, by split and category."""


class Dataset(NamedTuple):
    """Pictures that fit in memory, and their ground truth."""

    images: Arrays
    truth: TruthBySplit


class Picture(NamedTuple):
    """One picture on its way to a file."""

    split: str
    category: str
    name: str
    pixels: UInt8[np.ndarray, "H W 3"]


def write_images(folder: Path, images: Arrays) -> None:
    """Write `<split>/<category>.npy` and `index.json` (categories, counts, size) of pictures in memory."""
    for split, group in images.items():
        (folder / split).mkdir(parents=True)
        for category, pictures in group.items():
            np.save(folder / split / f"{category}.npy", np.ascontiguousarray(pictures))
    counts = {split: {name: len(pictures) for name, pictures in group.items()} for split, group in images.items()}
    _write_index(folder, counts, next(iter(images["train"].values())).shape[1])


def write_pictures(folder: Path, pictures: Iterable[Picture]) -> Names:
    """Write the files of `write_images` picture by picture, in memory that grows by the names alone.

    Whatever order the pictures come in, they are stored in the order of their names. Raises DataError where a category
    has one name twice.
    """
    names: dict[str, dict[str, list[str]]] = {split: {} for split in SPLITS}
    shape = (0, 0, 0)
    for split, category, name, pixels in pictures:
        shape = pixels.shape
        path = folder / split / f"{category}.npy"
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("ab") as stream:
            if category not in names[split]:
                _write_header(stream, 0, shape)
            stream.write(pixels.tobytes())
        names[split].setdefault(category, []).append(name)
    for split, group in names.items():
        for category in group:
            group[category] = _finish(folder / split / f"{category}.npy", group[category], shape)
    counts = {split: {name: len(ordered) for name, ordered in group.items()} for split, group in names.items()}
    _write_index(folder, counts, shape[0])
    return names


def write_truth(folder: Path, truth: TruthBySplit) -> None:
    """Write `<split>/<category>.npz` and `index.json`, the list of categories whose truth is known, all or nothing."""
    with atomic_path(folder) as temporary:
        temporary.mkdir()
        for split, group in truth.items():
            (temporary / split).mkdir()
            for category, known in group.items():
                _write_arrays(temporary / split / f"{category}.npz", known._asdict())
        write_json(temporary / "index.json", sorted({name for group in truth.values() for name in group}))


def _write_arrays(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write what `np.load` reads; the bytes of `np.savez` depend on the version of Python."""
    with zipfile.ZipFile(path, "w") as archive:
        for name, array in arrays.items():
            content = io.BytesIO()
            np.lib.format.write_array(content, np.asarray(array), allow_pickle=False)
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), content.getbuffer())


def _write_index(folder: Path, counts: Mapping[str, Mapping[str, int]], size: int) -> None:
    write_json(folder / "index.json", {"categories": sorted(counts["train"]), "counts": counts, "size": size})


def _write_header(stream: BinaryIO, count: int, shape: tuple[int, ...]) -> None:
    """Write the header of `np.save`, whose length does not depend on the count: NumPy leaves room for it to grow."""
    layout = {"descr": "|u1", "fortran_order": False, "shape": (count, *shape)}
    np.lib.format.write_array_header_1_0(stream, layout)


def _finish(path: Path, names: list[str], shape: tuple[int, ...]) -> list[str]:
    """Bring the pictures of a file into the order of their names, write their number, and return the names."""
    if any(first >= second for first, second in pairwise(names)):
        order = sorted(range(len(names)), key=names.__getitem__)
        names = [names[row] for row in order]
        twice = next((first for first, second in pairwise(names) if first == second), None)
        if twice is not None:
            where = f"{path.parent.name}/{path.stem}"
            raise DataError(f"there are two pictures {where}/{twice}; rename or remove one of them")
        _reorder(path, order, math.prod(shape))
    with path.open("r+b") as stream:
        _write_header(stream, len(names), shape)
    return names


def _reorder(path: Path, order: Sequence[int], picture_bytes: int) -> None:
    with path.open("rb") as stored, atomic_path(path) as temporary, temporary.open("wb") as stream:
        start = path.stat().st_size - len(order) * picture_bytes
        stream.write(stored.read(start))
        for row in order:
            stored.seek(start + row * picture_bytes)
            stream.write(stored.read(picture_bytes))
