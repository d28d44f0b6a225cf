"""Which of the seeds' base shapes all others are built around."""

from collections.abc import Sequence
from pathlib import Path

from pipeline.errors import ConfigError
from pipeline.tensor_files import load_tensors

BY_SCORE = "score"
"""Instead of a seed: that of the lowest score."""


def best_seed(scores: Sequence[float]) -> int:
    """Return the seed whose renderings are nearest to the photographs."""
    return min(range(len(scores)), key=scores.__getitem__)


def choose_seed(choice: str, scores: Sequence[float], name: str) -> int:
    """Return the seed of the base shape that others are built around: the best by `score`, or the one that is chosen.

    `name` is that of the entry under `base_shapes`. Raises ConfigError where there is no such seed.
    """
    if choice == BY_SCORE:
        return best_seed(scores)
    if choice.isdecimal() and int(choice) < len(scores):
        return int(choice)
    raise ConfigError(
        f"base_shapes.{name}.chosen is '{choice}'; expected '{BY_SCORE}', or a seed from 0 to {len(scores) - 1}"
    )


def load_seed(path: Path) -> int:
    """Return which seed's base shape the stage `remesh` wrote."""
    _, metadata = load_tensors(path)
    return int(metadata["seed"])
