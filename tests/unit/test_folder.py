"""Users' own photographs are found by split and category."""

import io
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pipeline.datasets import archives
from pipeline.datasets.folder import FolderConfig, read_folder
from pipeline.datasets.prepared import write_pictures
from pipeline.errors import DataError
from tests.picture_trees import noise, tree, write_folder, write_tar, write_zip

CONFIG = FolderConfig(size=32, fit="crop")


def test_pictures_are_stacked_in_the_order_of_their_names(tmp_path: Path) -> None:
    files = tree()
    backwards = dict(reversed(files.items()))
    names = write_pictures(tmp_path, read_folder(write_tar(tmp_path / "pictures.tar", backwards), CONFIG))
    assert names == {split: {name: ["1.jpg", "2.jpg"] for name in ("car", "horse")} for split in ("train", "test")}
    in_memory = np.stack([np.asarray(Image.open(io.BytesIO(files[f"test/horse/{name}.jpg"]))) for name in (1, 2)])
    np.save(tmp_path / "expected.npy", in_memory)
    assert (tmp_path / "test/horse.npy").read_bytes() == (tmp_path / "expected.npy").read_bytes()
    assert not list(tmp_path.rglob(".partial-*"))


def test_two_pictures_of_one_name_are_refused(tmp_path: Path) -> None:
    files = tree() | {"more/train/car/1.jpg": noise(0)}
    with pytest.raises(DataError, match=r"there are two pictures train/car/1\.jpg; rename or remove one"):
        write_pictures(tmp_path / "out", read_folder(write_folder(tmp_path / "in", files), CONFIG))


def test_an_outer_folder_and_other_files_do_no_harm(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = {f"photographs/{name}": content for name, content in tree().items()}
    files |= {
        "photographs/README.md": b"ours",
        "photographs/train/car/.DS_Store": b"",
        "photographs/train/car/._1.jpg": b"x",
    }
    pictures = list(read_folder(write_folder(tmp_path, files), CONFIG))
    assert Counter((picture.split, picture.category) for picture in pictures) == {
        (split, category): 2 for split in ("train", "test") for category in ("car", "horse")
    }
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("write", [write_folder, write_tar])
def test_what_may_have_been_meant_as_a_picture_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], write: Callable[[Path, dict[str, bytes]], Path]
) -> None:
    files = tree() | {"train/car/3.gif": noise(1), "test/car/more/4.jpg": noise(2), "labels.csv": b"", "notes.jpg": b""}
    assert len(list(read_folder(write(tmp_path / "pictures.tar", files), CONFIG))) == len(tree())
    told = capsys.readouterr().err
    assert "left out 2 files, such as t" in told
    assert "3.gif" in told or "4.jpg" in told


@pytest.mark.parametrize("write", [write_folder, write_tar, write_zip])
def test_what_is_no_picture_of_a_category_is_not_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, write: Callable[[Path, dict[str, bytes]], Path]
) -> None:
    monkeypatch.setattr(archives, "LARGEST", 2**16)
    other = {name: bytes(2**17) for name in ("train/images", "train/images.zip", "photos/1.jpg", "train/car/._1.jpg")}
    source = write(tmp_path / "pictures", tree() | other)
    if source.is_dir():
        monkeypatch.setattr(Path, "read_bytes", _read_small)
        (source / "train/car/.#1.jpg").symlink_to("gone")  # as Emacs marks what it edits
    assert len(list(read_folder(source, CONFIG))) == len(tree())


def _read_small(path: Path) -> bytes:
    with path.open("rb") as stream:
        content = stream.read()
    assert len(content) <= 2**16, path
    return content


def test_folders_are_not_counted_as_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_folder(tmp_path, tree())
    (folder / "train/car/v1.2").mkdir()
    assert len(list(read_folder(folder, CONFIG))) == len(tree())
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("around", ["test", "train"])
@pytest.mark.parametrize("write", [write_folder, write_tar])
def test_an_outer_folder_may_be_called_as_a_split(
    tmp_path: Path, around: str, write: Callable[[Path, dict[str, bytes]], Path]
) -> None:
    files = {f"{around}/{name}": content for name, content in tree().items()}
    source = write(tmp_path / "pictures.tar", files | {f"{around}/train/labels.csv": b"", f"{around}/test/NOTES": b""})
    assert len(list(read_folder(source, CONFIG))) == len(files)


def test_a_folder_between_two_splits_is_no_category(tmp_path: Path) -> None:
    files = {f"test/photographs.d/{name}": content for name, content in tree().items()}
    pictures = list(read_folder(write_folder(tmp_path, files), CONFIG))
    assert {picture.category for picture in pictures} == {"car", "horse"}


def test_a_category_may_be_called_as_a_split(tmp_path: Path) -> None:
    files = {f"{split}/train/{number}.jpg": noise(number) for split in ("train", "test") for number in (1, 2)}
    pictures = read_folder(write_folder(tmp_path, files), CONFIG)
    assert Counter((picture.split, picture.category) for picture in pictures) == {
        (split, "train"): 2 for split in ("train", "test")
    }


def test_an_empty_category_is_named(tmp_path: Path) -> None:
    folder = write_folder(tmp_path, tree())
    (folder / "train" / "dog").mkdir()
    with pytest.raises(DataError, match=r"no pictures in train/dog/; expected at least one"):
        list(read_folder(folder, CONFIG))


def test_a_category_missing_from_the_test_split_is_named(tmp_path: Path) -> None:
    files = tree(**{"test/car/1.jpg": None, "test/car/2.jpg": None})
    with pytest.raises(DataError, match=r"no pictures in test/car/"):
        list(read_folder(write_folder(tmp_path, files), CONFIG))


def test_pictures_of_another_form_are_told_before_they_are_missed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = {"train/car/1.gif": b"x", "test/car/1.gif": b"x"}
    with pytest.raises(DataError, match=r"no pictures in train/car/; expected at least one"):
        list(read_folder(write_folder(tmp_path, files), CONFIG))
    assert "left out 2 files, such as test/car/1.gif; pictures are read at" in capsys.readouterr().err


def test_another_arrangement_is_explained(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"no pictures at train/<category>/ and test/<category>/"):
        list(read_folder(write_folder(tmp_path, {"car/1.jpg": b"x"}), CONFIG))
