from pathlib import Path

import numpy
import pytest
import torch

from pipeline.errors import DataError
from pipeline.evaluation.artifacts import load_photographs, load_reconstructions, load_truth, select
from pipeline.files import write_json
from pipeline.geometry.camera import Pose
from pipeline.tensor_files import save_tensors


@pytest.fixture
def truth_folder(tmp_path: Path) -> Path:
    for split, count in (("train", 2), ("test", 3)):
        angles = {name: numpy.arange(count, dtype=numpy.float32) for name in ("azimuth", "elevation", "roll", "scale")}
        masks = numpy.zeros((count, 4, 4), dtype=numpy.uint8)
        masks[1] = 1
        (tmp_path / split).mkdir()
        numpy.savez(
            tmp_path / split / "car.npz",
            **angles,  # pyright: ignore[reportArgumentType]
            center=numpy.zeros((count, 2), dtype=numpy.float32),
            masks=masks,
            vertices=numpy.zeros((count, 4, 3), dtype=numpy.float32),
            faces=numpy.array([[0, 1, 2]], dtype=numpy.int32),
        )
    write_json(tmp_path / "index.json", ["car"])
    return tmp_path


def test_truth_of_chosen_pictures(truth_folder: Path) -> None:
    truth = load_truth(truth_folder, "car")
    assert truth is not None
    assert len(truth[0].pose.azimuth) == 2
    chosen = select(truth[1], torch.tensor([1, 0]))
    assert chosen.pose.azimuth.tolist() == [1, 0]
    assert chosen.objects is not None
    assert chosen.objects.masks.any(-1).any(-1).tolist() == [True, False]
    assert len(chosen.objects.vertices) == 2
    assert chosen.objects.faces.dtype == torch.int64


def test_category_without_truth_has_none(truth_folder: Path) -> None:
    assert load_truth(truth_folder, "horse") is None


@pytest.mark.parametrize("kept", [0, 100, 700])
def test_damaged_truth_is_named(truth_folder: Path, kept: int) -> None:
    path = truth_folder / "test" / "car.npz"
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(DataError, match=r"car\.npz is damaged; copy it again, or run prepare_data"):
        load_truth(truth_folder, "car")


def test_photographs_are_chosen_and_channels_first(tmp_path: Path) -> None:
    stored = numpy.zeros((3, 4, 4, 3), dtype=numpy.uint8)
    stored[2, 0, 1] = [255, 0, 51]
    numpy.save(tmp_path / "car.npy", stored)
    (photograph,) = load_photographs(tmp_path / "car.npy", torch.tensor([2]))
    assert photograph[:, 0, 1].tolist() == pytest.approx([1, 0, 0.2])


def test_reconstructions_before_and_after_fine_tuning(tmp_path: Path) -> None:
    tensors = {}
    for value, stage in ((0.0, "predicted"), (1.0, "tuned")):
        tensors[f"pose_{stage}"] = torch.arange(6.0)[None] + value
        tensors[f"vertices_{stage}"] = torch.full((1, 4, 3), value)
        tensors[f"backgrounds_{stage}"] = torch.full((1, 3, 8, 8), int(255 * value), dtype=torch.uint8)
        tensors[f"images_{stage}"] = torch.full((1, 3, 8, 8), int(255 * value), dtype=torch.uint8)
    tensors |= {"textures": torch.zeros(1, 3, 2, 2), "directions": torch.zeros(4, 3)}
    tensors |= {"faces": torch.zeros(2, 3, dtype=torch.int64), "test_index": torch.tensor([5])}
    save_tensors(tmp_path / "run.safetensors", tensors, {})
    found = load_reconstructions(tmp_path / "run.safetensors")
    assert isinstance(found.tuned.pose, Pose)
    assert found.tuned.pose.center.tolist() == [[4, 5]]
    assert found.predicted.images.unique().tolist() == [0]
    assert found.tuned.images.unique().tolist() == [1]
    assert found.test_index.tolist() == [5]
