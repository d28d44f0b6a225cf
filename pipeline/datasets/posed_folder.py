"""Photographs cut to objects whose viewpoints are known: a folder or archive of pictures with a table `poses.csv`."""

import csv
import io
import math
import unicodedata
from collections.abc import Iterable, Iterator
from pathlib import Path, PurePosixPath

from pipeline.datasets.archives import is_hidden, read_files
from pipeline.datasets.prepared import Names, Picture, TruthBySplit
from pipeline.datasets.truth import viewpoints_of_boxes
from pipeline.errors import DataError

TABLE = "poses.csv"
FILE, ROLL = "file", "roll_deg"
ANGLES = {"azimuth_deg": 360, "elevation_deg": 90, ROLL: 360}
"""Columns of the table and how far from 0 they may be, in degrees and in the conventions of `geometry.camera.Pose`.

Rolls are read as those from -180 to 180, so that 359 and 1 are neighbours where a median is taken."""

Angles = dict[str, tuple[float, ...]]
"""Azimuth, elevation and roll in radians, by a picture's path below the table's folder."""


def read_angles(path: Path) -> Angles:
    """Read the viewpoints of pictures from `poses.csv` above `train` and `test`.

    Raises DataError for a table that is missing or cannot be read, for two tables, and for a picture with two rows.
    """
    tables = dict(read_files(path, is_table))
    if not tables:
        raise DataError(f"{path} has no {TABLE}; expected one with the columns {', '.join((FILE, *ANGLES))}")
    if len(tables) > 1:
        raise DataError(f"{path} has the tables {' and '.join(map(str, tables))}; keep the one that is right")
    ((name, content),) = tables.items()
    return _parse(f"{path}: {name}", _text(f"{path}: {name}", content))


def require_rows(path: Path, angles: Angles, pictures: Iterable[Picture]) -> Iterator[Picture]:
    """Pass pictures of a source on. Raises DataError for one whose viewpoint is not known, as soon as it is met."""
    for picture in pictures:
        if (name := _place(picture.split, picture.category, picture.name)) not in angles:
            raise DataError(f"{path}: {TABLE} has no row for {name}; every picture needs one")
        yield picture


def viewpoints(angles: Angles, names: Names) -> TruthBySplit:
    """Return the viewpoints of pictures, all of which have a row, in the order of their names."""
    return {
        split: {
            category: viewpoints_of_boxes([angles[_place(split, category, name)] for name in ordered])
            for category, ordered in group.items()
        }
        for split, group in names.items()
    }


def is_table(name: PurePosixPath) -> bool:
    """Tell whether a path inside the source names a table."""
    return name.name == TABLE and not is_hidden(name)


def _text(where: str, content: bytes) -> str:
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise DataError(f"{where} is not text in UTF-8; save it as UTF-8") from None


def _parse(where: str, text: str) -> Angles:
    rows = csv.DictReader(io.StringIO(text, newline=None))  # lines may end as on any system
    angles: Angles = {}
    try:
        missing = [column for column in (FILE, *ANGLES) if column not in (rows.fieldnames or ())]
        if missing:
            raise DataError(f"{where} has no column {missing[0]}; expected {', '.join((FILE, *ANGLES))}")
        for row in rows:
            name = _composed(row[FILE] or "")
            if name in angles:
                raise DataError(f"{where}, line {rows.line_num}: {name} has a row already; keep one of them")
            angles[name] = tuple(_radians(f"{where}, line {rows.line_num}", column, row[column]) for column in ANGLES)
    except csv.Error as error:
        raise DataError(f"{where}, line {rows.line_num + 1} cannot be read ({error}); look for quotes") from None
    return angles


def _radians(where: str, column: str, text: str) -> float:
    try:
        angle = float(text)
    except (TypeError, ValueError):
        angle = math.nan
    if not abs(angle) <= ANGLES[column]:
        raise DataError(
            f"{where}: {column} is {text!r}; expected an angle from {-ANGLES[column]} to {ANGLES[column]} degrees"
        )
    return math.radians(math.remainder(angle, 360) if column == ROLL else angle)


def _place(split: str, category: str, name: str) -> str:
    return _composed(f"{split}/{category}/{name}")


def _composed(name: str) -> str:
    """Return a name in one form of Unicode: file systems and tables write accents as characters of their own or not."""
    return unicodedata.normalize("NFC", name)
