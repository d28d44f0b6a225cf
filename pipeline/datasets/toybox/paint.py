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
