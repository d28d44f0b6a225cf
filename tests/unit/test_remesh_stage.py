import json
import sys
from pathlib import Path

import pytest
import torch
from torch import Tensor

from pipeline.networks.seed_choice import load_seed
from pipeline.tensor_files import load_tensors, save_tensors
from stages import remesh
from stages.command_line import run
from tests.deformed_spheres import deformed_sphere

PARAMS = Path(__file__).parents[2] / "params.yaml"


def write_base_shape(folder: Path, faces: Tensor) -> None:
    vertices, _, directions = deformed_sphere("car", 2)
    tensors = {"seed_vertices": torch.stack([directions, vertices]), "seed_scores": torch.tensor([2.0, 1.0])}
    save_tensors(folder / "base.safetensors", {**tensors, "faces": faces, "directions": directions}, {})


def run_stage(folder: Path, monkeypatch: pytest.MonkeyPatch, chosen: str = "score") -> None:
    options = {"params": PARAMS, "sections": "remesh", "base-shape": folder / "base.safetensors", "chosen": chosen}
    options |= {"out": folder / "out" / "mesh.safetensors", "metrics": folder / "out" / "mesh.json"}
    words = [word for name, value in options.items() for word in (f"--{name}", str(value))]
    monkeypatch.setattr(sys, "argv", ["remesh", *words])
    run(remesh.main)


def test_stage_writes_mesh_and_metrics(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_base_shape(tmp_path, deformed_sphere("car", 2)[1])
    run_stage(tmp_path, monkeypatch)
    tensors, _ = load_tensors(tmp_path / "out" / "mesh.safetensors")
    assert {name: (tensor.dtype, tensor.shape[1]) for name, tensor in tensors.items()} == {
        "vertices": (torch.float32, 3),
        "faces": (torch.int64, 3),
        "directions": (torch.float32, 3),
    }
    metrics = json.loads((tmp_path / "out" / "mesh.json").read_text())
    assert metrics["faces_after"] == len(tensors["faces"])
    assert metrics["map_flipped_faces"] == 0


def test_the_seed_that_is_named_is_remeshed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_base_shape(tmp_path, deformed_sphere("car", 2)[1])
    roundness = {}
    for chosen in ("score", "0"):
        run_stage(tmp_path, monkeypatch, chosen)
        radii = load_tensors(tmp_path / "out" / "mesh.safetensors")[0]["vertices"].norm(dim=1)
        roundness[load_seed(tmp_path / "out" / "mesh.safetensors")] = radii.min() / radii.max()
    assert roundness[0] > 0.95
    assert roundness[1] < 0.8
    for chosen in ("2", "-1", "best"):
        refusal = rf"base_shapes\.base\.chosen is '{chosen}'; expected 'score', or a seed from 0 to 1"
        with pytest.raises(SystemExit, match=f"^error: {refusal}$"):
            run_stage(tmp_path, monkeypatch, chosen)


def test_open_mesh_is_one_sentence_and_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_base_shape(tmp_path, deformed_sphere("car", 2)[1][1:])
    refusal = r"base\.safetensors, base shape [01]: the mesh is not closed: expected .*; repair the mesh first"
    with pytest.raises(SystemExit, match=rf"^error: \S*{refusal}$"):
        run_stage(tmp_path, monkeypatch)
    assert [path.name for path in tmp_path.iterdir()] == ["base.safetensors"]
