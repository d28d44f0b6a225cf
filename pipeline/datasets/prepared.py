"""What every source of pictures is brought into, and how it is written."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import UInt8

from pipeline.datasets.truth import GroundTruth, Viewpoints
from pipeline.files import atomic_path, write_json

SPLITS = ("train", "test")


class Dataset(NamedTuple):
    """Pictures in the splits `train` and `test`, by category, and the ground truth of those that have one.

    Pictures are RGB and all of one square size; both splits have the same categories.
    """

    images: Mapping[str, Mapping[str, UInt8[np.ndarray, "_ H W 3"]]]
    truth: Mapping[str, Mapping[str, GroundTruth | Viewpoints]]


def write_images(folder: Path, dataset: Dataset) -> None:
    """Write `<split>/<category>.npy` and `index.json` (categories, counts, size), all or nothing."""
    counts = {split: {name: len(images) for name, images in group.items()} for split, group in dataset.images.items()}
    size = next(iter(dataset.images["train"].values())).shape[1]
    with atomic_path(folder) as temporary:
        for split, group in dataset.images.items():
            (temporary / split).mkdir(parents=True)
            for category, images in group.items():
                np.save(temporary / split / f"{category}.npy", np.ascontiguousarray(images))
        write_json(temporary / "index.json", {"categories": sorted(counts["train"]), "counts": counts, "size": size})


def write_truth(folder: Path, dataset: Dataset) -> None:
    """Write `<split>/<category>.npz` and `index.json`, the list of categories whose truth is known, all or nothing."""
    with atomic_path(folder) as temporary:
        temporary.mkdir()
        for split, group in dataset.truth.items():
            (temporary / split).mkdir()
            for category, truth in group.items():
                np.savez(temporary / split / f"{category}.npz", **truth._asdict())
        write_json(temporary / "index.json", sorted({name for group in dataset.truth.values() for name in group}))
