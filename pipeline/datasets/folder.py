"""Users' own photographs: `train/<category>/*` and `test/<category>/*` in a folder or an archive."""

import sys
from collections import Counter
from collections.abc import Iterator
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
    categories, others = Categories(), _Others()

    def wanted(name: PurePosixPath) -> bool:
        if _place_of(name) is None:
            others.note(name)
            return False
        return True

    with tqdm(desc=f"reading {path.name}", unit="", disable=None) as progress:
        for name, content in read_tree(path, wanted):
            if content is None:
                categories.note_folder(name)
                continue
            pixels = decode(content, f"{path}: {name}", config.size, config.fit)
            categories.note_file(name)
            progress.update()
            yield Picture(name.parts[-3], name.parts[-2], name.name, pixels)
    others.tell(path)
    categories.require_all(path)


class Categories:
    """Categories of a source and their pictures, counted by split, as its files and folders come along."""

    def __init__(self) -> None:
        self._counts: Counter[tuple[str, str]] = Counter()
        """By split and category."""
        self._around: set[tuple[str, str]] = set()
        """Names of folders around the splits, each with that of the folder in it."""

    @property
    def names(self) -> frozenset[str]:
        """Those found so far."""
        return frozenset(category for _, category in self._found())

    def note_folder(self, name: PurePosixPath) -> None:
        """Count a category's folder, so that an empty one is missed."""
        if name.parent.name in SPLITS and name.name not in SPLITS and not is_hidden(name):
            self._counts[name.parent.name, name.name] += 0

    def note_file(self, name: PurePosixPath) -> None:
        """Count a picture; other files are none of a category's."""
        place = _place_of(name)
        if place is not None:
            self._counts[place] += 1
            self._around.update(pairwise(name.parts[:-3]))

    def require_all(self, path: Path) -> None:
        """Raise DataError, naming the source, without categories or for one without pictures in one split."""
        endings = " ".join(sorted(ENDINGS))
        if not self.names:
            raise DataError(
                f"{path} has no pictures at train/<category>/ and test/<category>/; `kato3d arrange` puts them there; "
                f"expected {endings}, or of CIFAR-10 cifar-10-python.tar.gz itself"
            )
        for split in SPLITS:
            for category in sorted(self.names):
                if not self._counts[split, category]:
                    raise DataError(
                        f"{path} has no pictures in {split}/{category}/; expected at least one in each split, with "
                        f"one of {endings}"
                    )

    def _found(self) -> list[tuple[str, str]]:
        """Leave out folders around the splits: where one is called `test`, the next looks like an empty category."""
        return [place for place, count in self._counts.items() if count or place not in self._around]


def _place_of(name: PurePosixPath) -> tuple[str, str] | None:
    """Return split and category of the picture that a path inside the source names; None for any other path."""
    folder = name.parent
    is_picture = name.suffix.lower() in ENDINGS and folder.parent.name in SPLITS and not is_hidden(name)
    return (folder.parent.name, folder.name) if is_picture else None


class _Others:
    """Files that may have been meant as pictures of a category but are none, by their ending or their place."""

    def __init__(self) -> None:
        self.count, self.first = 0, PurePosixPath()

    def note(self, name: PurePosixPath) -> None:
        """Count a file, if it lies in a category's folder or deeper."""
        if name.suffix and any(part in SPLITS for part in name.parts[:-2]) and not is_hidden(name):
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
