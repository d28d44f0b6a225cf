"""PASCAL3D+: which objects are taken, how they are cut, and what their angles mean."""

import io
import math
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.io import savemat

from pipeline.datasets.pascal3d import Pascal3dConfig, read_pascal3d
from pipeline.datasets.prepared import write_images, write_truth
from pipeline.errors import ConfigError, DataError
from pipeline.evaluation.artifacts import load_truth
from pipeline.geometry.camera import CameraConfig, Pose, project
from tests.pascal3d_tree import VOC, annotation, car, photograph, release, viewpoint
from tests.picture_trees import write_folder, write_tar, write_zip

CONFIG = Pascal3dConfig(size=64, categories=("car",))
BOX = (11.0, 21.0, 50.4, 40.0)


@pytest.mark.parametrize("form", ["folder", "zip", "tar.gz"])
def test_whole_visible_objects_are_taken_and_split(tmp_path: Path, form: str) -> None:
    files = {f"PASCAL3D+_release1.1/{name}": content for name, content in release().items()}
    write = {"folder": write_folder, "zip": write_zip, "tar.gz": write_tar}[form]
    source = write(tmp_path / f"release.{form}", dict(reversed(files.items())))
    dataset = read_pascal3d(source, CONFIG)
    truth = {split: group["car"] for split, group in dataset.truth.items()}
    assert {split: np.degrees(found.azimuth).round(4).tolist() for split, found in truth.items()} == {
        "train": [200.0, 20.0, 90.0],  # ImageNet's training and validation list, then VOC's training list
        "test": [355.0],
    }
    np.testing.assert_allclose(np.degrees(truth["train"].elevation), 10.0)
    np.testing.assert_allclose(np.degrees(truth["train"].roll), -2.0)
    assert {split: len(group["car"]) for split, group in dataset.images.items()} == {"train": 3, "test": 1}


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("Image_sets/car_imagenet_train.txt", b"n02_2\n"),
        ("Annotations/car_pascal/2008_1.mat", annotation("2008_1.jpg", car(BOX, viewpoint(1.0)))),
        ("Images/car_pascal/2008_1.jpg", photograph("L")),
    ],
)
def test_what_is_there_twice_and_differs_is_refused(tmp_path: Path, name: str, content: bytes) -> None:
    whole = release()
    twice = whole | {f"old/{name}": whole[name]}
    assert len(read_pascal3d(write_folder(tmp_path / "same", twice), CONFIG).images["train"]["car"]) == 3
    source = write_folder(tmp_path / "other", whole | {f"old/{name}": content})
    with pytest.raises(DataError, match=r"other: .* is in the release twice, with different content; remove one"):
        read_pascal3d(source, CONFIG)


def test_hidden_files_are_passed_over(tmp_path: Path) -> None:
    hidden = {
        f"{folder}{kind}/car_pascal/._2008_1.{ending}": b"of a Mac"
        for folder in ("", "__MACOSX/")
        for kind, ending in (("Annotations", "mat"), ("Images", "jpg"))
    }
    source = write_folder(tmp_path, release() | hidden | {f"{VOC}/train.txt": b"2008_1\n2008_2\n\xff\n"})
    assert len(read_pascal3d(source, CONFIG).images["train"]["car"]) == 3


def test_boxes_are_cut_and_made_square(tmp_path: Path) -> None:
    images = read_pascal3d(write_folder(tmp_path, release()), CONFIG).images
    colored = images["train"]["car"][2].astype(float)  # columns 11 to 50 and rows 21 to 40, counted from 1
    assert colored.shape == (64, 64, 3)
    assert colored[32, 0, 0] == pytest.approx(3 * 10, abs=6)
    assert colored[32, -1, 0] == pytest.approx(3 * 49, abs=6)
    assert colored[16, 32, 1] == pytest.approx(3 * 20, abs=6)
    assert colored[47, 32, 1] == pytest.approx(3 * 39, abs=6)
    np.testing.assert_array_equal(colored[:16], np.repeat(colored[16:17], 16, axis=0))  # the border goes on
    gray = images["train"]["car"][1]
    assert (gray == gray[..., :1]).all()


