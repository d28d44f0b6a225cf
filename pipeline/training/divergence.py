"""Losses and states that are no longer finite end a training."""

import math
from collections.abc import Mapping, Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.errors import TrainingDiverged


def read_losses(rows: Sequence[Mapping[str, Float[Tensor, ""]]], iteration: int, phase: str) -> list[dict[str, float]]:
    """Bring the losses of consecutive iterations, the last of which is `iteration`, to the host in one copy.

    The host waits for a GPU then, so let some iterations pass, but read before the next checkpoint: raises
    TrainingDiverged, naming the phase of the training, where a loss is not finite.
    """
    table = torch.stack([torch.stack([*row.values()]) for row in rows]).tolist() if rows else []
    for number, values in enumerate(table, iteration + 1 - len(table)):
        if not all(map(math.isfinite, values)):
            raise TrainingDiverged(
                f"the loss of {phase} became {next(value for value in values if not math.isfinite(value))} at "
                f"iteration {number}; what was saved before it is kept: lower the learning rate or look at the inputs"
            )
    return [dict(zip(row, values, strict=True)) for row, values in zip(rows, table, strict=True)]


def require_finite(state: Mapping[str, Tensor], iteration: int, phase: str) -> None:
    """Raise TrainingDiverged where packed state is not finite: a finite loss may have had a gradient that was not."""
    for name, tensor in state.items():
        if tensor.is_floating_point() and not tensor.isfinite().all():
            raise TrainingDiverged(
                f"{name} is no longer finite after iteration {iteration} of {phase}; what was saved before it is "
                "kept: lower the learning rate or look at the inputs"
            )
