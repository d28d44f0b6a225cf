"""Losses and states that are no longer finite end a training."""

import math
from collections.abc import Mapping, Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.errors import TrainingDiverged

_ADVICE = "look at the inputs, or lower the learning rate, with which the training starts anew"


def read_losses(rows: Sequence[Mapping[str, Float[Tensor, ""]]], iteration: int, phase: str) -> list[dict[str, float]]:
    """Bring the losses of consecutive iterations to the host in one copy; the last is `iteration`, counted from 0.

    The host waits for a GPU then, so let some iterations pass, but read before the next checkpoint: raises
    TrainingDiverged, naming the phase of the training and the iteration, counted from 1 as in curves, where a loss is
    not finite.
    """
    table = torch.stack([torch.stack([*row.values()]) for row in rows]).tolist() if rows else []
    for number, values in enumerate(table, iteration + 2 - len(table)):
        if not all(map(math.isfinite, values)):
            raise TrainingDiverged(
                f"the loss of {phase} became {next(value for value in values if not math.isfinite(value))} at "
                f"iteration {number}; {_ADVICE}"
            )
    return [dict(zip(row, values, strict=True)) for row, values in zip(rows, table, strict=True)]


def require_finite(state: Mapping[str, Tensor], done: int, phase: str) -> None:
    """Raise TrainingDiverged where packed state is not finite: a finite loss may have had a gradient that was not.

    `done` is how many iterations the phase has behind it.
    """
    for name, tensor in state.items():
        if tensor.is_floating_point() and not tensor.isfinite().all():
            raise TrainingDiverged(f"{name} is no longer finite after iteration {done} of {phase}; {_ADVICE}")
