import re
from xml.etree import ElementTree

import pytest

from pipeline.export.charts import (
    BOTTOM,
    HEIGHT,
    LEFT,
    RIGHT,
    TOP,
    WIDTH,
    Axis,
    histogram,
    line_chart,
    scatter,
    spanning_axis,
)


def drawing(chart: str) -> ElementTree.Element:
    return ElementTree.fromstring(re.search("<svg.*?</svg>", chart)[0])  # pyright: ignore[reportOptionalSubscript]


@pytest.mark.parametrize(
    ("values", "ticks"),
    [
        ([0, 1], [0, 0.2, 0.4, 0.6, 0.8, 1]),
        ([3, 97], [0, 20, 40, 60, 80, 100]),
        ([-0.03, 0.02], [-0.03, -0.02, -0.01, 0, 0.01, 0.02]),
        ([0, 1200], [0, 250, 500, 750, 1000, 1250]),
    ],
)
def test_axis_has_round_ticks_around_all_values(values: list[float], ticks: list[float]) -> None:
    axis = spanning_axis(values, "")
    assert list(axis.ticks) == pytest.approx(ticks)
    assert axis.low <= min(values) < max(values) <= axis.high


@pytest.mark.parametrize("value", [0.0, 5.0, -2.0])
def test_axis_of_one_value_is_not_empty(value: float) -> None:
    axis = spanning_axis([value, value], "")
    assert axis.low <= value <= axis.high
    assert axis.low < axis.high


def test_line_runs_from_corner_to_corner() -> None:
    line = drawing(line_chart({"loss": [(0, 0), (1, 1)]}, "loss")).find("polyline")
    assert line is not None
    assert line.get("points") == f"{LEFT:.1f},{HEIGHT - BOTTOM:.1f} {WIDTH - RIGHT:.1f},{TOP:.1f}"


def test_axes_are_labelled_and_names_escaped() -> None:
    chart = line_chart({"a<b": [(0, 0), (1, 1)], "c": [(0, 1)]}, "loss & more")
    names = [text.text for text in drawing(chart).iter("text") if text.get("class") == "name"]
    assert names == ["iteration", "loss & more"]
    assert "a&lt;b" in chart


def test_histogram_bars_are_shares() -> None:
    chart = drawing(histogram({"errors": [1, 2, 3, 15]}, [0, 10, 20], Axis(0, 20, [0, 10, 20], "error")))
    heights = [float(bar.get("height", 0)) for bar in chart.iter("rect")]
    assert heights[0] == pytest.approx(3 * heights[1], rel=0.01)


def test_bars_of_two_groups_stand_side_by_side() -> None:
    groups = {"before": [1.0, 15.0], "after": [2.0, 3.0]}
    chart = drawing(histogram(groups, [0, 10, 20], Axis(0, 20, [0, 10, 20], "error")))
    bars = sorted((float(bar.get("x", 0)), float(bar.get("width", 0)), bar.get("class")) for bar in chart.iter("rect"))
    assert [style for _, _, style in bars] == ["bar series-0", "bar series-1"] * 2
    middle = (LEFT + WIDTH - RIGHT) / 2
    for (left, width, _), end in zip(bars, [bars[1][0], middle, bars[3][0], WIDTH - RIGHT], strict=True):
        assert 0 < width <= end - left + 0.1


def test_lines_of_two_series_differ_in_colour_and_dashes() -> None:
    lines = list(drawing(line_chart({"a": [(0, 0), (1, 1)], "b": [(0, 1), (1, 0)]}, "loss")).iter("polyline"))
    assert [line.get("class") for line in lines] == ["series-0 dash-0", "series-1 dash-1"]
    assert lines[0].get("points") != lines[1].get("points")


def test_last_edge_belongs_to_the_last_bar() -> None:
    chart = drawing(histogram({"errors": [180.0]}, [0, 90, 180.0], Axis(0, 180, [0, 180], "error")))
    assert [float(bar.get("height", 0)) > 0 for bar in chart.iter("rect")] == [False, True]


def test_scatter_has_a_dot_for_each_point() -> None:
    axis = Axis(-1, 1, [-1, 0, 1], "x")
    chart = drawing(scatter([(-1, -1), (0, 0), (1, 1)], {"diagonal": [((-1, -1), (1, 1))]}, (axis, axis)))
    assert [float(dot.get("cx", 0)) for dot in chart.iter("circle")] == [
        LEFT,
        (LEFT + WIDTH - RIGHT) / 2,
        WIDTH - RIGHT,
    ]
    assert len(list(chart.iter("line"))) == 1 + 3 + 1
