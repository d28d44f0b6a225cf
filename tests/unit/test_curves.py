"""Curves are tables with one line of names."""

from pathlib import Path

import pytest

from pipeline.training.curves import Curve


def test_rows_become_csv(tmp_path: Path) -> None:
    curve = Curve()
    curve.append(0, loss=1 / 3, rate=1e-4)
    curve.append(10, loss=123456789.0, rate=0.5)
    curve.write(tmp_path / "curve.csv")
    assert (tmp_path / "curve.csv").read_bytes() == b"iteration,loss,rate\n0,0.333333,0.0001\n10,123457000.0,0.5\n"


def test_a_curve_of_no_training_is_a_table_without_rows(tmp_path: Path) -> None:
    Curve().write(tmp_path / "curve.csv")
    assert (tmp_path / "curve.csv").read_bytes() == b"iteration\n"


def test_a_curve_goes_on_from_the_rows_of_another() -> None:
    curve = Curve()
    curve.append(0, loss=1.0)
    continued = Curve(curve.rows)
    continued.append(1, loss=2.0)
    assert [row["loss"] for row in continued.rows] == [1.0, 2.0]
    assert len(curve.rows) == 1


def test_a_row_with_other_names_is_refused() -> None:
    curve = Curve()
    curve.append(0, loss=1.0)
    with pytest.raises(ValueError, match="share their names"):
        curve.append(1, lost=1.0)
