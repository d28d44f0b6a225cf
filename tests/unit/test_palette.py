"""Colours of charts: far apart for every common colour vision, and clear of the ground they are drawn on."""

import itertools
import re

import cv2
import numpy
import pytest

from pipeline.export.report_style import STYLE

# Machado, Oliveira and Fernandes 2009, severity 1, on linear RGB.
VISIONS = {
    "usual": numpy.eye(3),
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}
THEMES: dict[str, str] = dict(zip(("light", "dark"), STYLE.split("prefers-color-scheme: dark"), strict=True))


def linear(name: str, theme: str) -> numpy.ndarray:
    """Read a colour of a theme as linear RGB."""
    digits = re.search(rf"--{name}: #(\w{{6}})", THEMES[theme])
    assert digits is not None
    encoded = numpy.array([int(digits[1][start : start + 2], 16) for start in (0, 2, 4)]) / 255
    return numpy.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def series(theme: str) -> numpy.ndarray:
    return numpy.stack([linear(f"series-{index}", theme) for index in range(8)])


@pytest.mark.parametrize("theme", THEMES)
@pytest.mark.parametrize("vision", VISIONS)
def test_any_two_series_differ_for_every_colour_vision(theme: str, vision: str) -> None:
    seen = (series(theme) @ numpy.array(VISIONS[vision]).T).clip(0, 1).astype(numpy.float32)
    lab = cv2.cvtColor(seen[None], cv2.COLOR_LRGB2Lab)[0]
    distances = [numpy.linalg.norm(one - other) for one, other in itertools.combinations(lab, 2)]
    assert min(distances) > 20


@pytest.mark.parametrize("theme", THEMES)
def test_every_series_stands_out_from_the_card(theme: str) -> None:
    weights = numpy.array([0.2126, 0.7152, 0.0722])
    ground = linear("card", theme) @ weights
    for luminance in series(theme) @ weights:
        assert (max(luminance, ground) + 0.05) / (min(luminance, ground) + 0.05) >= 3
