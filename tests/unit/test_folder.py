"""Users' own photographs are found by split and category."""

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pipeline.datasets.folder import FolderConfig, read_folder
from pipeline.errors import DataError
from tests.picture_trees import tree, write_folder, write_tar

CONFIG = FolderConfig(size=32, fit="crop")


def test_pictures_are_stacked_in_the_order_of_their_names(tmp_path: Path) -> None:
    files = tree()
    backwards = dict(reversed(files.items()))
    dataset = read_folder(write_tar(tmp_path / "pictures.tar", backwards), CONFIG)
    assert {split: sorted(group) for split, group in dataset.images.items()} == {
        "train": ["car", "horse"],
        "test": ["car", "horse"],
    }
    first = np.asarray(Image.open(io.BytesIO(files["test/horse/1.jpg"])))
    np.testing.assert_array_equal(dataset.images["test"]["horse"][0], first)
    assert dataset.truth == {}


def test_an_outer_folder_and_other_files_do_no_harm(tmp_path: Path) -> None:
    files = {f"photographs/{name}": content for name, content in tree().items()}
    files |= {
        "photographs/README.md": b"ours",
        "photographs/train/car/.DS_Store": b"",
        "photographs/train/car/._1.jpg": b"x",
    }
    dataset = read_folder(write_folder(tmp_path, files), CONFIG)
    assert {name: len(images) for name, images in dataset.images["train"].items()} == {"car": 2, "horse": 2}


def test_an_empty_category_is_named(tmp_path: Path) -> None:
    folder = write_folder(tmp_path, tree())
    (folder / "train" / "dog").mkdir()
    with pytest.raises(DataError, match=r"no pictures in train/dog/; expected at least one"):
        read_folder(folder, CONFIG)


def test_a_category_missing_from_the_test_split_is_named(tmp_path: Path) -> None:
    files = tree(**{"test/car/1.jpg": None, "test/car/2.jpg": None})
    with pytest.raises(DataError, match=r"no pictures in test/car/"):
        read_folder(write_folder(tmp_path, files), CONFIG)


def test_another_arrangement_is_explained(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"no pictures at train/<category>/ and test/<category>/"):
        read_folder(write_folder(tmp_path, {"car/1.jpg": b"x"}), CONFIG)
