"""A fresh params.yaml, and photographs to name."""

from pathlib import Path

import pytest

from tests.fresh_params import write_fresh_params
from tests.picture_trees import empty_pictures, write_folder


@pytest.fixture
def params(tmp_path: Path) -> Path:
    return write_fresh_params(tmp_path / "params.yaml")


@pytest.fixture
def photographs(tmp_path: Path) -> Path:
    """Name pictures of some categories; turning a run on does not read them."""
    categories = ("bus", "car", "cart", "cat", "cat-seed1", "old-car", "stall", "van")
    return write_folder(tmp_path / "photographs", empty_pictures(*categories))
