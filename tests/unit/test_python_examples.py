"""The programs of docs/python.md, with a tiny model in the place of a trained one."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image

from tests.tiny_full_model import photographs
from tests.trained_project import save_models

DOCUMENT = (Path(__file__).parents[2] / "docs/python.md").read_text(encoding="utf-8")
RENDERER, MODEL, PHOTOGRAPH, LOSS = re.findall(r"```python\n(.*?)```", DOCUMENT, re.DOTALL)


def test_the_renderer_finds_an_egg() -> None:
    names: dict[str, Any] = {}
    exec(RENDERER, names)
    assert names["losses"][-1] < 0.1 * names["losses"][0]
    found = names["smooth"] @ names["coordinates"].detach()
    lengths = (found.amax(dim=0) - found.amin(dim=0)) / (names["egg"].amax(dim=0) - names["egg"].amin(dim=0))
    np.testing.assert_allclose(lengths, 1, atol=0.1)


def test_a_model_is_read_turned_and_fitted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    save_models(tmp_path)
    Path("data/prepared/toybox/test").mkdir(parents=True)
    pictures, _ = photographs(4)
    np.save("data/prepared/toybox/test/car.npy", pictures.permute(0, 2, 3, 1).numpy())
    names: dict[str, Any] = {}
    exec(MODEL, names)
    assert names["rows"][0].shape == (3, 32, 128)
    assert not names["rows"][1].allclose(names["rows"][2])
    assert trimesh.load_mesh("car.glb").is_winding_consistent
    Image.new("RGB", (60, 40)).save("photo.jpg")
    exec(PHOTOGRAPH, names)
    assert names["own"].shape == (1, 3, 32, 32)
    exec(LOSS, names)
    assert names["distances"][-1] < names["distances"][0]
