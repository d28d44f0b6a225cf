"""The embedded toybox: random photographs of cars, chairs, aeroplanes and horses, with their ground truth."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import UInt8
from tqdm import tqdm

from pipeline.datasets.prepared import Dataset
from pipeline.datasets.toybox.aeroplane import build_aeroplanes
from pipeline.datasets.toybox.car import build_cars
from pipeline.datasets.toybox.chair import build_chairs
from pipeline.datasets.toybox.horse import build_horses
from pipeline.datasets.toybox.model import Specimens
from pipeline.datasets.toybox.photograph import PhotographConfig, photograph
from pipeline.datasets.toybox.surroundings import Setting
from pipeline.datasets.toybox.views import ViewRange
from pipeline.datasets.truth import GroundTruth, concatenate
from pipeline.launch import process_pool
from pipeline.ranges import Count, Natural
from pipeline.seeding import numpy_generator

CHUNK = 32
_CHUNKS_WORTH_A_PROCESS = 32
"""Fewer are taken in less time than another process needs to start."""


class Category(NamedTuple):
    """How the objects of one category are built and seen."""

    build: Callable[[int, np.random.Generator], Specimens]
    viewpoints: ViewRange
    setting: Setting


CATEGORIES = {
    "aeroplane": Category(
        build_aeroplanes, ViewRange((-60, 60), side_views=True, roll=8, fill=0.9), Setting(0.08, 0.0, 0.5)
    ),
    "car": Category(build_cars, ViewRange((0, 30), side_views=False, roll=2, fill=0.97), Setting(0.13, 0.0, 0.0)),
    "chair": Category(build_chairs, ViewRange((0, 30), side_views=False, roll=2, fill=0.9), Setting(0.2, 0.6, 0.0)),
    "horse": Category(build_horses, ViewRange((-10, 10), side_views=True, roll=2, fill=0.93), Setting(0.06, 0.0, 0.0)),
}


@dataclass(frozen=True)
class ToyboxConfig:
    """How many photographs to take."""

    seed: Natural
    """Of everything random."""
    train_count: Count
    """Photographs of each category in the training split."""
    test_count: Count
    """Photographs of each category in the test split."""
    photograph: PhotographConfig
    """Size and camera."""


class Chunk(NamedTuple):
    """Photographs that are taken with a random stream of their own, so that a larger split begins with a smaller."""

    split: str
    category: str
    start: int


Taken = tuple[UInt8[np.ndarray, "_ H W 3"], GroundTruth]


def make_toybox(config: ToyboxConfig) -> Dataset:
    """Photograph every category, by as many processes as there are threads; their number changes no byte.

    The same seed gives the same bytes on the same machine. Raises ProcessKilled where a signal ended a process.
    """
    counts = {"train": config.train_count, "test": config.test_count}
    chunks = [
        Chunk(split, category, start)
        for split, count in counts.items()
        for category in CATEGORIES
        for start in range(0, count, CHUNK)
    ]
    taken = dict(zip(chunks, _photograph_all(config, chunks), strict=True))
    images = {split: {} for split in counts}
    truth = {split: {} for split in counts}
    for split, count in counts.items():
        for category in CATEGORIES:
            parts = [part for chunk, part in taken.items() if chunk[:2] == (split, category)]
            images[split][category], truth[split][category] = _join(parts, count)
    return Dataset(images, truth)


def _photograph_all(config: ToyboxConfig, chunks: list[Chunk]) -> list[Taken]:
    take = partial(_photograph_chunk, config)
    progress = partial(tqdm, desc="toybox", total=len(chunks), disable=None)
    processes = min(torch.get_num_threads(), len(chunks) // _CHUNKS_WORTH_A_PROCESS)
    if processes < 2:
        return [take(chunk) for chunk in progress(chunks)]
    with process_pool(processes, "made the toybox") as pool:
        return list(progress(pool.map(take, chunks)))


def _photograph_chunk(config: ToyboxConfig, chunk: Chunk) -> Taken:
    build, viewpoints, setting = CATEGORIES[chunk.category]
    rng = numpy_generator(config.seed, "toybox", *chunk)
    return photograph(build(CHUNK, rng), viewpoints, setting, config.photograph, rng)


def _join(parts: list[Taken], count: int) -> Taken:
    """Put chunks together and keep the first `count` photographs."""
    joined = concatenate([truth for _, truth in parts])
    kept = {name: values[:count] for name, values in joined._asdict().items()} | {"faces": joined.faces}
    return np.concatenate([images for images, _ in parts])[:count], GroundTruth(**kept)
