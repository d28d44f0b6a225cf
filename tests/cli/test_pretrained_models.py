"""The trained models that come with the code."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from PIL import Image
from ruamel.yaml import YAML

from pipeline.cli.__main__ import main
from pipeline.cli.runs import find_pretrained
from pipeline.config import load
from pipeline.datasets.prepared import Dataset
from pipeline.datasets.toybox.toybox import ToyboxConfig, make_toybox
from pipeline.datasets.truth import GroundTruth
from pipeline.evaluation.shape import iou
from pipeline.networks.feature_extractor import extract, load_feature_extractor
from pipeline.networks.full_model import load_full_model
from pipeline.rendering.renderer import Mesh, render
from tests.fresh_params import ROOT
from tests.trained_project import pixels, reconstruct

CPU = torch.device("cpu")
FILES = {"model": "models/full/toybox-car.safetensors", "features": "models/features/toybox-laptop.safetensors"}


@pytest.fixture(scope="module")
def toybox() -> Dataset:
    """Photograph 32 objects of each category of the toybox, none of which the models have learned from."""
    config = load(ROOT / "params.yaml", ToyboxConfig, ["prepare_data.toybox"])
    return make_toybox(replace(config, train_count=1, test_count=32))


@pytest.mark.parametrize(("name", "least"), [("car", 0.68), ("horse", 0.48)])
def test_objects_are_found_in_pictures_unlike_those_learned_from(name: str, least: float, toybox: Dataset) -> None:
    """The best constant masks are right for .61 and .45."""
    pretrained = find_pretrained(ROOT, name)
    model = load_full_model(pretrained.model, CPU)
    extractor = load_feature_extractor(pretrained.features, CPU, torch.float32)
    images = torch.from_numpy(toybox.images["test"][name]).permute(0, 3, 1, 2).contiguous()
    scene = model.infer(images / 255, [layer.float() for layer in extract(extractor, images, len(images))])
    mesh = Mesh(scene.vertices, model.faces, model.directions)
    drawn = render(mesh, torch.ones(len(images), 3, 2, 2), scene.pose, None, None, model.config.renderer)
    truth = toybox.truth["test"][name]
    assert isinstance(truth, GroundTruth)
    assert iou(drawn.silhouettes >= 0.5, torch.from_numpy(truth.masks).bool()).mean() > least


def test_a_photograph_becomes_a_mesh_without_any_training(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Image.new("RGB", (64, 48), "red").save(tmp_path / "wide.png")
    words = ["--pretrained", "car", "--fine-tune", "--paint", "--outputs", "mesh,picture,pose"]
    main(["reconstruct", str(tmp_path / "wide.png"), "--project", str(ROOT), "--out", str(tmp_path / "out"), *words])
    out = capsys.readouterr().out
    assert out.startswith("with the pretrained model 'car'\n1 written to ")
    with Image.open(tmp_path / "out/wide_photograph.png") as photograph:
        assert photograph.size == (64, 64)
    painted = pixels(tmp_path / "out/wide_texture.png").float().mean(dim=(0, 1))
    assert painted[0] > painted[1:].max() + 64  # red


def test_doctor_looks_for_pretrained_models(project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _set_pretrained(project, {"mine": {**FILES, "features": "gone.safetensors", "size": "laptop", "fit": "crop"}})
    with pytest.raises(SystemExit):
        main(["doctor", "--project", str(project)])
    out = capsys.readouterr().out
    assert "ok      model of the pretrained 'mine': " in out
    assert "MISSING features of the pretrained 'mine': " in out


def test_names_and_files_that_are_not_there_are_one_sentence(project: Path, tmp_path: Path) -> None:
    photograph = str(tmp_path / "car.png")
    _set_pretrained(project, YAML().load(ROOT / "params.yaml")["pretrained"])
    with pytest.raises(SystemExit, match=r"^error: \S*params.yaml: pretrained has no 'cat'; did you mean 'car'\?$"):
        reconstruct(project, photograph, "--pretrained", "cat")
    what_to_do = r"restore it with `git restore`, or correct `pretrained\.car\.model` in \S*params\.yaml"
    lack = rf"^error: \S*data/pretrained/car\.safetensors does not exist; {what_to_do}$"
    with pytest.raises(SystemExit, match=lack):
        reconstruct(project, photograph, "--pretrained", "car")
    (project / "data/pretrained/car.safetensors").mkdir(parents=True)
    with pytest.raises(SystemExit, match=rf"car\.safetensors is no file; {what_to_do}$"):
        reconstruct(project, photograph, "--pretrained", "car")


def test_a_model_of_a_run_can_be_kept_as_a_pretrained_one(project: Path, tmp_path: Path) -> None:
    _set_pretrained(project, {"mine": {**FILES, "size": "laptop", "fit": "crop"}})
    reconstruct(project, str(tmp_path / "car.png"), "--fine-tune")
    assert "by the model of &#x27;toybox-car&#x27;, fine-tuned." in (project / "out/index.html").read_text()
    (project / "out").rename(project / "of_the_run")
    reconstruct(project, str(tmp_path / "car.png"), "--fine-tune", "--pretrained", "mine")
    for name in ("car.glb", "car_pose.json", "reconstruct.json"):
        assert (project / "out" / name).read_bytes() == (project / "of_the_run" / name).read_bytes()
    assert "by the pretrained model &#x27;mine&#x27;, fine-tuned." in (project / "out/index.html").read_text()


def test_a_size_that_is_not_there_is_named(project: Path, tmp_path: Path) -> None:
    _set_pretrained(project, {"mine": {**FILES, "size": "lapto", "fit": "crop"}})
    lack = r"'pretrained\.mine\.size' names no entry of sizes: 'lapto'; did you mean 'laptop'\?$"
    with pytest.raises(SystemExit, match=lack):
        reconstruct(project, str(tmp_path / "car.png"), "--pretrained", "mine")


def test_a_model_is_of_a_run_or_pretrained(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["reconstruct", "x.jpg", "--out", "y", "--run", "toybox-car", "--pretrained", "car"])
    assert "not allowed with argument --run" in capsys.readouterr().err


def _set_pretrained(project: Path, models: Mapping[str, object]) -> None:
    params = YAML().load(project / "params.yaml")
    params["pretrained"] = models
    YAML().dump(params, project / "params.yaml")
