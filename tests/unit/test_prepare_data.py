"""prepare_data writes everything or, after one sentence, nothing."""

import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

from pipeline.datasets.images import load_images, load_images_of_size, load_images_to_reduce
from pipeline.errors import DataError
from pipeline.files import read_json
from pipeline.rows.entries import NAMES
from stages import prepare_data
from stages.command_line import run
from tests.picture_trees import noise, picture, tree, write_folder, write_tar

CAMERA = {"distance": 2.7, "field_of_view": 30}
TOYBOX = {
    "seed": 0,
    "train_count": 3,
    "test_count": 2,
    "photograph": {"size": 32, "supersampling": 2, "camera": CAMERA},
}
MD5 = "c58f30108f718f92721af3b95e74349a"


@pytest.fixture
def prepare(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Path]:
    """Run the stage on a source and return the folder of its outputs."""

    def run_stage(kind: str, source: Path, **changes: object) -> Path:
        out = tmp_path / "out"
        section = {"toybox": TOYBOX, "cifar10": {"md5": MD5}, "folder": {"size": 32, "fit": "crop"}}
        section["posed_folder"] = {"size": 32, "fit": "pad"}
        section["pascal3d"] = {"size": 32, "categories": ["car"]}
        params: dict[str, object] = {entries: {} for entries in NAMES}
        params |= {"prepare_data": section, "datasets": {"mine": {"kind": kind, "source": str(source), **changes}}}
        (tmp_path / "params.yaml").write_text(yaml.safe_dump(params), encoding="utf-8")
        arguments = ["--params", str(tmp_path / "params.yaml"), "--sections", f"prepare_data.{kind}"]
        arguments += ["datasets.mine", "--dataset", "mine"]
        outputs = ["--out", str(out / "prepared"), "--truth", str(out / "truth")]
        monkeypatch.setattr(sys, "argv", ["prepare_data", *arguments, *outputs])
        run(prepare_data.main)
        return out

    return run_stage


def test_photographs_become_arrays(tmp_path: Path, prepare: Callable[..., Path]) -> None:
    out = prepare("folder", write_folder(tmp_path / "pictures", tree()))
    images = np.load(out / "prepared" / "train" / "car.npy")
    assert (images.shape, images.dtype, images.flags.c_contiguous) == ((2, 32, 32, 3), np.uint8, True)
    assert read_json(out / "prepared" / "index.json") == {
        "categories": ["car", "horse"],
        "counts": {"test": {"car": 2, "horse": 2}, "train": {"car": 2, "horse": 2}},
        "size": 32,
    }
    assert read_json(out / "truth" / "index.json") == []
    loaded = load_images(out / "prepared" / "train" / "car.npy")
    np.testing.assert_array_equal(loaded.permute(0, 2, 3, 1).numpy(), images)


def test_the_toybox_has_its_truth(tmp_path: Path, prepare: Callable[..., Path]) -> None:
    out = prepare("toybox", tmp_path)
    categories = read_json(out / "truth" / "index.json")
    assert categories == read_json(out / "prepared" / "index.json")["categories"]
    for category in categories:
        with np.load(out / "truth" / "train" / f"{category}.npz", allow_pickle=False) as truth:
            assert truth["masks"].shape == np.load(out / "prepared" / "train" / f"{category}.npy").shape[:3]
            assert {name: truth[name].dtype for name in ("azimuth", "center", "vertices")} == dict.fromkeys(
                ("azimuth", "center", "vertices"), np.dtype(np.float32)
            )


def test_truth_holds_no_date_and_no_version_of_python(tmp_path: Path, prepare: Callable[..., Path]) -> None:
    with zipfile.ZipFile(prepare("toybox", tmp_path) / "truth/train/car.npz") as archive:
        assert {(member.date_time, member.extract_version) for member in archive.infolist()} == {
            ((1980, 1, 1, 0, 0, 0), 20)
        }


def test_a_dataset_may_change_the_size(tmp_path: Path, prepare: Callable[..., Path]) -> None:
    files = {name: picture(width=80, height=60) for name in tree()}
    out = prepare("folder", write_folder(tmp_path / "pictures", files), folder={"size": 48})
    assert np.load(out / "prepared" / "test" / "car.npy").shape == (2, 48, 48, 3)


