"""The loop of trainings that may be killed and go on: progress, curve, restart states."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from jaxtyping import Float
from torch import Tensor
from tqdm import tqdm

from pipeline.distributed import silent
from pipeline.training.checkpoint import Checkpoint, Part, pack, unpack
from pipeline.training.curves import Curve
from pipeline.training.divergence import read_losses, require_finite

_READ_EVERY = 100
"""Steps of a short training between looks at its losses, for which a GPU has to be waited for."""


@dataclass(frozen=True)
class Schedule:
    """How long a training lasts and how often it is written down."""

    iterations: int
    """Steps in all."""
    curve_every: int
    """Iterations that one row of the curve averages."""
    checkpoint_every: int
    """Iterations between restart states."""


@runtime_checkable
class Trainer(Protocol):
    """Everything that changes while something is learned."""

    def step(self, iteration: int) -> Mapping[str, Float[Tensor, ""]]:
        """Take one optimisation step; return its losses, on the device."""
        ...

    def parts(self) -> dict[str, Part]:
        """Name everything a restart state has to hold."""
        ...


def run_training(
    trainer: Trainer,
    schedule: Schedule,
    name: str,
    checkpoint: Checkpoint,
    prepare: Sequence[Callable[[], None]] = (),
    observe: Callable[[int], Mapping[str, float]] = lambda _iteration: {},
    until: int | None = None,
) -> Curve:
    """Take all steps of a training, going on from the checkpoint where there is one; return the mean losses.

    `name` stands beside the progress bar and in errors. What `prepare` lists is called in turn before the first step,
    and what each has changed is saved; `observe` measures what else a row of the curve holds, after the row's last
    iteration. With `until`, only the steps before that one are taken, and a later call takes the others.

    A killed call that is repeated with the same checkpoint ends with the same bytes (CPU). Raises TrainingDiverged
    where a loss or a weight is not finite, before the next restart state is written.
    """
    prepared, first, curve, recent = _restore(trainer, checkpoint) or (0, 0, Curve(), [])

    def save(done: int) -> None:
        tensors = pack(**trainer.parts())
        require_finite(tensors, done, name)
        values = {"prepared": prepared, "iteration": done, "rows": curve.rows, "recent": recent}
        checkpoint.save(tensors, values)

    for call in prepare[prepared:]:
        call()
        prepared += 1
        save(0)
    unread: list[Mapping[str, Float[Tensor, ""]]] = []
    total = schedule.iterations
    last = total if until is None else until
    for iteration in tqdm(range(first, last), name, initial=first, total=total, disable=silent()):
        unread.append(trainer.step(iteration))
        done = iteration + 1
        is_row = done == total or done % schedule.curve_every == 0
        is_saved = done == last or done % schedule.checkpoint_every == 0
        if is_row or is_saved:
            recent, unread = recent + read_losses(unread, iteration, name), []
        if is_row:
            curve.append(done, **_means(recent), **observe(iteration))
            recent = []
        if is_saved:
            save(done)
    return curve


def take_steps(step: Callable[[int], Mapping[str, Float[Tensor, ""]]], iterations: int, name: str) -> None:
    """Take all steps of a short training, one that has neither curve nor restart states.

    Raises TrainingDiverged, a hundred steps later at most, where a loss is not finite.
    """
    unread: list[Mapping[str, Float[Tensor, ""]]] = []
    for iteration in tqdm(range(iterations), name, disable=silent()):
        unread.append(step(iteration))
        if len(unread) == _READ_EVERY or iteration + 1 == iterations:
            read_losses(unread, iteration, name)
            unread = []


def _restore(trainer: Trainer, checkpoint: Checkpoint) -> tuple[int, int, Curve, list[dict[str, float]]] | None:
    """Take over a restart state.

    Return how much was prepared, the iteration, the curve, and the losses since the curve's last row.
    """
    restored = checkpoint.load()
    if restored is None:
        return None
    tensors, values = restored
    unpack(tensors, **trainer.parts())
    return values["prepared"], values["iteration"], Curve(values["rows"]), values["recent"]


def _means(rows: list[dict[str, float]]) -> dict[str, float]:
    return {name: sum(row[name] for row in rows) / len(rows) for name in rows[0]}
