"""Users' own photographs: `train/<category>/*` and `test/<category>/*` in a folder or an archive."""

from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np
from jaxtyping import UInt8
from tqdm import tqdm

from pipeline.datasets.archives import read_tree
from pipeline.datasets.decoding import Fit, decode
from pipeline.datasets.prepared import SPLITS, Dataset
from pipeline.errors import DataError

ENDINGS = {".jpg", ".jpeg", ".png", ".bmp", ".webp", ".tif", ".tiff"}

Pictures = dict[str, UInt8[np.ndarray, "H W 3"]]
"""Pictures by file name."""


@dataclass(frozen=True)
class FolderConfig:
    """What becomes of the pictures.

    Attributes:
        size: pixels a side.
        fit: how a picture becomes square: `crop` fits its short side, `pad` its long side.
    """

    size: int
    fit: Fit


def read_folder(path: Path, config: FolderConfig) -> Dataset:
    """Read all pictures at `[anything/]<split>/<category>/<name>`; other files are left out.

    Raises DataError for a source or picture that cannot be used, and for a category without pictures in one split.
    """
    return Dataset(stack(read_pictures(path, config)), truth={})


def read_pictures(path: Path, config: FolderConfig) -> dict[str, dict[str, Pictures]]:
    """Read all pictures by split, category and name; errors as in `read_folder`."""
    found: dict[str, dict[str, Pictures]] = {split: {} for split in SPLITS}
    for name, content in tqdm(read_tree(path), desc=f"reading {path.name}", disable=None):
        parts = name.parts if content is None else name.parts[:-1]
        if len(parts) < 2 or parts[-2] not in found or _hidden(name):
            continue
        pictures = found[parts[-2]].setdefault(parts[-1], {})
        if content is not None and name.suffix.lower() in ENDINGS:
            pictures[name.name] = decode(content, f"{path}: {name}", config.size, config.fit)
    _require_all(path, found)
    return found


def stack(pictures: dict[str, dict[str, Pictures]]) -> dict[str, dict[str, UInt8[np.ndarray, "_ H W 3"]]]:
    """Stack the pictures of each split and category in the order of their names."""
    return {
        split: {category: np.stack([named[name] for name in sorted(named)]) for category, named in group.items()}
        for split, group in pictures.items()
    }


def _hidden(name: PurePosixPath) -> bool:
    return any(part.startswith((".", "__MACOSX")) for part in name.parts)


def _require_all(path: Path, found: dict[str, dict[str, Pictures]]) -> None:
    categories = sorted({category for group in found.values() for category in group})
    if not categories:
        raise DataError(f"{path} has no pictures at train/<category>/ and test/<category>/; arrange them so")
    for split in SPLITS:
        for category in categories:
            if not found[split].get(category):
                raise DataError(f"{path} has no pictures in {split}/{category}/; expected at least one in each split")
