"""Record the course of a training as a table that `dvc plots` draws."""

from collections.abc import Sequence
from pathlib import Path

from pipeline.files import write_text


class Curve:
    """Collect one row of values every few iterations.

    `rows` is a list of plain dictionaries, so that a checkpoint can hold it and `Curve(rows)` can go on with it.
    """

    def __init__(self, rows: Sequence[dict[str, float]] = ()) -> None:
        """Start empty, or from the rows of a checkpoint."""
        self.rows: list[dict[str, float]] = list(rows)

    def append(self, iteration: int, **values: float) -> None:
        """Add a row; values keep six significant digits. Raises ValueError if the names differ from the first row's."""
        row = {"iteration": iteration, **{name: float(f"{float(value):.6g}") for name, value in values.items()}}
        if self.rows and row.keys() != self.rows[0].keys():
            raise ValueError(f"a curve's rows must share their names: {list(self.rows[0])}, not {list(row)}")
        self.rows.append(row)

    def write(self, path: Path) -> None:
        """Write the rows as CSV under one line of names, atomically; without rows the one name is `iteration`."""
        names = self.rows[0] if self.rows else ["iteration"]
        lines = [",".join(names), *(",".join(map(str, row.values())) for row in self.rows)]
        write_text(path, "\n".join(lines) + "\n")
