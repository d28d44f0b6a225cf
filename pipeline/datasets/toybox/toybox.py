"""The embedded toybox: random photographs of cars, chairs, aeroplanes and horses, with their ground truth."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
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
from pipeline.seeding import numpy_generator

CHUNK = 32


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
    """How many photographs to take.

    Attributes:
        seed: of everything random.
        train_count: photographs of each category in the training split.
        test_count: photographs of each category in the test split.
        photograph: size and camera.
    """

    seed: int
    train_count: int
    test_count: int
    photograph: PhotographConfig


def make_toybox(config: ToyboxConfig) -> Dataset:
    """Photograph every category. The same seed gives the same bytes on the same machine."""
    counts = {"train": config.train_count, "test": config.test_count}
    images = {split: {} for split in counts}
    truth = {split: {} for split in counts}
    for split, count in counts.items():
        for category in tqdm(CATEGORIES, desc=f"toybox {split}", disable=None):
            images[split][category], truth[split][category] = _photograph_category(config, split, category, count)
    return Dataset(images, truth)


def _photograph_category(
    config: ToyboxConfig, split: str, category: str, count: int
) -> tuple[UInt8[np.ndarray, "_ H W 3"], GroundTruth]:
    """Photograph chunk by chunk, each with a stream of its own, so that a larger split begins with the smaller one."""
    build, viewpoints, setting = CATEGORIES[category]
    images, truths = [], []
    for start in range(0, count, CHUNK):
        rng = numpy_generator(config.seed, "toybox", split, category, start)
        taken, truth = photograph(build(CHUNK, rng), viewpoints, setting, config.photograph, rng)
        images.append(taken)
        truths.append(truth)
    joined = concatenate(truths)
    kept = {name: values[:count] for name, values in joined._asdict().items()} | {"faces": joined.faces}
    return np.concatenate(images)[:count], GroundTruth(**kept)