BAD_TREES = {
    "unreadable": ({"train/car/2.jpg": b"not a picture"}, "cannot be read as a picture"),
    "cut short": ({"train/car/2.jpg": noise(0)[:-400]}, "cannot be read as a picture"),
    "gray": ({"test/horse/2.jpg": picture(mode="L")}, "test/horse/2.jpg has the colour mode L; expected RGB"),
    "too small": ({"train/car/1.jpg": picture(width=31)}, "train/car/1.jpg is 31x32 px; expected at least 32 px"),
    "empty category": ({"test/car/1.jpg": None, "test/car/2.jpg": None}, "no pictures in test/car/"),
}


@pytest.mark.parametrize(("changes", "sentence"), BAD_TREES.values(), ids=list(BAD_TREES))
@pytest.mark.parametrize("form", ["folder", "tar"])
def test_bad_pictures_end_in_one_sentence(
    tmp_path: Path, prepare: Callable[..., Path], changes: dict[str, bytes | None], sentence: str, form: str
) -> None:
    files = tree(**changes)
    folder, archive = tmp_path / "pictures", tmp_path / "pictures.tar"
    source = write_folder(folder, files) if form == "folder" else write_tar(archive, files)
    assert_refused(prepare, "folder", source, sentence)


def test_path_tricks_end_in_one_sentence(tmp_path: Path, prepare: Callable[..., Path]) -> None:
    archive = write_tar(tmp_path / "pictures.tar.gz", tree() | {"../../outside/train/car/1.jpg": noise(0)})
    assert_refused(prepare, "folder", archive, "points outside of the archive")
    assert not list(tmp_path.parent.rglob("outside"))


@pytest.mark.parametrize("ending", ["tar", "tar.gz", "tar.xz"])
def test_a_truncated_archive_ends_in_one_sentence(tmp_path: Path, prepare: Callable[..., Path], ending: str) -> None:
    archive = write_tar(tmp_path / f"pictures.{ending}", tree())
    archive.write_bytes(archive.read_bytes()[:5000])
    assert_refused(prepare, "folder", archive, "is not a complete tar or zip archive")


def test_a_wrong_checksum_ends_in_one_sentence(tmp_path: Path, prepare: Callable[..., Path]) -> None:
    archive = write_tar(tmp_path / "cifar-10-python.tar.gz", {"cifar-10-batches-py/test_batch": b"x"})
    assert_refused(prepare, "cifar10", archive, f"expected {MD5}")


def test_earlier_outputs_survive_bad_input(tmp_path: Path, prepare: Callable[..., Path]) -> None:
    out = prepare("folder", write_folder(tmp_path / "pictures", tree()))
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    with pytest.raises(SystemExit):
        prepare("folder", write_folder(tmp_path / "pictures", {"train/car/3.jpg": b"x"}))
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before


def test_an_unprepared_category_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"van.npy does not exist; run prepare_data"):
        load_images(tmp_path / "van.npy")


def test_pictures_of_another_size_than_the_renderings_are_named(tmp_path: Path) -> None:
    np.save(tmp_path / "car.npy", np.zeros((2, 32, 32, 3), dtype=np.uint8))
    assert load_images_of_size(tmp_path / "car.npy", 32).shape == (2, 3, 32, 32)
    sentence = r"car.npy holds pictures of 32 px, but renderer.size is 64; prepare the photographs under another name"
    with pytest.raises(DataError, match=sentence):
        load_images_of_size(tmp_path / "car.npy", 64)
    assert load_images_to_reduce(tmp_path / "car.npy", 16).shape == (2, 3, 32, 32)
    for size in (24, 64):
        with pytest.raises(DataError, match=f"holds pictures of 32 px, but renderer.size is {size}"):
            load_images_to_reduce(tmp_path / "car.npy", size)


def assert_refused(prepare: Callable[..., Path], kind: str, source: Path, sentence: str) -> None:
    with pytest.raises(SystemExit) as caught:
        prepare(kind, source)
    message = str(caught.value.code)
    assert message.startswith(f"error: {source}")
    assert sentence in message
    assert "\n" not in message
    assert not list((source.parent / "out").rglob("*"))
