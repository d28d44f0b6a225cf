"""Photographs with viewpoints: pictures as in a folder, and a table of angles."""

import math
from pathlib import Path

import numpy as np
import pytest

from pipeline.datasets.folder import FolderConfig
from pipeline.datasets.posed_folder import read_angles, viewpoints
from pipeline.datasets.prepare import PrepareConfig, prepare
from pipeline.datasets.prepared import write_truth
from pipeline.datasets.truth import Viewpoints
from pipeline.errors import DataError
from pipeline.evaluation.artifacts import load_truth
from tests.picture_trees import tree, write_folder, write_tar

CONFIG = FolderConfig(size=32, fit="pad")
HEADER = "split,file,azimuth_deg,elevation_deg,roll_deg"


def table(*changed: str) -> bytes:
    rows = [f"{name.split('/')[0]},{name},{10 * index},{index},-1.5" for index, name in enumerate(tree())]
    return "\n".join([HEADER, *changed, *rows[len(changed) :]]).encode()


def test_viewpoints_stand_in_the_order_of_the_pictures(tmp_path: Path) -> None:
    files = {**tree(), "poses.csv": table()}
    source = write_tar(tmp_path / "cars.tar", dict(reversed(files.items())))
    truths = prepare(PrepareConfig("posed_folder", source, CONFIG), tmp_path / "pictures")
    truth = truths["test"]["horse"]
    assert isinstance(truth, Viewpoints)
    expected = [10.0 * list(tree()).index(f"test/horse/{number}.jpg") for number in (1, 2)]
    np.testing.assert_allclose(np.degrees(truth.azimuth), expected)
    np.testing.assert_allclose(truth.roll, math.radians(-1.5))
    write_truth(tmp_path / "truth", truths)
    splits = load_truth(tmp_path / "truth", "horse")
    assert splits is not None
    assert splits[1].objects is None
    np.testing.assert_allclose(splits[1].pose.azimuth.rad2deg(), expected)


def test_lines_may_end_as_on_any_system(tmp_path: Path) -> None:
    names = {"train": {"car": ["1.jpg", "2.jpg"]}}
    truths = []
    for number, ending in enumerate((b"\n", b"\r\n", b"\r")):
        source = write_folder(tmp_path / str(number), tree(**{"poses.csv": table().replace(b"\n", ending)}))
        truths.append(viewpoints(read_angles(source), names)["train"]["car"])
    for truth in truths[1:]:
        np.testing.assert_array_equal(truth.azimuth, truths[0].azimuth)


def test_accents_may_be_written_in_two_ways(tmp_path: Path) -> None:
    composed, decomposed = "train/car/\u00e9t\u00e9.jpg", "train/car/e\u0301te\u0301.jpg"
    for name, other in ((composed, decomposed), (decomposed, composed)):
        rows = f"{HEADER}\ntrain,{other},30,0,0"
        source = write_folder(tmp_path / str(len(name)), {name: b"", "poses.csv": rows.encode()})
        truth = viewpoints(read_angles(source), {"train": {"car": [name.removeprefix("train/car/")]}})["train"]["car"]
        np.testing.assert_allclose(np.degrees(truth.azimuth), [30])


def test_one_table_counts_and_hidden_ones_do_not(tmp_path: Path) -> None:
    names = {"train": {"car": ["1.jpg", "2.jpg"]}}
    files = tree(**{"poses.csv": table(), ".old/poses.csv": b"old", "train/._poses.csv": b""})
    source = write_folder(tmp_path, files)
    truth = viewpoints(read_angles(source), names)["train"]["car"]
    np.testing.assert_allclose(np.degrees(truth.azimuth), [0, 10])
    write_folder(tmp_path, {"notes/poses.csv": table()})
    with pytest.raises(DataError, match=r"has the tables notes/poses\.csv and poses\.csv; keep the one that is right"):
        read_angles(source)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, r"has no poses\.csv; expected one with the columns file, azimuth_deg, elevation_deg, roll_deg"),
        (b"file,azimuth_deg,elevation_deg\n", r"poses\.csv has no column roll_deg; expected file, azimuth_deg"),
        (
            table("train,train/car/1.jpg,north,0,0"),
            r"poses\.csv, line 2: azimuth_deg is 'north'; expected an angle from",
        ),
        (table("train,train/car/1.jpg,nan,0,0"), r"poses\.csv, line 2: azimuth_deg is 'nan'; expected an angle from"),
        (table("train,train/car/1.jpg,0,200,0"), r"line 2: elevation_deg is '200'; expected an angle from -90 to 90"),
        (table("train,train/car/2.jpg,0,0,0"), r"poses\.csv, line 3: train/car/2\.jpg has a row already; keep one"),
        (table('"' + "x" * 200_000), r"poses\.csv, line 2 cannot be read \(field larger than field limit"),
        ("file,azimuth_deg,höhe".encode("latin-1"), r"poses\.csv is not text in UTF-8; save it as UTF-8"),
        (table("train,train/car/3.jpg,0,0,0"), r"poses\.csv has no row for train/car/1\.jpg; every picture needs one"),
    ],
)
def test_a_bad_table_is_one_sentence(tmp_path: Path, content: bytes | None, message: str) -> None:
    source = write_folder(tmp_path, tree(**{"poses.csv": content}))
    with pytest.raises(DataError, match=message):
        prepare(PrepareConfig("posed_folder", source, CONFIG), tmp_path / "pictures")


def test_a_bad_table_is_found_before_the_pictures_are_read(tmp_path: Path) -> None:
    source = write_folder(
        tmp_path / "cars", {**tree(), "train/car/1.jpg": b"broken", "poses.csv": HEADER.encode()[:-9]}
    )
    with pytest.raises(DataError, match=r"poses\.csv has no column roll_deg"):
        prepare(PrepareConfig("posed_folder", source, CONFIG), tmp_path / "pictures")


def test_rolls_on_either_side_of_0_are_neighbours(tmp_path: Path) -> None:
    rows = ("train,train/car/1.jpg,350,0,359", "train,train/car/2.jpg,0,0,1")
    source = write_folder(tmp_path, tree(**{"poses.csv": table(*rows)}))
    truth = viewpoints(read_angles(source), {"train": {"car": ["1.jpg", "2.jpg"]}})["train"]["car"]
    assert isinstance(truth, Viewpoints)
    np.testing.assert_allclose(np.degrees(truth.roll), [-1, 1])
    np.testing.assert_allclose(np.degrees(truth.azimuth), [350, 0])
