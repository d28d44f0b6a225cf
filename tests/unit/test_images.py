"""Pictures that stay on disk are the same as pictures in memory."""

from pathlib import Path

import numpy as np
import pytest
import torch

from pipeline.datasets.images import MappedImages, load_images, place_images
from pipeline.device import resolve_memory
from pipeline.errors import ConfigError, DataError

CPU = torch.device("cpu")
PICTURE = 3 * 4 * 4


@pytest.fixture
def parts(tmp_path: Path) -> list[torch.Tensor]:
    """Write two categories of 5 and 3 random pictures and map them into memory."""
    rng = np.random.default_rng(0)
    for name, count in (("car", 5), ("horse", 3)):
        np.save(tmp_path / f"{name}.npy", rng.integers(0, 256, (count, 4, 4, 3), dtype=np.uint8))
    return [load_images(tmp_path / f"{name}.npy") for name in ("car", "horse")]


def test_pictures_stay_on_disk_where_they_take_more_than_the_memory(parts: list[torch.Tensor]) -> None:
    resident = place_images(parts, CPU, 8 * PICTURE)
    assert isinstance(resident, torch.Tensor)
    assert resident.is_contiguous()
    assert isinstance(place_images(parts, CPU, 8 * PICTURE - 1), MappedImages)


def test_rows_of_mapped_pictures_are_those_of_a_tensor(parts: list[torch.Tensor]) -> None:
    resident, mapped = place_images(parts, CPU, 10**6), place_images(parts, CPU, 1)
    assert mapped.shape == resident.shape
    assert len(mapped) == len(resident) == 8
    for rows in (torch.tensor([7, 0, 4, 5, 5]), slice(3, 7), slice(None, None, 3), slice(0, 0)):
        assert torch.equal(mapped[rows], resident[rows])
        assert mapped[rows].is_contiguous()
    assert [batch.tolist() for batch in mapped.split(3)] == [batch.tolist() for batch in resident.split(3)]


def test_pictures_are_reduced_in_memory_and_on_disk_alike(parts: list[torch.Tensor]) -> None:
    resident, mapped = place_images(parts, CPU, 8 * PICTURE // 4, 2), place_images(parts, CPU, 1, 2)
    assert isinstance(resident, torch.Tensor)
    assert torch.equal(mapped[:], resident)
    corners = torch.cat([part[:, :, :2, :2] for part in parts]).float()
    assert (resident[:, :, 0, 0] - corners.mean(dim=(2, 3))).abs().max() <= 0.5


def test_a_mapped_file_is_never_changed(tmp_path: Path, parts: list[torch.Tensor]) -> None:
    before = (tmp_path / "car.npy").read_bytes()
    parts[0].zero_()
    assert (tmp_path / "car.npy").read_bytes() == before


@pytest.mark.parametrize("kept", [0, 60, 140])
def test_a_damaged_file_is_named(tmp_path: Path, parts: list[torch.Tensor], kept: int) -> None:
    assert len(parts) == 2
    content = (tmp_path / "car.npy").read_bytes()
    (tmp_path / "car.npy").write_bytes(content[:kept])
    with pytest.raises(DataError, match=r"car\.npy is damaged; copy it again, or run prepare_data"):
        load_images(tmp_path / "car.npy")


@pytest.mark.parametrize("wrong", [0, -1, True, "8 GB", None, 1e300])
def test_a_memory_that_is_no_number_is_an_error(wrong: object) -> None:
    assert resolve_memory(0.5) == 2**29
    with pytest.raises(ConfigError, match=r"^memory is .*; expected a number of GiB above 0"):
        resolve_memory(wrong)
