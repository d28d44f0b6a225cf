"""CIFAR-10 from its official Python archive (Krizhevsky 2009)."""

import hashlib
import io
import pickle  # noqa: TID251 - the archive's own format, read by a class that admits plain data alone
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from jaxtyping import UInt8
from numpy._core.multiarray import _reconstruct  # pyright: ignore[reportAttributeAccessIssue]

from pipeline.datasets.archives import read_files
from pipeline.datasets.prepared import Dataset
from pipeline.errors import DataError

TRAIN_FILES = tuple(f"data_batch_{number}" for number in range(1, 6))
TEST_FILE = "test_batch"
NAMES_FILE = "batches.meta"
BATCHES = f"cifar-10-batches-py/{TEST_FILE}"
"""What tells the archive where it has another name."""
CATEGORIES = ("airplane", "automobile", "bird", "cat", "deer", "dog", "frog", "horse", "ship", "truck")


@dataclass(frozen=True)
class Cifar10Config:
    """What archive is expected."""

    md5: str
    """Of the archive, as its authors publish it."""


class PlainUnpickler(pickle.Unpickler):
    """Build numbers, texts, bytes, lists, dictionaries and numeric NumPy arrays, and nothing else."""

    ADMITTED: ClassVar = {
        ("numpy.core.multiarray", "_reconstruct"): _reconstruct,
        ("numpy", "ndarray"): np.ndarray,
        ("numpy", "dtype"): np.dtype,
    }

    def find_class(self, module_name: str, global_name: str, /) -> Any:
        """Look a name up among the admitted ones; raises UnpicklingError for any other, which could run code."""
        if (module_name, global_name) not in self.ADMITTED:
            raise pickle.UnpicklingError(f"it names {module_name}.{global_name}")
        return self.ADMITTED[module_name, global_name]


def read_cifar10(path: Path, config: Cifar10Config) -> Dataset:
    """Read the ten categories. Raises DataError unless the archive is the official one, whole."""
    _check(path, config.md5)
    wanted = {*TRAIN_FILES, TEST_FILE, NAMES_FILE}
    entries = {name.name: content for name, content in read_files(path, lambda name: name.name in wanted)}
    missing = wanted - entries.keys()
    if missing:
        raise DataError(f"{path} has no {', '.join(sorted(missing))}; expected the Python version of CIFAR-10")
    batches = {name: load_plain(entries[name], f"{path}: {name}") for name in sorted(wanted)}
    names = [name.decode() for name in batches[NAMES_FILE][b"label_names"]]
    return Dataset(
        {
            "train": _by_category([batches[name] for name in TRAIN_FILES], names, path),
            "test": _by_category([batches[TEST_FILE]], names, path),
        },
        truth={},
    )


def load_plain(content: bytes, name: str) -> dict[bytes, Any]:
    """Read a pickled dictionary of plain data. Raises DataError, naming the file, if it holds anything else."""
    try:
        loaded = PlainUnpickler(io.BytesIO(content), encoding="bytes").load()
    except (pickle.UnpicklingError, EOFError, ValueError, TypeError, AttributeError, IndexError, KeyError) as error:
        raise DataError(f"{name} is not a pickle of plain arrays ({error}); expected a batch of CIFAR-10") from None
    if not isinstance(loaded, dict):
        raise DataError(f"{name} holds a {type(loaded).__name__}; expected the dictionary of a CIFAR-10 batch")
    return loaded


def _check(path: Path, md5: str) -> None:
    if not path.is_file():
        raise DataError(f"{path} does not exist; fetch it with `dvc update {path}.dvc`")
    with path.open("rb") as stream:
        found = hashlib.file_digest(stream, "md5").hexdigest()
    if found != md5:
        raise DataError(f"{path} has the md5 checksum {found}; expected {md5}; remove it and fetch it again")


def _by_category(
    batches: list[dict[bytes, Any]], names: list[str], path: Path
) -> dict[str, UInt8[np.ndarray, "_ 32 32 3"]]:
    rows = np.concatenate([batch[b"data"] for batch in batches])
    labels = np.concatenate([batch[b"labels"] for batch in batches])
    if rows.dtype != np.uint8 or rows.shape != (len(labels), 3 * 32 * 32):
        found = f"{rows.shape[1:]}, {rows.dtype}"
        raise DataError(f"{path} holds rows of shape {found}; expected (3072,), uint8: 32x32 px in RGB")
    images = rows.reshape(-1, 3, 32, 32).transpose(0, 2, 3, 1)
    return {name: images[labels == label] for label, name in enumerate(names)}
