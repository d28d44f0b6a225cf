"""Photographs cut to objects whose viewpoints are known: a folder or archive of pictures with a table `poses.csv`."""

import csv
import io
import math
import unicodedata
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath

from pipeline.datasets.archives import is_hidden, read_files
from pipeline.datasets.prepared import Names, TruthBySplit
from pipeline.datasets.truth import Viewpoints, viewpoints_of_boxes
from pipeline.errors import DataError

TABLE = "poses.csv"
FILE = "file"
ANGLES = {"azimuth_deg": 360, "elevation_deg": 90, "roll_deg": 360}
"""Columns of the table and how far from 0 they may be, in degrees and in the conventions of `geometry.camera.Pose`."""

Angles = dict[str, tuple[float, ...]]
"""Azimuth, elevation and roll in radians, by a picture's path below the table's folder."""


def read_viewpoints(path: Path, names: Names) -> TruthBySplit:
    """Read the viewpoints of pictures from `poses.csv` above `train` and `test`.

    Raises DataError for a table that is missing or cannot be read, for two tables, for a picture without a row, and for
    one with two.
    """
    angles = _read_angles(path)
    return {
        split: {
            category: _truth(path, angles, [f"{split}/{category}/{name}" for name in ordered])
            for category, ordered in group.items()
        }
        for split, group in names.items()
    }


def is_table(name: PurePosixPath) -> bool:
    """Tell whether a path inside the source names a table."""
    return name.name == TABLE and not is_hidden(name)


def _read_angles(path: Path) -> Angles:
    tables = dict(read_files(path, is_table))
    if not tables:
        raise DataError(f"{path} has no {TABLE}; expected one with the columns {', '.join((FILE, *ANGLES))}")
    if len(tables) > 1:
        raise DataError(f"{path} has the tables {' and '.join(map(str, tables))}; keep the one that is right")
    ((name, content),) = tables.items()
    return _parse(f"{path}: {name}", _text(f"{path}: {name}", content))


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
    return math.radians(angle)


def _truth(path: Path, angles: Mapping[str, tuple[float, ...]], names: Sequence[str]) -> Viewpoints:
    composed = [_composed(name) for name in names]
    unknown = [name for name in composed if name not in angles]
    if unknown:
        raise DataError(f"{path}: {TABLE} has no row for {unknown[0]}; every picture needs one")
    return viewpoints_of_boxes([angles[name] for name in composed])


def _composed(name: str) -> str:
    """Return a name in one form of Unicode: file systems and tables write accents as characters of their own or not."""
    return unicodedata.normalize("NFC", name)