def test_ground_truth_reaches_evaluation_alone(tmp_path: Path) -> None:
    dataset = read_pascal3d(write_folder(tmp_path / "release", release()), CONFIG)
    write_images(tmp_path / "prepared", dataset.images)
    write_truth(tmp_path / "truth", dataset.truth)
    truth = load_truth(tmp_path / "truth", "car")
    assert truth is not None
    read = truth[1]
    assert read.objects is None
    assert read.pose.scale.isnan().all()
    assert math.degrees(read.pose.azimuth.item()) == pytest.approx(355)
    assert sorted(path.name for path in (tmp_path / "prepared").rglob("*.np*")) == ["car.npy", "car.npy"]


def project_as_the_release_does(points: np.ndarray, azimuth: float, elevation: float, theta: float) -> np.ndarray:
    """Project as its function `project_3d` does (z is up, the camera at azimuth 0 looks along +y), with y up."""
    center = 5.0 * np.array(
        [math.cos(elevation) * math.sin(azimuth), -math.cos(elevation) * math.cos(azimuth), math.sin(elevation)]
    )
    about_z, about_x = -azimuth, elevation - math.pi / 2
    turn = np.array(
        [[math.cos(about_z), -math.sin(about_z), 0], [math.sin(about_z), math.cos(about_z), 0], [0.0, 0.0, 1.0]]
    )
    tilt = np.array(
        [[1.0, 0.0, 0.0], [0, math.cos(about_x), -math.sin(about_x)], [0, math.sin(about_x), math.cos(about_x)]]
    )
    x, y, depth = tilt @ turn @ (points - center).T * np.array([[1.0], [1.0], [-1.0]])
    roll = np.array([[math.cos(theta), -math.sin(theta)], [math.sin(theta), math.cos(theta)]])
    return (roll @ np.stack([x / depth, y / depth])).T


def test_the_release_and_the_project_mean_the_same_by_their_angles() -> None:
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (20, 3))
    right, back, up = points.T
    vertices = torch.tensor(np.stack([right, up, -back], axis=1))[None].float()
    angles = np.radians([40.0, 25.0, 15.0])
    azimuth, elevation, roll = torch.tensor(angles)[:, None].float()
    pose = Pose(azimuth, elevation, roll, torch.zeros(1, 2), torch.ones(1))
    ours = project(vertices, pose, CameraConfig(5.0, 90.0))[0, :, :2]
    theirs = torch.from_numpy(project_as_the_release_does(points, *angles)).float()
    torch.testing.assert_close(ours, theirs, rtol=1e-4, atol=1e-5)


def replaced(name: str, content: bytes | None) -> dict[str, bytes]:
    return release(**{name: content})


def damaged(content: bytes) -> bytes:
    """Overwrite the middle of what is compressed."""
    return content[:150] + bytes(40) + content[190:]


def without_fields() -> bytes:
    """Write a `record` that is a row of numbers."""
    stream = io.BytesIO()
    savemat(stream, {"record": np.zeros(3)})
    return stream.getvalue()


