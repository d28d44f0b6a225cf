"""Time one step of full training, with the two floors below it, its ten largest items and the share outside networks.

They are written into the benchmark's `extra_info`. Goals: at paper size on a GPU 15 ms, and half of that the larger
floor; on a CPU a share outside networks of at most 0.15. A step at paper size takes 4 to 20 seconds on two cores.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path

import pytest
import torch
from pytest_benchmark.fixture import BenchmarkFixture
from torch import nn
from torch.autograd.profiler_util import FunctionEvent
from torch.profiler import profile, record_function

from benchmarks.measuring import DEVICE, ON_GPU, complete, floors, largest_items
from pipeline.config import load
from pipeline.device import resolve_precision
from pipeline.geometry.icosphere import icosphere
from pipeline.networks.feature_extractor import FeatureExtractor
from pipeline.networks.wide_resnet import WideResNet
from pipeline.rendering.renderer import Mesh
from pipeline.seeding import generator, initialised
from pipeline.training.full_trainer import FullTrainer, FullTrainingConfig
from pipeline.training.photographs import Photographs

PARAMETERS = Path(__file__).parents[1] / "params.yaml"
WIDTHS = {"laptop": 2, "paper": 4}
"""Of the extractor at each size."""
NETWORK, STEP = "a network's forward", "a step"


def trainer_of(size: str, device: torch.device = DEVICE) -> FullTrainer:
    """Build a trainer whose extractor has random weights: they do not change the time."""
    sections = ("train_full", "rows.cifar10-automobile.train_full", f"sizes.{size}.train_full")
    config = load(PARAMETERS, FullTrainingConfig, sections)
    directions, faces = (part.to(device) for part in icosphere(3))
    base = Mesh(directions[None] * directions.new_tensor([0.25, 0.25, 0.5]), faces, directions)
    with initialised(0):
        extractor = FeatureExtractor(WideResNet(16, WIDTHS[size], 4), color_weight=60.0)
    extractor.to(device, resolve_precision("auto", device))
    pictures = torch.randint(0, 256, (256, 3, 32, 32), generator=generator(0)).to(device, torch.uint8)
    return FullTrainer(config, Photographs(pictures, extractor, 64, memory=2**30), base, seed=0)


def networks(trainer: FullTrainer) -> list[nn.Module]:
    """List every network a step runs."""
    model = trainer.model
    decoders = [model.shape_decoder, *model.pose_decoder.heads, model.pose_decoder.student]
    generators = [model.texture_decoder, model.background_decoder]
    encoders = [model.shape_encoder, model.pose_encoder, model.texture_encoder, model.background_encoder]
    return [*encoders, *decoders, *generators, trainer.discriminator, trainer.extractor]


@contextmanager
def marked(modules: list[nn.Module]) -> Iterator[None]:
    """Mark the modules' forward passes in the profile."""
    ranges: list[record_function] = []

    def begin(*_: object) -> None:
        ranges.append(record_function(NETWORK))
        ranges[-1].__enter__()

    def end(*_: object) -> None:
        ranges.pop().__exit__(None, None, None)

    handles = [hook for m in modules for hook in (m.register_forward_pre_hook(begin), m.register_forward_hook(end))]
    yield
    for handle in handles:
        handle.remove()


def share_outside_networks(trainer: FullTrainer, iteration: int) -> float:
    """Profile one step and return the share of its time that is no network's forward or backward.

    A backward operation belongs to a network if the forward operation with the same sequence number does.
    """
    with marked(networks(trainer)), profile() as profiler, record_function(STEP):
        trainer.step(iteration)
    recorded = profiler.events()
    assert recorded is not None
    events = list(recorded)
    forward = [event for event in events if event.name == NETWORK]
    numbers = {event.sequence_nr for event in events if event.sequence_nr >= 0 and _inside(event, forward)}
    backward = [
        event
        for event in events
        if event.name.startswith("autograd::engine::evaluate_function") and event.sequence_nr in numbers
    ]
    whole = next(event for event in events if event.name == STEP)
    return 1 - sum(event.cpu_time_total for event in [*forward, *backward]) / whole.cpu_time_total


def _inside(event: FunctionEvent, ranges: list[FunctionEvent]) -> bool:
    time = event.time_range
    return any(r.time_range.start <= time.start and time.end <= r.time_range.end for r in ranges)


@pytest.mark.parametrize("size", ["laptop", "paper"])
def test_full_training_step(benchmark: BenchmarkFixture, size: str) -> None:
    trainer = trainer_of(size)
    rounds = 50 if ON_GPU else 5 if size == "laptop" else 1
    iterations = count(trainer.config.iterations // 2)

    def step() -> None:
        trainer.step(next(iterations))

    benchmark.pedantic(complete(step), rounds=rounds, warmup_rounds=5 if ON_GPU else 1)  # a GPU captures the fourth
    benchmark.extra_info["largest_items"] = largest_items(step, 10)
    fresh = trainer_of(size)  # whose first steps are no graph: what a graph does cannot be counted
    precision = fresh.extractor.precision
    benchmark.extra_info["floors"] = floors(lambda: fresh.step(trainer.config.iterations // 2), precision)
    if not ON_GPU:
        shares = sorted(share_outside_networks(trainer, next(iterations)) for _ in range(rounds))
        benchmark.extra_info["share_outside_networks"] = round(shares[rounds // 2], 3)
    benchmark.extra_info["precision"] = str(precision).removeprefix("torch.")
    benchmark.extra_info["threads"] = torch.get_num_threads()
