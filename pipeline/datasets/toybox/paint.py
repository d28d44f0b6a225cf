"""Colours as they occur in photographs."""

import numpy as np
from jaxtyping import Float


def palette(codes: str) -> Float[np.ndarray, "K 3"]:
    """Turn sRGB codes such as `"ff0000 00ff00"` into linear reflectances in [0, 1]."""
    encoded = np.array([list(bytes.fromhex(code)) for code in codes.split()]) / 255
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def pick(colors: Float[np.ndarray, "K 3"], count: int, rng: np.random.Generator) -> Float[np.ndarray, "B 3"]:
    """Draw colours from a palette, each a little varied; a colour that stands twice is drawn twice as often."""
    return vary(colors[rng.integers(len(colors), size=count)], rng)


def vary(colors: Float[np.ndarray, "B 3"], rng: np.random.Generator) -> Float[np.ndarray, "B 3"]:
    """Vary colours: their brightness by about a quarter, each channel by a few percent."""
    brightness = np.exp(rng.normal(0, 0.25, (len(colors), 1)))
    return np.clip(colors * brightness + rng.normal(0, 0.06, colors.shape) * (colors + 0.1), 0.005, 0.95)


def shades(code: str, count: int, rng: np.random.Generator) -> Float[np.ndarray, "B 3"]:
    """Draw varied shades of one colour, given as an sRGB code."""
    return pick(palette(code), count, rng)
