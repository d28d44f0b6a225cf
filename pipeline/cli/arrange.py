"""Bring a folder of photographs into the form that the pipeline learns from."""

import io
import re
from pathlib import Path
from typing import NamedTuple

from PIL import Image, ImageOps
from tqdm import tqdm

from pipeline.cli.photographs import find_photographs
from pipeline.datasets.decoding import reading
from pipeline.errors import DataError
from pipeline.files import atomic_path

TEST_EVERY = 10
LONGEST = 1024
"""Pixels along the longer side of what is written: far more than any run looks at."""


class Arranged(NamedTuple):
    """How many photographs each split got, and why others were left out, a sentence each."""

    train: int
    test: int
    left_out: list[str]


def arrange(folder: Path, category: str, out: Path, least_side: int) -> Arranged:
    """Write the photographs below a folder as `train/<category>/*.jpg` and, every tenth, `test/<category>/*.jpg`.

    They are turned upright, become RGB, on white where they are transparent, and no side stays longer than 1024 px.
    Those that cannot be read, or whose short side is below `least_side` pixels, are left out. Raises DataError where
    nothing can be written, and where fewer than two photographs are left.
    """
    if not re.fullmatch(r"[\w-]+", category):
        raise DataError(f"the category is '{category}'; expected a name of letters, digits, _ and -")
    if out.exists():
        raise DataError(f"{out} exists; name a folder that does not")
    counts, left_out = {"train": 0, "test": 0}, []
    with atomic_path(out) as temporary:
        for path in tqdm(find_photographs(folder), "arranging", disable=None):
            split = "train" if sum(counts.values()) % TEST_EVERY else "test"
            try:
                picture = _upright(path, least_side)
            except DataError as error:
                left_out.append(str(error))
                continue
            target = temporary / split / category / f"{sum(counts.values()):06}.jpg"
            target.parent.mkdir(parents=True, exist_ok=True)
            picture.save(target, quality=95)
            counts[split] += 1
        if not counts["train"]:
            raise DataError(f"{folder} has {counts['test']} photographs that can be used; expected at least 2")
    return Arranged(counts["train"], counts["test"], left_out)


def _upright(path: Path, least_side: int) -> Image.Image:
    with reading(str(path)):
        picture = ImageOps.exif_transpose(Image.open(io.BytesIO(path.read_bytes())))
        picture.load()
    if min(picture.size) < least_side:
        size = f"{picture.width}x{picture.height}"
        raise DataError(f"{path} is {size} px; expected at least {least_side} px along the short side")
    if picture.has_transparency_data:
        picture = picture.convert("RGBA")
        picture = Image.alpha_composite(Image.new("RGBA", picture.size, "white"), picture)
    picture = picture.convert("RGB")
    picture.thumbnail((LONGEST, LONGEST), Image.Resampling.LANCZOS)
    return picture
