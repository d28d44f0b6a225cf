"""The command line, on a project with a tiny trained model."""

import json
import math
from pathlib import Path

import pytest
import torch
import trimesh
from PIL import Image, ImageSequence
from ruamel.yaml import YAML

from pipeline.cli import doctor
from pipeline.cli.__main__ import main
from pipeline.files import save_tensors
from pipeline.networks.feature_extractor import save_feature_extractor
from pipeline.networks.full_model import full_model_texts
from pipeline.networks.wide_resnet import WideResNet
from tests.tiny_full_model import photographs, tiny_model

ROOT = Path(__file__).parents[2]


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """Write the parameters with few steps, the model and the features of the run `toybox-car`, and two photographs."""
    folder = tmp_path / "project"
    (folder / "models").mkdir(parents=True)
    yaml = YAML(typ="safe")
    params = yaml.load(ROOT / "params.yaml")
    for phase in ("background", "pose", "shape"):
        params["sizes"]["laptop"]["fine_tune"][phase] = {"steps": 2}
    params["report"] |= {"frames": 4, "view": {"size": 64, "supersampling": 1, "elevation": 15}}
    params["device"] = "cpu"
    yaml.dump(params, folder / "params.yaml")
    model = tiny_model()
    save_tensors(folder / "models/full/toybox-car.safetensors", model.state_dict(), full_model_texts(model))
    save_feature_extractor(folder / "models/features/toybox-laptop.safetensors", WideResNet(10, 1, 2), 2.0, {})
    for name, picture in zip(("car", "van"), photographs(2)[0], strict=True):
        Image.fromarray(picture.permute(1, 2, 0).contiguous().numpy()).save(tmp_path / f"{name}.png")
    return folder


def reconstruct(project: Path, *words: str) -> list[str]:
    out = project / "out"
    main(["--project", str(project), "reconstruct", *words, "--out", str(out)])
    return sorted(path.name for path in out.iterdir())


def test_photographs_become_textured_meshes(project: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    endings = [".glb", ".mtl", ".obj", "_pose.json", "_reconstruction.png", "_texture.png", "_turntable.gif"]
    written = reconstruct(project, str(tmp_path / "car.png"), str(tmp_path / "van.png"))
    assert written == sorted(f"{name}{ending}" for name in ("car", "van") for ending in endings)
    assert "2 written to" in capsys.readouterr().out
    expected = tiny_model().eval().infer(photographs(2)[0] / 255)
    bounds = torch.stack([expected.vertices[1].amin(0), expected.vertices[1].amax(0)])
    for name in ("van.glb", "van.obj"):
        mesh = trimesh.load_mesh(project / "out" / name, process=False)
        torch.testing.assert_close(torch.tensor(mesh.bounds).float(), bounds, atol=1e-5, rtol=0)
    pose = json.loads((project / "out/van_pose.json").read_text())
    assert pose["azimuth_degrees"] == pytest.approx(math.degrees(expected.pose.azimuth[1]) % 360, abs=1e-3)
    with Image.open(project / "out/car_turntable.gif") as turntable:
        assert turntable.size == (64, 64)
        assert len(list(ImageSequence.Iterator(turntable))) == 4


def test_fine_tuning_changes_the_pose(project: Path, tmp_path: Path) -> None:
    reconstruct(project, str(tmp_path / "car.png"))
    before = json.loads((project / "out/car_pose.json").read_text())
    reconstruct(project, str(tmp_path / "car.png"), "--fine-tune")
    assert json.loads((project / "out/car_pose.json").read_text()) != before


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["reconstruct", "missing.jpg", "--out", "out"], r"missing\.jpg does not exist; give the path of a photograph"),
        (["reconstruct", "a/x.jpg", "b/x.png", "--out", "out"], r"would both be written as x\.glb; rename one"),
        (["reconstruct", "x.jpg", "--run", "toybox-cat", "--out", "out"], r"has no 'runs\.toybox-cat'.*toybox-car"),
        (["view"], r"index\.html does not exist; make it with `dvc repro report@toybox-car`"),
    ],
)
def test_what_is_wrong_is_one_sentence(project: Path, words: list[str], message: str) -> None:
    with pytest.raises(SystemExit, match=r"^error: .*" + message):
        main(["--project", str(project), *words])
    assert not (project / "out").exists()


def test_an_untrained_model_names_the_command_that_trains_it(project: Path, tmp_path: Path) -> None:
    (project / "models/full/toybox-car.safetensors").unlink()
    with pytest.raises(
        SystemExit, match=r"toybox-car\.safetensors does not exist; make it with `dvc repro train_full@"
    ):
        reconstruct(project, str(tmp_path / "car.png"))


def test_view_opens_the_page(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = project / "results/report/toybox-car/index.html"
    page.parent.mkdir(parents=True)
    page.touch()
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", lambda address: opened.append(address) or True)
    main(["--project", str(project), "view"])
    assert opened == [page.resolve().as_uri()]


def test_doctor_names_what_is_missing(project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as exit_:
        main(["--project", str(project), "doctor"])
    assert exit_.value.code == 1
    lines = capsys.readouterr().out.splitlines()
    missing = [line for line in lines if line.startswith("MISSING")]
    assert [line for line in missing if "page of 'toybox-car'" in line]
    assert [line for line in missing if "photographs of 'toybox'" in line]
    assert any(line.startswith("ok      torch ") for line in lines)
    assert any(line.startswith("ok      model of 'toybox-car'") for line in lines)


def test_doctor_sees_packages_that_are_missing_or_old(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "requires", lambda _: ["numpy<1", "no-such-package", "torch>=2", "x; extra == 'none'"])
    found = [(finding.found, finding.what.split()[0], finding.advice) for finding in doctor.packages()]
    assert found[0][:2] == (False, "numpy")
    assert found[0][2] == "needs <1"
    assert found[1][:2] == (False, "no-such-package")
    assert found[2][:2] == (True, "torch")
    assert len(found) == 3
