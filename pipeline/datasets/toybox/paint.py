"""Colours as they occur in photographs, as linear reflectances."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

CAR_PAINTS = np.array(
    [
        [0.78, 0.78, 0.76], [0.03, 0.03, 0.035], [0.45, 0.46, 0.48], [0.16, 0.17, 0.18], [0.50, 0.03, 0.03], [0.04, 0.08, 0.30],
        [0.25, 0.02, 0.04], [0.75, 0.50, 0.03], [0.03, 0.16, 0.08], [0.50, 0.42, 0.30], [0.10, 0.28, 0.55], [0.60, 0.20, 0.03],
        [0.32, 0.45, 0.42], [0.18, 0.10, 0.06],
    ]
)  # fmt: skip
CAR_SHARES = np.array([16, 12, 16, 9, 15, 9, 4, 6, 3, 3, 4, 2, 3, 1]) / 103

WOODS = [[0.30, 0.16, 0.07], [0.16, 0.07, 0.03], [0.45, 0.30, 0.16], [0.06, 0.04, 0.03], [0.60, 0.58, 0.54]]
METALS = [[0.50, 0.50, 0.50], [0.04, 0.04, 0.04], [0.25, 0.25, 0.26], [0.70, 0.70, 0.70]]
FABRICS = [
    [0.05, 0.05, 0.06], [0.40, 0.05, 0.05], [0.06, 0.10, 0.25], [0.45, 0.38, 0.28], [0.25, 0.25, 0.25], [0.60, 0.58, 0.54],
    [0.10, 0.22, 0.10], [0.55, 0.25, 0.04], [0.22, 0.11, 0.06], [0.10, 0.30, 0.35],
]  # fmt: skip
AIRCRAFT = [
    [0.75, 0.75, 0.75], [0.75, 0.75, 0.75], [0.45, 0.46, 0.47], [0.22, 0.24, 0.26], [0.12, 0.13, 0.09], [0.60, 0.40, 0.04],
    [0.45, 0.05, 0.04], [0.05, 0.05, 0.06], [0.08, 0.15, 0.35], [0.30, 0.28, 0.20],
]  # fmt: skip
LIVERIES = [[0.45, 0.03, 0.03], [0.03, 0.07, 0.30], [0.03, 0.03, 0.04], [0.60, 0.35, 0.03], [0.05, 0.20, 0.08], [0.1, 0.3, 0.5]]
COATS = [
    [[0.22, 0.10, 0.04], [0.03, 0.02, 0.02], [0.05, 0.03, 0.02]],
    [[0.32, 0.14, 0.05], [0.30, 0.13, 0.05], [0.28, 0.12, 0.05]],
    [[0.10, 0.05, 0.03], [0.03, 0.02, 0.02], [0.04, 0.03, 0.02]],
    [[0.03, 0.03, 0.03], [0.02, 0.02, 0.02], [0.03, 0.03, 0.03]],
    [[0.50, 0.33, 0.15], [0.70, 0.62, 0.48], [0.45, 0.30, 0.15]],
    [[0.65, 0.62, 0.58], [0.60, 0.57, 0.52], [0.50, 0.47, 0.43]],
    [[0.32, 0.31, 0.30], [0.12, 0.12, 0.12], [0.15, 0.14, 0.14]],
]
"""Coat, mane and lower legs: bay, chestnut, dark bay, black, palomino, white, gray."""


def car_paint(count: int, rng: np.random.Generator) -> Float[np.ndarray, "B 3"]:
    """Draw the paint of cars."""
    return jitter(CAR_PAINTS[rng.choice(len(CAR_PAINTS), count, p=CAR_SHARES)], 0.06, rng)


def pick(colors: Sequence[Sequence[float]], count: int, rng: np.random.Generator) -> Float[np.ndarray, "B 3"]:
    """Draw colours of a list, a little varied."""
    return jitter(np.array(colors)[rng.integers(len(colors), size=count)], 0.06, rng)


def jitter(
    color: Float[np.ndarray, "... 3"], amount: float, rng: np.random.Generator, count: int | None = None
) -> Float[np.ndarray, "B 3"]:
    """Vary colours: the brightness by a factor, each channel by up to `amount` times its own level plus a little."""
    color = np.broadcast_to(color, (count, 3)) if count is not None else color
    brightness = np.exp(rng.normal(0, 0.25, (len(color), 1)))
    return np.clip(color * brightness + rng.normal(0, amount, color.shape) * (color + 0.1), 0.005, 0.95)