BAD_RELEASES = {
    "no list of ImageNet": (
        replaced("Image_sets/car_imagenet_val.txt", None),
        r"has no Image_sets/car_imagenet_val\.txt; expected release 1\.1 of PASCAL3D\+ with the lists of VOC 2012",
    ),
    "no list of VOC": (replaced(f"{VOC}/val.txt", None), r"has no VOC2012/ImageSets/Main/val\.txt; expected release"),
    "no annotation": (
        replaced("Annotations/car_imagenet/n02_1.mat", None),
        r"has no Annotations/car_imagenet/n02_1\.mat, which Image_sets/car_imagenet_train\.txt names",
    ),
    "no picture": (
        replaced("Images/car_pascal/2009_1.jpg", None),
        r"has no picture Images/car_pascal/2009_1, which is annotated",
    ),
    "no object in a split": (
        replaced(f"{VOC}/val.txt", b"2009_2\n"),
        r"has no whole, visible 'car' with a viewpoint for the split test",
    ),
    "cut short": (
        replaced("Annotations/car_pascal/2009_1.mat", release()["Annotations/car_pascal/2009_1.mat"][:300]),
        r"Annotations/car_pascal/2009_1\.mat is not an annotation of PASCAL3D\+ \(.+\); copy it again",
    ),
    "damaged inside": (
        replaced("Annotations/car_pascal/2009_1.mat", damaged(release()["Annotations/car_pascal/2009_1.mat"])),
        r"Annotations/car_pascal/2009_1\.mat is not an annotation of PASCAL3D\+ \(.+\); copy it again",
    ),
    "not MATLAB": (
        replaced("Annotations/car_pascal/2009_1.mat", b"text"),
        r"Annotations/car_pascal/2009_1\.mat is not an annotation of PASCAL3D\+ \(.+\); copy it again",
    ),
    "no record": (
        replaced("Annotations/car_pascal/2009_1.mat", without_fields()),
        r"Annotations/car_pascal/2009_1\.mat is not an annotation of PASCAL3D\+ \(.+\); copy it again",
    ),
    "no box": (
        replaced(
            "Annotations/car_pascal/2009_1.mat",
            annotation("2009_1.jpg", {k: v for k, v in car(BOX, viewpoint(0.0)).items() if k != "bbox"}),
        ),
        r"Annotations/car_pascal/2009_1\.mat has no field 'bbox'; expected an annotation",
    ),
    "box outside": (
        replaced("Annotations/car_pascal/2009_1.mat", annotation("", car((90.0, 1.0, 99.0, 9.0), viewpoint(0.0)))),
        r"2009_1\.jpg is 80x60 px, but an object's box spans \(89, 0, 99, 9\); expected one inside",
    ),
    "box not finite": (
        replaced("Annotations/car_pascal/2009_1.mat", annotation("", car((1.0, 1.0, math.inf, 9.0), viewpoint(0.0)))),
        r"2009_1\.mat is not an annotation of PASCAL3D\+ \(cannot convert float infinity to integer\)",
    ),
    "angle not finite": (
        replaced("Annotations/car_pascal/2009_1.mat", annotation("", car(BOX, viewpoint(math.nan)))),
        r"2009_1\.mat is not an annotation of PASCAL3D\+ \(an angle is not finite\)",
    ),
    "unreadable picture": (
        replaced("Images/car_pascal/2009_1.jpg", photograph()[:-200]),
        r"2009_1\.jpg cannot be read as a picture",
    ),
}


@pytest.mark.parametrize(("files", "message"), BAD_RELEASES.values(), ids=list(BAD_RELEASES))
def test_a_bad_release_is_one_sentence(tmp_path: Path, files: dict[str, bytes], message: str) -> None:
    with pytest.raises(DataError, match=message) as caught:
        read_pascal3d(write_folder(tmp_path, files), CONFIG)
    assert str(caught.value).startswith(str(tmp_path))
    assert "\n" not in str(caught.value)


def test_no_category_is_too_few() -> None:
    with pytest.raises(ConfigError, match="categories is empty; expected at least one"):
        Pascal3dConfig(size=64, categories=())


def test_a_category_that_is_not_there_is_named(tmp_path: Path) -> None:
    config = Pascal3dConfig(size=64, categories=("car", "boat"))
    with pytest.raises(DataError, match=r"has no Image_sets/boat_imagenet_train\.txt"):
        read_pascal3d(write_folder(tmp_path, release()), config)


def test_a_box_that_reaches_over_the_border_ends_there(tmp_path: Path) -> None:
    wide = annotation("2009_1.jpg", car((-5.0, 1.0, 99.0, 40.0), viewpoint(0.0)))
    files = release(**{"Annotations/car_pascal/2009_1.mat": wide})
    images = read_pascal3d(write_folder(tmp_path, files), CONFIG).images["test"]["car"]
    assert images[0, 32, 0, 0] < 6
    assert images[0, 32, -1, 0] == pytest.approx(3 * 79, abs=6)
