"""The loop of trainings: what it writes down, and what it refuses to."""

from functools import partial
from pathlib import Path

import pytest
import torch
from torch import Tensor

from pipeline.errors import TrainingDiverged
from pipeline.training.checkpoint import Checkpoint, Part
from pipeline.training.loop import Schedule, run_training, take_steps


class Descent:
    """Walk down a parabola; from some iteration on the loss is finite and its gradient is not."""

    def __init__(self, broken_from: int = 99) -> None:
        self.place, self.broken_from = torch.tensor(1.0), broken_from

    def step(self, iteration: int) -> dict[str, Tensor]:
        loss = self.place**2
        self.place = self.place * (0.5 if iteration < self.broken_from else torch.nan)
        return {"loss": loss}

    def parts(self) -> dict[str, Part]:
        return {"place": self.place}


def test_rows_are_means_and_the_last_one_may_be_short(tmp_path: Path) -> None:
    curve = run_training(
        Descent(), Schedule(5, 2, 3), "descent", Checkpoint(tmp_path, "key"), observe=lambda i: {"seen": i}
    )
    losses = [0.25**iteration for iteration in range(5)]
    means = [sum(losses[:2]) / 2, sum(losses[2:4]) / 2, losses[4]]
    assert [row["loss"] for row in curve.rows] == pytest.approx(means, rel=1e-5)
    assert [(row["iteration"], row["seen"]) for row in curve.rows] == [(2, 1), (4, 3), (5, 4)]


def test_a_training_in_two_parts_ends_as_in_one(tmp_path: Path) -> None:
    whole, first, second = Descent(), Descent(), Descent()
    expected = run_training(whole, Schedule(5, 2, 4), "descent", Checkpoint(tmp_path / "whole", "key"))
    parts = Checkpoint(tmp_path / "parts", "key")
    assert len(run_training(first, Schedule(5, 2, 4), "descent", parts, until=3).rows) == 1
    assert run_training(second, Schedule(5, 2, 4), "descent", parts).rows == expected.rows
    assert (first.place, second.place) == (0.5**3, whole.place)


class Mortal(Descent):
    """Walk down the parabola, and die at the second step."""

    alive = True

    def step(self, iteration: int) -> dict[str, Tensor]:
        if not self.alive:
            raise KeyboardInterrupt
        self.alive = False
        return super().step(iteration)


def test_a_training_that_dies_after_every_step_ends_as_one_that_lives(tmp_path: Path) -> None:
    whole, last, schedule = Descent(), Descent(), Schedule(6, 4, 1)
    expected = run_training(whole, schedule, "descent", Checkpoint(tmp_path / "whole", "key"))
    checkpoint = Checkpoint(tmp_path / "mortal", "key")
    for _ in range(5):
        with pytest.raises(KeyboardInterrupt):
            run_training(Mortal(), schedule, "descent", checkpoint)
    assert run_training(last, schedule, "descent", checkpoint).rows == expected.rows
    assert last.place == whole.place


def test_what_prepares_a_training_happens_once_in_turn_and_is_kept(tmp_path: Path) -> None:
    prepared: list[str] = []

    def run(*deadly: str) -> Descent:
        descent = Descent()

        def prepare(name: str) -> None:
            if name in deadly:
                raise KeyboardInterrupt
            prepared.append(name)
            descent.place += 1

        calls = [partial(prepare, name) for name in "abc"]
        run_training(descent, Schedule(1, 1, 1), "descent", Checkpoint(tmp_path, "key"), prepare=calls)
        return descent

    for deadly in "bc":
        with pytest.raises(KeyboardInterrupt):
            run(deadly)
    assert [run().place, run().place] == [2.0, 2.0]
    assert prepared == ["a", "b", "c"]


@pytest.mark.parametrize("broken_from", [3, 5])
def test_weights_that_are_not_finite_are_never_saved(broken_from: int, tmp_path: Path) -> None:
    checkpoint = Checkpoint(tmp_path, "key")
    with pytest.raises(TrainingDiverged, match=f"place is no longer finite after iteration {broken_from + 1} of"):
        run_training(Descent(broken_from), Schedule(6, 6, 2), "descent", checkpoint)
    restored = checkpoint.load()
    assert restored is not None
    assert restored[1]["iteration"] == broken_from - 1
    assert torch.isfinite(restored[0]["place"])


def test_what_a_preparation_leaves_is_saved_only_where_it_is_finite(tmp_path: Path) -> None:
    descent, checkpoint = Descent(), Checkpoint(tmp_path, "key")

    def spoil() -> None:
        descent.place = torch.tensor(torch.nan)

    with pytest.raises(TrainingDiverged, match="place is no longer finite after iteration 0 of descent"):
        run_training(descent, Schedule(6, 6, 2), "descent", checkpoint, prepare=[spoil])
    assert checkpoint.load() is None


def test_a_short_training_that_diverges_ends_soon() -> None:
    taken: list[int] = []

    def step(iteration: int) -> dict[str, Tensor]:
        taken.append(iteration)
        return {"loss": torch.tensor(torch.nan if iteration == 5 else 1.0)}

    with pytest.raises(TrainingDiverged, match="the loss of lessons became nan at iteration 6"):
        take_steps(step, 1000, "lessons")
    assert taken == [*range(100)]


def test_the_last_steps_of_a_short_training_are_looked_at_too() -> None:
    losses = iter([1.0] * 129 + [torch.inf])
    with pytest.raises(TrainingDiverged, match="became inf at iteration 130"):
        take_steps(lambda _iteration: {"loss": torch.tensor(next(losses))}, 130, "lessons")
