"""Users' own photographs: `train/<category>/*` and `test/<category>/*` in a folder or an archive."""

import sys
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path, PurePosixPath

from tqdm import tqdm

from pipeline.datasets.archives import is_hidden, read_tree
from pipeline.datasets.decoding import Fit, decode
from pipeline.datasets.prepared import SPLITS, Picture
from pipeline.errors import DataError
from pipeline.ranges import Count

ENDINGS = {".jpg", ".jpeg", ".png", ".bmp", ".webp", ".tif", ".tiff", ".heic", ".heif"}


@dataclass(frozen=True)
class FolderConfig:
    """What becomes of the pictures."""

    size: Count
    """Pixels a side."""
    fit: Fit
    """How a picture becomes square: `crop` fits its short side, `pad` its long side."""


def read_folder(path: Path, config: FolderConfig) -> Iterator[Picture]:
    """Read all pictures at `[anything/]<split>/<category>/<name>`, one at a time; say what is left out.

    Raises DataError for a source or picture that cannot be used and, at the end, for a category without pictures in one
    split.
    """
    counts: Counter[tuple[str, str]] = Counter()
    around: set[tuple[str, str]] = set()
    others = _Others()
    with tqdm(desc=f"reading {path.name}", unit="", disable=None) as progress:
        for name, content in read_tree(path, others.wanted):
            parts = name.parts if content is None else name.parts[:-1]
            if is_hidden(name):
                continue
            is_picture = name.suffix.lower() in ENDINGS
            if len(parts) < 2 or parts[-2] not in SPLITS or (content is not None and not is_picture):
                others.note(name)
                continue
            split, category = parts[-2:]
            if content is None and category in SPLITS:
                continue  # the whole source may lie in a folder `test`
            counts[split, category] += 0
            around.update(pairwise(parts[:-2]))
            if content is not None:
                pixels = decode(content, f"{path}: {name}", config.size, config.fit)
                counts[split, category] += 1
                progress.update()
                yield Picture(split, category, name.name, pixels)
    others.tell(path)
    require_all(path, {place: count for place, count in counts.items() if count or place not in around})


def place_of(name: PurePosixPath) -> tuple[str, str] | None:
    """Return split and category of the picture that a path inside the source names; None for any other path."""
    folder = name.parent
    is_picture = name.suffix.lower() in ENDINGS and folder.parent.name in SPLITS and not is_hidden(name)
    return (folder.parent.name, folder.name) if is_picture else None


class _Others:
    """Files that may have been meant as pictures of a category but are none, by their ending or their place."""

    def __init__(self) -> None:
        self.count, self.first = 0, PurePosixPath()

    def wanted(self, name: PurePosixPath) -> bool:
        """Tell whether a file is a picture, or a folder may be a category's: an empty one is to be noticed."""
        if name.suffix.lower() in ENDINGS or (len(name.parts) > 1 and name.parts[-2] in SPLITS):
            return True
        if name.suffix and not is_hidden(name):
            self.note(name)
        return False

    def note(self, name: PurePosixPath) -> None:
        """Count a file, if it lies in a category's folder or deeper."""
        if name.suffix and any(part in SPLITS for part in name.parts[:-2]):
            self.first = self.first if self.count else name
            self.count += 1

    def tell(self, path: Path) -> None:
        """Say on the terminal what was left out."""
        if self.count:
            tqdm.write(
                f"{path}: left out {self.count} files, such as {self.first}; pictures are read at "
                f"train/<category>/<name> and test/<category>/<name>, with one of {' '.join(sorted(ENDINGS))}",
                file=sys.stderr,
            )


def require_all(path: Path, counts: Mapping[tuple[str, str], int]) -> None:
    """Raise DataError, by counts of (split, category), without categories or for one without pictures in one split."""
    categories = sorted({category for _, category in counts})
    if not categories:
        raise DataError(
            f"{path} has no pictures at train/<category>/ and test/<category>/; `kato3d arrange` puts them there; "
            f"expected {' '.join(sorted(ENDINGS))}, or of CIFAR-10 cifar-10-python.tar.gz itself"
        )
    for split in SPLITS:
        for category in categories:
            if not counts.get((split, category)):
                raise DataError(f"{path} has no pictures in {split}/{category}/; expected at least one in each split")
