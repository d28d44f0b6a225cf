"""Charts as inline SVG that follows the page's colours: class `series-0` to `series-7` and `axis`, `grid`, `guide`.

Series differ in more than colour: lines have dashes of their own (`dash-0` to `dash-4`), and the bars of a second group
are pale.
"""

import math
from collections.abc import Mapping, Sequence
from html import escape
from typing import NamedTuple

import numpy as np

WIDTH, HEIGHT = 420, 280
LEFT, RIGHT, TOP, BOTTOM = 88, 22, 12, 54
COLORS, DASHES = 8, 5

Point = tuple[float, float]


class Axis(NamedTuple):
    """The range of one axis, where its ticks are, and what it shows."""

    low: float
    high: float
    ticks: Sequence[float]
    label: str


def spanning_axis(values: Sequence[float], label: str) -> Axis:
    """Choose an axis over all values whose about five ticks are round numbers and whose ends are ticks."""
    low, high = min(values), max(values)
    span = high - low or abs(high) or 1.0
    magnitude = 10 ** math.floor(math.log10(span / 5))
    step = next(factor * magnitude for factor in (1, 2, 2.5, 5, 10) if factor * magnitude * 5 >= span)
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    last = max(last, first + 1)
    return Axis(first * step, last * step, [index * step for index in range(first, last + 1)], label)


def line_chart(series: Mapping[str, Sequence[Point]], label: str) -> str:
    """Draw one line over iterations for each named series; a legend is drawn for two or more."""
    points = [point for line in series.values() for point in line]
    x_axis = spanning_axis([x for x, _ in points], "iteration")
    y_axis = spanning_axis([y for _, y in points], label)
    lines, keys = [], {}
    for index, (name, line) in enumerate(series.items()):
        path = " ".join(f"{_x(x, x_axis):.1f},{_y(y, y_axis):.1f}" for x, y in line)
        lines.append(f'<polyline class="{_look(index)}" points="{path}"/>')
        keys[name] = f'<polyline class="{_look(index)}" points="0,6 28,6"/>'
    return _chart(x_axis, y_axis, lines, keys if len(series) > 1 else {})


def histogram(groups: Mapping[str, Sequence[float]], edges: Sequence[float], x_axis: Axis) -> str:
    """Draw the share of each group's values between neighbouring edges, groups side by side."""
    shares = {name: (np.histogram(values, edges)[0] / len(values)).tolist() for name, values in groups.items()}
    y_axis = spanning_axis([0.0, *(share for group in shares.values() for share in group)], "share of pictures")
    bars = []
    for index, group in enumerate(shares.values()):
        for low, high, share in zip(edges[:-1], edges[1:], group, strict=True):
            width = (_x(high, x_axis) - _x(low, x_axis)) * 0.9 / len(shares)
            left = _x(low, x_axis) + index * width
            top = _y(share, y_axis)
            bars.append(
                f'<rect class="bar series-{index}" x="{left:.1f}" y="{top:.1f}" width="{width:.1f}" '
                f'height="{_y(0, y_axis) - top:.1f}"/>'
            )
    keys = {
        name: f'<rect class="bar series-{index}" x="8" y="1" width="12" height="10"/>'
        for index, name in enumerate(groups)
    }
    return _chart(x_axis, y_axis, bars, keys)


def scatter(points: Sequence[Point], guides: Mapping[str, Sequence[Sequence[Point]]], axes: tuple[Axis, Axis]) -> str:
    """Draw points over named guides, each a set of straight lines."""
    x_axis, y_axis = axes
    marks = [
        f'<line class="guide {_look(index + 1)}" x1="{_x(start[0], x_axis):.1f}" y1="{_y(start[1], y_axis):.1f}" '
        f'x2="{_x(end[0], x_axis):.1f}" y2="{_y(end[1], y_axis):.1f}"/>'
        for index, lines in enumerate(guides.values())
        for start, end in lines
    ]
    marks += [
        f'<circle class="dot series-0" cx="{_x(x, x_axis):.1f}" cy="{_y(y, y_axis):.1f}" r="2.5"/>' for x, y in points
    ]
    keys = {"pictures": '<circle class="dot series-0" cx="14" cy="6" r="4"/>'}
    for index, name in enumerate(guides):
        keys[name] = f'<line class="guide {_look(index + 1)}" x1="0" y1="6" x2="28" y2="6"/>'
    return _chart(x_axis, y_axis, marks, keys)


def _look(index: int) -> str:
    return f"series-{index % COLORS} dash-{index % DASHES}"


def _chart(x_axis: Axis, y_axis: Axis, marks: Sequence[str], keys: Mapping[str, str]) -> str:
    """Draw marks over a grid; `keys` has a sample of each name's mark, 28 units wide and 12 high."""
    legend = "".join(
        f'<span class="key"><svg viewBox="0 0 28 12" aria-hidden="true">{sample}</svg>{escape(name)}</span>'
        for name, sample in keys.items()
    )
    label = escape(f"{y_axis.label} over {x_axis.label}", quote=True)
    drawing = "".join([*_grid(x_axis, y_axis), *marks])
    svg = f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{label}">{drawing}</svg>'
    return f'<div class="chart">{svg}<div class="legend">{legend}</div></div>'


def _grid(x_axis: Axis, y_axis: Axis) -> list[str]:
    bottom, right, middle = HEIGHT - BOTTOM, WIDTH - RIGHT, (TOP + HEIGHT - BOTTOM) / 2
    parts = []
    for tick in y_axis.ticks:
        y = _y(tick, y_axis)
        parts.append(f'<line class="grid" x1="{LEFT}" x2="{right}" y1="{y:.1f}" y2="{y:.1f}"/>')
        parts.append(f'<text class="tick" x="{LEFT - 6}" y="{y + 5:.1f}" text-anchor="end">{tick:.6g}</text>')
    for tick in x_axis.ticks:
        x = _x(tick, x_axis)
        parts.append(f'<text class="tick" x="{x:.1f}" y="{bottom + 20}" text-anchor="middle">{tick:.6g}</text>')
    parts.append(f'<line class="axis" x1="{LEFT}" x2="{right}" y1="{bottom}" y2="{bottom}"/>')
    x_middle = (LEFT + right) / 2
    parts.append(
        f'<text class="name" x="{x_middle}" y="{HEIGHT - 8}" text-anchor="middle">{escape(x_axis.label)}</text>'
    )
    turned = f'transform="rotate(-90 16 {middle})"'
    parts.append(f'<text class="name" x="16" y="{middle}" text-anchor="middle" {turned}>{escape(y_axis.label)}</text>')
    return parts


def _x(value: float, axis: Axis) -> float:
    return LEFT + (value - axis.low) / (axis.high - axis.low) * (WIDTH - LEFT - RIGHT)


def _y(value: float, axis: Axis) -> float:
    return HEIGHT - BOTTOM - (value - axis.low) / (axis.high - axis.low) * (HEIGHT - TOP - BOTTOM)
