"""The table of all runs."""

import re
from pathlib import Path

from pipeline.export.runs_page import COLUMNS, MeasuredRun, write_runs_page


def figures(distance: float) -> dict:
    return {"reconstruction": {"tuned": {"feature_distance": {"value": distance, "standard_error": 0.5, "n": 7}}}}


def rows(text: str) -> dict[str, list[str]]:
    """Return the cells of each row, by the text of the first one."""
    body = text.partition("<tbody>")[2]
    found = [re.findall(r"<td>(.*?)</td>", row) for row in re.findall(r"<tr.*?</tr>", body)]
    return {re.sub("<.*?>", "", row[0]): row[1:] for row in found}


def test_runs_stand_with_their_errors_and_seeds_with_their_mean(tmp_path: Path) -> None:
    runs = [
        MeasuredRun("car-seed1", None, figures(3)),
        MeasuredRun("horse", "horse/index.html", figures(9)),
        MeasuredRun("car", None, figures(1)),
    ]
    write_runs_page(tmp_path / "index.html", runs)
    text = (tmp_path / "index.html").read_text()
    table = rows(text)
    assert list(table) == ["horse", "car", "car-seed1", "car, 2 seeds"], "those with a page stand first"
    column = 1 + list(COLUMNS).index("distance, fine-tuned")
    assert table["car"][0] == "7"
    assert table["car"][column] == "1.00 <small>± 0.50</small>"
    assert table["car, 2 seeds"][column] == "2.00 <small>SD 1.41</small>"
    assert set(table["horse"][1:column]) == {"–"}
    assert re.findall(r'<td><a href="(.*?)">', text) == ["horse/index.html"]


def test_a_single_picture_has_no_error(tmp_path: Path) -> None:
    alone = {"value": 3, "standard_error": None, "n": 1}
    write_runs_page(tmp_path / "a.html", [MeasuredRun("car", None, {"reconstruction": {"tuned": {"ssim": alone}}})])
    assert rows((tmp_path / "a.html").read_text())["car"][-1] == "3.000"


def test_seeds_of_a_baseline_are_one_experiment() -> None:
    names = ("car-colmap", "car-seed1-colmap", "car-seed12-colmap", "car-seed1", "car-seed1-longer")
    experiments = [MeasuredRun(name, None, {}).experiment for name in names]
    assert experiments == ["car-colmap"] * 3 + ["car", "car-seed1-longer"]


def test_a_base_shape_that_is_trained_around_is_no_seed_of_the_run() -> None:
    names = ("ship-around-car-seed1", "ship-around-car", "ship-seed1-around-car", "ship-seed2-around-car-seed1")
    experiments = [MeasuredRun(name, None, {}).experiment for name in names]
    assert experiments == ["ship-around-car-seed1", "ship-around-car", "ship-around-car", "ship-around-car-seed1"]


def test_names_are_escaped(tmp_path: Path) -> None:
    write_runs_page(tmp_path / "index.html", [MeasuredRun("a<b", "a<b/index.html", figures(1))])
    assert '<a href="a&lt;b/index.html">a&lt;b</a>' in (tmp_path / "index.html").read_text()
