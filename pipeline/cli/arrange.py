"""Bring a folder of photographs into the form that the pipeline learns from."""

import csv
import os
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from PIL import Image
from tqdm import tqdm

from pipeline.cli.conversion import open_rgb
from pipeline.cli.photographs import find_photographs, passed_over
from pipeline.datasets.decoding import reading
from pipeline.errors import DataError
from pipeline.files import alone, atomic_path, sha256
from pipeline.naming import is_plain

TEST_EVERY = 10
FEW = 200
"""Training photographs of which fewer have not been tried."""
LONGEST = 1024
"""Pixels along the longer side of what is written: far more than any run looks at."""
LIMIT = 65500
"""Pixels along a side that JPEG holds, as it is commonly written."""
ORIGINALS = "originals.csv"
"""Says of each picture, beside `train` and `test`, which photograph below the folder it is a copy of."""


class Arranged(NamedTuple):
    """How many photographs each split got."""

    train: int
    test: int
    left_out: list[str]
    """Why others got none, a sentence each."""
    passed_over: Mapping[str, int]
    """How many files there are of each ending that are no photographs."""


def arrange(folder: Path, category: str, out: Path, least_side: int) -> Arranged:
    """Write the photographs below a folder as `train/<category>/*.jpg` and, every tenth, `test/<category>/*.jpg`.

    They are turned upright, become RGB in the colours of sRGB, on white where they are transparent, and are made
    smaller until their long side is 1024 px or their short side `least_side`. Those that cannot be read, whose short
    side is below `least_side`, that would still be longer than a JPEG can be, or that are copies of others, which could
    be in both splits, are left out. `originals.csv` says which photograph each picture is made of. Raises DataError for
    an `out` that exists, is inside of the folder or is just being written by another process, for a folder in it that
    is a link, and where fewer than two photographs are left.
    """
    if not is_plain(category):
        raise DataError(f"the category is '{category}'; expected a name of letters, digits, _ and - (a to z)")
    if not folder.is_dir():
        raise DataError(f"{folder} is no folder; give one of photographs of one category")
    if folder.resolve() in out.resolve().parents:
        raise DataError(f"{out} is inside of {folder}; name a folder outside of it")
    _require_absent(out)
    found, originals, left_out = find_photographs(folder), {}, []
    same: dict[str, Path] = {}
    with alone(out), atomic_path(out) as temporary:
        for path in tqdm(found, "arranging", disable=None):
            split = "train" if len(originals) % TEST_EVERY else "test"
            try:
                picture = _open(path, least_side)
                with reading(str(path)):
                    other = same.setdefault(sha256(path), path)
                if other != path:
                    raise DataError(f"{path} is the same file as {other}")
            except DataError as error:
                left_out.append(str(error))
                continue
            name = f"{split}/{category}/{len(originals):06}.jpg"
            (temporary / name).parent.mkdir(parents=True, exist_ok=True)
            picture.save(temporary / name, quality=95, comment=b"")  # a longer one than a JPEG can hold is an error
            originals[name] = path.relative_to(folder).as_posix()
        if len(originals) < 2:
            first = f" ({left_out[0]})" if left_out else ""
            raise DataError(f"{folder}: {len(originals)} of the photographs can be used{first}; expected at least 2")
        _write_originals(temporary / ORIGINALS, originals)
        _require_absent(out)
    test = sum(name.startswith("test/") for name in originals)
    return Arranged(len(originals) - test, test, left_out, passed_over(folder, found))


def _require_absent(out: Path) -> None:
    if os.path.lexists(out):
        raise DataError(f"{out} exists; name a folder that does not")


def _write_originals(path: Path, originals: Mapping[str, str]) -> None:
    # Names of files may hold bytes that are no text.
    with path.open("w", encoding="utf-8", errors="backslashreplace", newline="") as stream:
        csv.writer(stream, lineterminator="\n").writerows([("picture", "original"), *originals.items()])


def _open(path: Path, least_side: int) -> Image.Image:
    with reading(str(path)):
        content = path.read_bytes()
    picture = open_rgb(content, str(path))
    if min(picture.size) < least_side:
        size = f"{picture.width}x{picture.height}"
        raise DataError(f"{path} is {size} px; expected at least {least_side} px along the short side")
    picture = _smaller(picture, least_side)
    if max(picture.size) > LIMIT:
        raise DataError(f"{path} would be written {picture.width}x{picture.height} px; expected at most {LIMIT} px")
    return picture


def _smaller(picture: Image.Image, least_side: int) -> Image.Image:
    factor = max(LONGEST / max(picture.size), least_side / min(picture.size))
    if factor >= 1:
        return picture
    width, height = (round(side * factor) for side in picture.size)
    return picture.resize((width, height), Image.Resampling.LANCZOS)
