"""Compare two processes with one that has the threads of both, on a CPU at laptop size: a shared batch, and two seeds.

`extra_info` holds the ratio of throughputs, above 1 where two processes are faster (goal for a shared batch: at least
1), the seconds behind it and how losses differ: those of the first step by rounding, later ones by more, because Adam's
first steps are as large for gradients that are rounding. Orders alternate, so that other work on the machine hits both
alike.
"""

from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import pytest
import torch
from pytest_benchmark.fixture import BenchmarkFixture

from benchmarks.bench_training import PARAMETERS, trainer_of
from pipeline.config import load
from pipeline.distributed import divide, is_first
from pipeline.files import read_json, write_json
from pipeline.geometry.sphere import build_sphere
from pipeline.launch import share_work
from pipeline.networks.feature_extractor import FeatureExtractor
from pipeline.networks.wide_resnet import WideResNet
from pipeline.seeding import generator, initialised
from pipeline.training.base_shape import BaseShapeConfig, SeedTrainer
from pipeline.training.photographs import Photographs

SECTIONS = ("learn_base_shape", "rows.toybox-car.learn_base_shape", "sizes.laptop.learn_base_shape")
CPU = torch.device("cpu")
ORDER = (1, 2, 2, 1)
STEPS = 3


def share_batches(out: Path) -> None:
    """Time steps of full training whose batches the processes share."""
    trainer = trainer_of("laptop", CPU)
    first = trainer.step(0)["loss"].item()
    start = perf_counter()
    losses = [trainer.step(iteration)["loss"].item() for iteration in range(1, 1 + STEPS)]
    _write(out, start, [first, *losses])


def divide_seeds(out: Path) -> None:
    """Time steps of base-shape learning from two seeds, which the processes divide."""
    config = load(PARAMETERS, BaseShapeConfig, SECTIONS)
    with initialised(0):
        extractor = FeatureExtractor(WideResNet(16, 2, 4), color_weight=60.0)
    pictures = torch.randint(0, 256, (256, 3, 32, 32), generator=generator(0)).to(torch.uint8)
    photographs = Photographs(pictures, extractor, 64, memory=2**30)
    sphere = build_sphere(config.subdivisions, CPU)

    def learn(index: int) -> list[float]:
        trainer = SeedTrainer(config, sphere, photographs, 0, index)
        return [trainer.step(iteration)["reconstruction"].item() for iteration in range(STEPS)]

    divide(lambda _: SeedTrainer(config, sphere, photographs, 1, 0).step(0), 2)
    start = perf_counter()
    _write(out, start, [loss for losses in divide(learn, 2) for loss in losses])


def _write(out: Path, start: float, losses: list[float]) -> None:
    seconds = perf_counter() - start
    if is_first():
        write_json(out, {"seconds": seconds, "losses": losses})


@pytest.mark.parametrize("work", [share_batches, divide_seeds])
def test_two_processes_against_one(benchmark: BenchmarkFixture, work: Callable[[Path], None], tmp_path: Path) -> None:
    def compare() -> None:
        for number, processes in enumerate(ORDER):
            share_work(processes, CPU, work, tmp_path / f"{number}.json")

    benchmark.pedantic(compare, rounds=1)
    measured = [read_json(tmp_path / f"{number}.json") for number in range(len(ORDER))]
    seconds = {
        count: [one["seconds"] for one, own in zip(measured, ORDER, strict=True) if own == count] for count in (1, 2)
    }
    losses = torch.tensor([one["losses"] for one in measured])
    benchmark.extra_info |= {
        "two_processes_over_one": round(sum(seconds[1]) / sum(seconds[2]), 3),
        "seconds": seconds,
        "threads": torch.get_num_threads(),
        "difference_of_first_losses": (losses - losses[0])[:, 0].abs().max().item(),
        "largest_difference_of_losses": (losses - losses[0]).abs().max().item(),
    }
