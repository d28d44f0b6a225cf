"""Time one step of full training at laptop size, and the share of it that is spent outside networks.

The share is written into the benchmark's `extra_info`; the goal is at most 0.15.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import torch
from pytest_benchmark.fixture import BenchmarkFixture
from torch import nn
from torch.autograd.profiler_util import FunctionEvent
from torch.profiler import profile, record_function

from pipeline.config import load
from pipeline.geometry.icosphere import icosphere
from pipeline.networks.feature_extractor import FeatureExtractor
from pipeline.networks.wide_resnet import WideResNet
from pipeline.rendering.renderer import Mesh
from pipeline.seeding import generator, initialised
from pipeline.training.full import FullTrainer, FullTrainingConfig
from pipeline.training.photographs import Photographs

PARAMETERS = Path(__file__).parents[1] / "params.yaml"
SECTIONS = ("train_full", "rows.toybox-car.train_full", "sizes.laptop.train_full")
NETWORK, STEP = "a network's forward", "a step"


def laptop_trainer() -> FullTrainer:
    """Build a trainer whose extractor has random weights: they do not change the time."""
    config = load(PARAMETERS, FullTrainingConfig, SECTIONS)
    directions, faces = icosphere(3)
    base = Mesh(directions[None] * torch.tensor([0.25, 0.25, 0.5]), faces, directions)
    with initialised(0):
        extractor = FeatureExtractor(WideResNet(16, 2, 4), color_weight=20.0)
    pictures = torch.randint(0, 256, (256, 3, 32, 32), generator=generator(0)).to(torch.uint8)
    return FullTrainer(config, Photographs(pictures, extractor, 64, memory=2**30), extractor, base, seed=0)


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


def test_full_training_step(benchmark: BenchmarkFixture) -> None:
    trainer = laptop_trainer()
    iterations = iter(range(1000))
    benchmark.pedantic(lambda: trainer.step(next(iterations)), rounds=5, warmup_rounds=2)
    shares = sorted(share_outside_networks(trainer, next(iterations)) for _ in range(5))
    benchmark.extra_info["share_outside_networks"] = round(shares[2], 3)
    benchmark.extra_info["threads"] = torch.get_num_threads()
