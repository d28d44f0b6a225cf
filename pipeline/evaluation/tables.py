"""Tables: one row a picture as CSV, and a run's figures as text for the terminal."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas
from torch import Tensor

from pipeline.errors import DataError
from pipeline.evaluation.pose import MODES
from pipeline.files import atomic_path


def write_table(path: Path, columns: Mapping[str, Tensor]) -> None:
    """Write columns of equal length as CSV, atomically; error modes are spelt out, fractions have six digits."""
    table = pandas.DataFrame({name: _values(name, column) for name, column in columns.items()})
    with atomic_path(path) as temporary:
        table.to_csv(temporary, index=False, lineterminator="\n", float_format="%.6f")


def read_table(path: Path) -> dict[str, list[str]]:
    """Read the columns of a CSV file as text. Raises DataError where it is damaged."""
    try:
        table = pandas.read_csv(path, dtype=str, keep_default_na=False)
    except (ValueError, UnicodeDecodeError) as error:
        raise DataError(f"{path} is damaged ({str(error).strip()}); run the stage that writes it again") from None
    return {str(name): values.tolist() for name, values in table.items()}


def figure_rows(metrics: Mapping[str, Any], prefix: str = "") -> list[tuple[str, float, float | None, int | None]]:
    """Flatten nested figures and lists of them to rows of name, value, standard error and n, None where not given.

    A section that holds n and a standard error of its own lends them to its `value` or `acc_pi6`.
    """
    rows: list[tuple[str, float, float | None, int | None]] = []
    for name, value in metrics.items():
        label = f"{prefix}.{name}" if prefix else name
        if isinstance(value, Mapping):
            rows += figure_rows(value, label)
        elif isinstance(value, list):
            numbers = ((index, item) for index, item in enumerate(value) if isinstance(item, int | float))
            rows += [(f"{label}.{index}", number, None, None) for index, number in numbers]
        elif name in ("value", "acc_pi6"):
            rows.append((prefix if name == "value" else label, value, metrics["standard_error"], metrics["n"]))
        elif isinstance(value, int | float) and name not in ("n", "standard_error"):
            rows.append((label, value, None, None))
    return rows


def format_figures(metrics: Mapping[str, Any]) -> str:
    """Lay out a run's figures as aligned lines of text."""
    rows = figure_rows(metrics)
    width = max(len(name) for name, *_ in rows)
    lines = [f"{'figure':<{width}}      value   std. err.      n"]
    for name, value, error, count in rows:
        spread = "" if count is None else f"{'–' if error is None else format(error, '.4f'):>11} {count:>6}"
        lines.append(f"{name:<{width}} {value:>10.4f} {spread}".rstrip())
    return "\n".join(lines)


def _values(name: str, column: Tensor) -> list[Any]:
    return [MODES[index] for index in column.tolist()] if name.startswith("error_mode") else column.tolist()
