import sys
from pathlib import Path

import pytest
import torch
import trimesh
from PIL import Image

from pipeline.files import save_tensors
from pipeline.networks.full_model import full_model_texts
from stages import reconstruct
from stages.command_line import run
from tests.tiny_full_model import photographs, tiny_model

PARAMS = Path(__file__).parents[2] / "params.yaml"


def run_stage(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    model = tiny_model()
    save_tensors(folder / "model.safetensors", model.state_dict(), full_model_texts(model))
    words = ["--params", PARAMS, "--sections", "prepare_data.folder", "--model", folder / "model.safetensors"]
    words += ["--images", folder / "car.png", "--out", folder / "meshes"]
    monkeypatch.setattr(sys, "argv", ["reconstruct", *map(str, words)])
    run(reconstruct.main)


def test_one_photograph_becomes_a_textured_mesh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pictures, _ = photographs(1)
    Image.fromarray(pictures[0].permute(1, 2, 0).contiguous().numpy()).save(tmp_path / "car.png")
    run_stage(tmp_path, monkeypatch)
    written = sorted(path.name for path in (tmp_path / "meshes").iterdir())
    assert written == ["car.glb", "car.mtl", "car.obj", "car.png"]
    mesh = trimesh.load_mesh(tmp_path / "meshes" / "car.glb", process=False)
    expected = tiny_model().eval().infer(pictures / 255).vertices[0]
    torch.testing.assert_close(torch.tensor(mesh.bounds).float(), torch.stack([expected.amin(0), expected.amax(0)]))


def test_missing_photograph_is_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(SystemExit, match=r"^error: .*car\.png does not exist; give the path of a photograph$"):
        run_stage(tmp_path, monkeypatch)
    assert not (tmp_path / "meshes").exists()
