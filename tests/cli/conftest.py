"""A project with a tiny trained model."""

import shutil
from pathlib import Path

import pytest
from PIL import Image
from ruamel.yaml import YAML

from tests.fresh_params import write_fresh_params
from tests.tiny_full_model import photographs
from tests.trained_project import save_models


@pytest.fixture(scope="session")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the parameters with few steps, the model and the features of the run `toybox-car`, and two photographs."""
    parent = tmp_path_factory.mktemp("original")
    folder = parent / "project"
    (folder / "models").mkdir(parents=True)
    yaml = YAML(typ="safe")
    params = yaml.load(write_fresh_params(folder / "params.yaml"))
    for phase in ("background", "pose", "shape"):
        params["sizes"]["laptop"]["fine_tune"][phase] = {"steps": 2}
    params["turntable"] = {"frames": 4, "view": {"size": 64, "supersampling": 1, "elevation": 15}}
    params["device"], params["precision"] = "cpu", "float32"
    yaml.dump(params, folder / "params.yaml")
    save_models(folder)
    for name, photograph in zip(("car", "van"), photographs(2)[0], strict=True):
        Image.fromarray(photograph.permute(1, 2, 0).contiguous().numpy()).save(parent / f"{name}.png")
    return parent


@pytest.fixture
def project(tmp_path: Path, original: Path) -> Path:
    """Copy the project to a folder of its own, and the photographs beside it."""
    shutil.copytree(original, tmp_path, dirs_exist_ok=True)
    return tmp_path / "project"
