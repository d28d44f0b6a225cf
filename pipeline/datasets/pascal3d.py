"""PASCAL3D+ release 1.1 (Xiang et al. 2014) under the protocol of "Viewpoints and Keypoints" (Tulsiani & Malik 2015).

Objects that are neither truncated, occluded nor difficult are cut to their true boxes. Those of PASCAL VOC 2012's
training list and of both of ImageNet's lists are for training, those of VOC's validation list for testing.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import NamedTuple

import numpy as np
from jaxtyping import UInt8
from tqdm import tqdm

from pipeline.datasets.annotations import AnnotatedObject, read_objects
from pipeline.datasets.archives import is_hidden, read_files
from pipeline.datasets.decoding import cut_boxes
from pipeline.datasets.folder import ENDINGS
from pipeline.datasets.prepared import SPLITS, Dataset
from pipeline.datasets.truth import Viewpoints, viewpoints_of_boxes
from pipeline.errors import ConfigError, DataError
from pipeline.ranges import Count

ANNOTATIONS = "Annotations/*_pascal/*.mat"
VOC_LISTS = {"train": "VOC2012/ImageSets/Main/train.txt", "test": "VOC2012/ImageSets/Main/val.txt"}


@dataclass(frozen=True)
class Pascal3dConfig:
    """What becomes of the pictures."""

    size: Count
    """Pixels a side; smaller objects are enlarged."""
    categories: tuple[str, ...]
    """Names of those that are read."""

    def __post_init__(self) -> None:
        """Raise ConfigError where nothing would be read."""
        if not self.categories:
            raise ConfigError("categories is empty; expected at least one")


class Key(NamedTuple):
    """Names a picture and its annotation: `Images/<category>_<source>/<id>.*`, `Annotations/.../<id>.mat`."""

    category: str
    source: str
    id: str


class Texts(NamedTuple):
    """What the release says: the objects of each picture, none where all are left out, and the ids of each list."""

    objects: Mapping[Key, Sequence[AnnotatedObject]]
    lists: Mapping[str, Sequence[str]]


def read_pascal3d(path: Path, config: Pascal3dConfig) -> Dataset:
    """Read the categories from the release's folder or an archive of it; pictures stand in the order of their names.

    Raises DataError, naming the file, where a list, an annotation or a picture is missing or cannot be used.
    """
    texts = _read_texts(path, config.categories)
    keys = {
        split: {category: _keys(path, texts, split, category) for category in config.categories} for split in SPLITS
    }
    wanted = {key for group in keys.values() for listed in group.values() for key in listed}
    cuts = _cut_pictures(path, {key: texts.objects[key] for key in wanted}, config.size)
    images = {
        split: {category: np.stack([cut for key in listed for cut in cuts[key]]) for category, listed in group.items()}
        for split, group in keys.items()
    }
    truth = {
        split: {category: _truth(texts, listed) for category, listed in group.items()} for split, group in keys.items()
    }
    return Dataset(images, truth)


def _read_texts(path: Path, categories: Sequence[str]) -> Texts:
    patterns = [*VOC_LISTS.values(), *(pattern for category in categories for pattern in _imagenet_lists(category))]
    objects: dict[Key, Sequence[AnnotatedObject]] = {}
    lists: dict[str, Sequence[str]] = {}

    def wanted(name: PurePosixPath) -> bool:
        is_annotation = _key(name, "Annotations", categories) is not None and name.suffix == ".mat"
        return not is_hidden(name) and (is_annotation or any(name.match(pattern) for pattern in patterns))

    for name, content in tqdm(read_files(path, wanted), f"reading annotations of {path.name}", disable=None):
        key = _key(name, "Annotations", categories)
        if key is None:
            pattern = next(pattern for pattern in patterns if name.match(pattern))
            listed = content.decode("utf-8", "backslashreplace").split()  # other characters name no picture
            _require_once(lists.setdefault(pattern, listed) == listed, f"{path}: {name}")
        else:
            found = read_objects(content, f"{path}: {name}", key.category, key.source == "pascal")
            _require_once(objects.setdefault(key, found) == found, f"{path}: {name}")
    for pattern in patterns:
        if pattern not in lists:
            raise DataError(f"{path} has no {pattern}; expected release 1.1 of PASCAL3D+ with the lists of VOC 2012")
    return Texts(objects, lists)


def _require_once(same: bool, name: str) -> None:
    """Refuse what a release has at several depths, unless it is the same."""
    if not same:
        raise DataError(f"{name} is in the release twice, with different content; remove one of them")


def _imagenet_lists(category: str) -> list[str]:
    return [f"Image_sets/{category}_imagenet_{part}.txt" for part in ("train", "val")]


def _key(name: PurePosixPath, kind: str, categories: Sequence[str]) -> Key | None:
    """Take a picture's or an annotation's path apart; None for any other."""
    if len(name.parts) < 3 or name.parts[-3] != kind:
        return None
    category, _, source = name.parts[-2].rpartition("_")
    return Key(category, source, name.stem) if category in categories and source in ("pascal", "imagenet") else None


def _keys(path: Path, texts: Texts, split: str, category: str) -> list[Key]:
    """List the pictures of a split that show an object; VOC's lists name those of other categories too."""
    keys = [Key(category, "pascal", name) for name in texts.lists[VOC_LISTS[split]]]
    keys = [key for key in keys if key in texts.objects]
    for pattern in _imagenet_lists(category) if split == "train" else ():
        listed = [Key(category, "imagenet", name) for name in texts.lists[pattern]]
        missing = [key.id for key in listed if key not in texts.objects]
        if missing:
            raise DataError(f"{path} has no Annotations/{category}_imagenet/{missing[0]}.mat, which {pattern} names")
        keys += listed
    keys = sorted(key for key in set(keys) if texts.objects[key])
    if not keys:
        raise DataError(
            f"{path} has no whole, visible '{category}' with a viewpoint for the split {split}; expected some, or "
            "another list under prepare_data.pascal3d.categories"
        )
    return keys


def _truth(texts: Texts, keys: Sequence[Key]) -> Viewpoints:
    return viewpoints_of_boxes([found.angles for key in keys for found in texts.objects[key]])


def _cut_pictures(
    path: Path, objects: Mapping[Key, Sequence[AnnotatedObject]], size: int
) -> dict[Key, list[UInt8[np.ndarray, "size size 3"]]]:
    categories = sorted({key.category for key in objects})

    def wanted(name: PurePosixPath) -> bool:
        key = _key(name, "Images", categories)
        return not is_hidden(name) and name.suffix.lower() in ENDINGS and key in objects

    cuts: dict[Key, list[UInt8[np.ndarray, "size size 3"]]] = {}
    for name, content in tqdm(read_files(path, wanted), f"cutting {path.name}", total=len(objects), disable=None):
        key = _key(name, "Images", categories)
        if key is not None:
            parts = cut_boxes(content, f"{path}: {name}", [found.box for found in objects[key]], size)
            _require_once(all(map(np.array_equal, cuts.setdefault(key, parts), parts)), f"{path}: {name}")
    for key in sorted(objects):
        if key not in cuts:
            raise DataError(f"{path} has no picture Images/{key.category}_{key.source}/{key.id}, which is annotated")
    return cuts
