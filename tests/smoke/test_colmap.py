"""COLMAP as a stage of its own process, which is what pycolmap needs (pipeline/evaluation/colmap.py)."""

import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch.nn import functional

from pipeline.datasets.toybox.photograph import PhotographConfig, photograph
from pipeline.datasets.toybox.toybox import CATEGORIES
from pipeline.errors import DataError
from pipeline.evaluation.colmap import ColmapConfig, run_colmap
from pipeline.files import read_json
from pipeline.geometry.camera import CameraConfig
from tests.fresh_params import write_fresh_params
from tests.smoke.tiny_project import ROOT, run

COUNT = 6


def _evaluate(pictures: np.ndarray, folder: Path) -> tuple[dict[str, Any], str]:
    np.save(folder / "pictures.npy", pictures)
    words = [
        "--params",
        str(write_fresh_params(folder / "params.yaml")),
        "--sections",
        "evaluate_colmap",
        "--images",
        str(folder / "pictures.npy"),
        "--seed",
        "0",
    ]
    words += ["--out", str(folder / "metrics.json"), "--log", str(folder / "log.txt")]
    printed = run(ROOT, sys.executable, "-m", "stages.evaluate_colmap", *words)
    figures = read_json(folder / "metrics.json")["colmap"]
    log = (folder / "log.txt").read_text()
    assert f"COLMAP says: {'; '.join(figures['says'])}" in printed
    assert all(message in log for message in figures["says"])
    return figures, log


def test_toybox_cars_are_no_scene(tmp_path: Path) -> None:
    build, viewpoints, setting = CATEGORIES["car"]
    rng = np.random.default_rng(0)
    camera = PhotographConfig(size=32, supersampling=2, camera=CameraConfig(distance=2.7, field_of_view=30))
    cars, _ = photograph(build(COUNT, rng), viewpoints, setting, camera, rng)
    figures, log = _evaluate(cars, tmp_path)
    assert figures["says"][-1] == "Failed to create any sparse model"
    assert figures["registered"] == {"value": 0, "standard_error": 0, "n": COUNT}
    assert figures["verified_pairs"]["value"] == 0
    assert figures["features"]["value"] > 0
    assert "Processed file [6/6]" in log
    assert not re.search(r"created at|Running on|\d\.\d+s|minutes", log), "what differs from run to run"


def test_pictures_of_one_scene_match(tmp_path: Path) -> None:
    noise = torch.rand(1, 3, 48, 48, generator=torch.Generator().manual_seed(0))
    scene = functional.interpolate(noise, scale_factor=8, mode="bicubic").clamp(0, 1)[0]
    crops = [scene[:, :256, 30 * number :][..., :256] for number in range(3)]
    pictures = (torch.stack(crops) * 255).byte().permute(0, 2, 3, 1).numpy()
    figures, _ = _evaluate(pictures, tmp_path)
    assert figures["verified_pairs"] == {"value": 1, "standard_error": 0, "n": 3}
    assert figures["features"]["value"] > 100


def test_a_picture_of_something_else_has_no_partner(tmp_path: Path) -> None:
    noise = torch.rand(2, 3, 48, 48, generator=torch.Generator().manual_seed(0))
    scenes = functional.interpolate(noise, scale_factor=8, mode="bicubic").clamp(0, 1)
    pictures = torch.stack(
        [scenes[0, :, :256, 30 * number :][..., :256] for number in range(3)] + [scenes[1, :, :256, :256]]
    )
    figures, _ = _evaluate((pictures * 255).byte().permute(0, 2, 3, 1).numpy(), tmp_path)
    assert figures["verified_pairs"]["value"] == pytest.approx((3 * 2 / 3 + 0) / 4)
    assert figures["verified_pairs"]["n"] == 4


def test_one_photograph_has_no_pair(tmp_path: Path) -> None:
    one = torch.zeros(1, 3, 32, 32, dtype=torch.uint8)
    with pytest.raises(DataError, match="there is only one"):
        run_colmap(one, ColmapConfig(photographs=200, enlargement=1), 0, tmp_path)
