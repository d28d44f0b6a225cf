"""A source is known by the names of its files."""

from collections.abc import Mapping
from pathlib import Path

import pytest

from pipeline.datasets.survey import survey
from pipeline.errors import DataError
from tests.pascal3d_tree import release
from tests.picture_trees import tree, write_folder, write_tar, write_zip

WRITERS = {"folder": write_folder, "zip": write_zip, "tar.gz": write_tar}


def write(path: Path, form: str, files: Mapping[str, bytes]) -> Path:
    """Write files in a form, below a folder of their own."""
    return WRITERS[form](path / f"source.{form}", {f"release/{name}": content for name, content in files.items()})


@pytest.mark.parametrize("form", WRITERS)
@pytest.mark.parametrize(
    ("files", "kind", "categories"),
    [
        (tree(), "folder", {"car", "horse"}),
        (tree(**{"poses.csv": b""}), "posed_folder", {"car", "horse"}),
        (release(), "pascal3d", set()),
        (
            tree(**{"train/notes.txt": b"", "train/.van/1.jpg": b"", "other/ship/1.jpg": b""}),
            "folder",
            {"car", "horse"},
        ),
        (
            {"train/ship/1.HEIC": b"", "test/ship/1.HEIC": b"", ".old/poses.csv": b"", "__MACOSX/poses.csv": b""},
            "folder",
            {"ship"},
        ),
    ],
)
def test_names_tell_kind_and_categories(
    tmp_path: Path, form: str, files: Mapping[str, bytes], kind: str, categories: set[str]
) -> None:
    path = write(tmp_path, form, files)
    assert survey(path) == (path, kind, categories)


def test_the_official_cifar10_is_not_opened(tmp_path: Path) -> None:
    path = tmp_path / "cifar-10-python.tar.gz"
    path.touch()
    assert survey(path).kind == "cifar10"
    assert {"automobile", "horse"} < survey(path).categories


def test_the_official_cifar10_may_have_another_name(tmp_path: Path) -> None:
    path = write_tar(tmp_path / "cifar10 (1).tar.gz", {"cifar-10-batches-py/test_batch": b"x"})
    assert survey(path).kind == "cifar10"
    own = write_tar(tmp_path / "cifar-10-jpeg.tar.gz", tree())
    assert survey(own) == (own, "folder", {"car", "horse"})


@pytest.mark.parametrize("form", WRITERS)
def test_a_source_without_categories_is_refused(tmp_path: Path, form: str) -> None:
    path = write(tmp_path, form, {"cars/1.jpg": b""})
    with pytest.raises(
        DataError, match="has no pictures at train/<category>/ and test/<category>/; `kato3d arrange` puts"
    ):
        survey(path)


@pytest.mark.parametrize("form", WRITERS)
def test_a_category_without_pictures_in_one_split_is_refused(tmp_path: Path, form: str) -> None:
    path = write(tmp_path, form, tree(**{"test/car/1.jpg": None, "test/car/2.jpg": None}))
    with pytest.raises(DataError, match="has no pictures in test/car/; expected at least one in each split"):
        survey(path)


def test_a_category_s_folder_without_pictures_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path, "folder", tree(**{"train/bus/notes.txt": b""}))
    with pytest.raises(DataError, match="has no pictures in train/bus/; expected at least one in each split"):
        survey(path)


@pytest.mark.parametrize("ending", ["gif", "jfif", "avif"])
def test_pictures_of_another_form_are_told_what_forms_there_are(tmp_path: Path, ending: str) -> None:
    path = write(tmp_path, "folder", {f"{split}/car/1.{ending}": b"" for split in ("train", "test")})
    with pytest.raises(DataError, match=r"in each split, with one of \.bmp \.heic \.heif \.jpeg \.jpg "):
        survey(path)
    path = write(tmp_path, "zip", {f"{split}/car/1.{ending}": b"" for split in ("train", "test")})
    with pytest.raises(DataError, match=r"there; expected \.bmp \.heic \.heif \.jpeg \.jpg .*, or of CIFAR-10"):
        survey(path)


def test_a_damaged_archive_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path, "tar.gz", tree())
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(DataError, match=r"source\.tar\.gz is not a complete tar or zip archive \(.*\); name one, or a"):
        survey(path)
