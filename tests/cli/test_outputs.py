"""What `kato3d reconstruct` makes of photographs, on a project with a tiny trained model."""

import base64
import json
import math
import re
import shutil
from pathlib import Path

import pytest
import torch
import trimesh
from PIL import Image, ImageSequence
from ruamel.yaml import YAML

from pipeline.cli import gallery
from pipeline.cli import reconstruct as reconstruction
from pipeline.cli.finishing import Reading, writing
from pipeline.datasets.decoding import Fit, decode
from pipeline.geometry.camera import pose_to_tensor
from pipeline.networks.feature_extractor import load_feature_extractor
from tests.tiny_full_model import photographs, tiny_model
from tests.trained_project import TURNTABLE, inferred, pixels, reconstruct
from tests.unit.test_painting import CONFIG as PAINT


def test_photographs_become_textured_meshes(project: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pictures = ["_photograph.png", "_reconstruction.png", "_texture.png", "_turntable.gif"]
    endings = [".glb", ".mtl", ".obj", "_photograph.sha256", "_pose.json", *pictures]
    written = reconstruct(project, str(tmp_path / "car.png"), str(tmp_path / "van.png"))
    assert written == sorted(
        ["index.html", "reconstruct.json"] + [f"{name}{ending}" for name in ("car", "van") for ending in endings]
    )
    out, page = capsys.readouterr().out, project / "out/index.html"
    assert "2 written to" in out
    assert f"open {page.resolve()}\n" in out
    for name in ("car", "van"):  # on the page
        assert f'data-name="{name}"' in page.read_text()
        assert base64.b64encode((project / f"out/{name}.glb").read_bytes()).decode() in page.read_text()
    assert torch.equal(pixels(project / "out/van_photograph.png"), pixels(tmp_path / "van.png"))
    expected = inferred(project, photographs(2)[0])
    bounds = torch.stack([expected.vertices[1].amin(0), expected.vertices[1].amax(0)])
    for name in ("van.glb", "van.obj"):
        mesh = trimesh.load_mesh(project / "out" / name, process=False)
        torch.testing.assert_close(torch.tensor(mesh.bounds).float(), bounds, atol=1e-5, rtol=0)
    pose = json.loads((project / "out/van_pose.json").read_text())
    assert pose["azimuth_degrees"] == pytest.approx(math.degrees(expected.pose.azimuth[1]) % 360, abs=1e-3)
    with Image.open(project / "out/car_turntable.gif") as turntable:
        assert turntable.size == (64, 64)
        assert len(list(ImageSequence.Iterator(turntable))) == 4


def test_a_pose_file_says_the_pose_in_degrees_and_ndc_and_the_camera(project: Path, tmp_path: Path) -> None:
    reconstruct(project, str(tmp_path / "van.png"), "--outputs", "pose")
    pose = json.loads((project / "out/van_pose.json").read_text())
    pose["center x"], pose["center y"] = pose.pop("center")
    azimuth, elevation, roll, x, y, scale = pose_to_tensor(inferred(project, photographs(2)[0][1:]).pose)[0].tolist()
    expected = {
        "azimuth_degrees": math.degrees(azimuth) % 360,
        "elevation_degrees": math.degrees(elevation),
        "roll_degrees": math.degrees(roll),
        "center x": x,
        "center y": y,
        "scale": scale,
        "camera_distance": 2.7,
        "camera_field_of_view_degrees": 30.0,
    }
    assert pose == pytest.approx(expected, abs=1e-3)
    assert min(map(abs, expected.values())) > 5e-3, "wrong signs and units are told apart"


def test_a_page_shows_what_earlier_calls_have_made_too(project: Path, tmp_path: Path) -> None:
    for name, folder in (("car", "earlier"), ("van", "later")):
        (tmp_path / "all" / folder).mkdir(parents=True)
        (tmp_path / f"{name}.png").rename(tmp_path / "all" / folder / f"{name}.png")
    reconstruct(project, str(tmp_path / "all"), "--outputs", "mesh,picture,pose")
    (tmp_path / "all/earlier/car.png").rename(tmp_path / "bus.png")
    (tmp_path / "all/later/van.png").unlink()
    reconstruct(project, str(tmp_path / "bus.png"), "--outputs", "mesh,pose")
    text = (project / "out/index.html").read_text()
    assert re.findall(r'data-name="(.*?)"', text) == ["earlier/car", "later/van"]  # of a bus there is no picture
    reconstruct(project, str(tmp_path / "bus.png"), "--outputs", "mesh,picture,pose")
    text = (project / "out/index.html").read_text()
    assert re.findall(r'data-name="(.*?)"', text) == ["bus", "earlier/car", "later/van"]


def test_a_page_shows_some_of_many_the_newest_first(
    project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gallery, "SHOWN", 1)
    for name in ("car", "van"):
        reconstruct(project, str(tmp_path / f"{name}.png"), "--outputs", "mesh,picture,pose")
    text = (project / "out/index.html").read_text()
    assert re.findall(r'data-name="(.*?)"', text) == ["van"]
    assert "1 of 2 reconstructed photographs" in text
    assert "by the model of &#x27;toybox-car&#x27;." in text


def test_fine_tuning_changes_the_pose(project: Path, tmp_path: Path) -> None:
    reconstruct(project, str(tmp_path / "car.png"))
    before = json.loads((project / "out/car_pose.json").read_text())
    with pytest.raises(SystemExit, match=r"out holds reconstructions by another model or with other steps"):
        reconstruct(project, str(tmp_path / "car.png"), "--fine-tune")
    shutil.rmtree(project / "out")
    reconstruct(project, str(tmp_path / "car.png"), "--fine-tune")
    assert json.loads((project / "out/car_pose.json").read_text()) != before


def test_painting_shows_the_photograph_at_its_own_size(project: Path, tmp_path: Path) -> None:
    colors = torch.tensor([200, 120, 40]).to(torch.uint8).expand(96, 128, 3)
    Image.fromarray(colors.contiguous().numpy()).save(tmp_path / "large.png")
    photographs = [str(tmp_path / "large.png"), str(tmp_path / "car.png")]
    reconstruct(project, *photographs, "--paint", "--outputs", "mesh,picture,pose")
    out = project / "out"
    assert json.loads((out / "reconstruct.json").read_text())["paint"] is True
    assert pixels(out / "large_reconstruction.png").shape == (96, 96, 3)
    assert pixels(out / "car_reconstruction.png").shape == (64, 64, 3)  # 32 pixels, enlarged to the size of views
    texture = pixels(out / "large_texture.png").float()
    assert texture.shape == (128, 128, 3)
    predicted = inferred(project, torch.tensor([200, 120, 40]).to(torch.uint8).view(1, 3, 1, 1).expand(1, 3, 32, 32))
    before = (predicted.texture_maps[0].detach() * 255 - colors[0, 0].float()[:, None, None]).abs().mean()
    assert (texture - colors[0, 0]).abs().mean() < 0.5 * before


@pytest.mark.parametrize(("kind", "fit"), [("folder", "crop"), ("posed_folder", "pad")])
def test_oblong_photographs_become_square_as_those_of_the_run_did(
    project: Path, tmp_path: Path, kind: str, fit: Fit
) -> None:
    params = YAML(typ="safe").load(project / "params.yaml")
    params["datasets"]["toybox"] = {"kind": kind, "source": "anywhere"}
    YAML(typ="safe").dump(params, project / "params.yaml")
    ramp = torch.linspace(0, 255, 128).to(torch.uint8).expand(64, 128)
    Image.fromarray(torch.stack([ramp, ramp.flip(1), ramp // 2], 2).numpy()).save(tmp_path / "long.png")
    reconstruct(project, str(tmp_path / "long.png"), "--outputs", "pose")
    square = decode((tmp_path / "long.png").read_bytes(), "long", tiny_model().config.renderer.size, fit)
    seen = inferred(project, torch.from_numpy(square.copy()).permute(2, 0, 1)[None])
    pose = json.loads((project / "out/long_pose.json").read_text())
    assert pose["scale"] == pytest.approx(seen.pose.scale[0].item(), abs=1e-5)
    assert pose["camera_distance"] == tiny_model().config.renderer.camera.distance
    assert pose["azimuth_degrees"] == pytest.approx(math.degrees(seen.pose.azimuth[0]) % 360, abs=1e-3)


@pytest.mark.parametrize("name", ["grey.jpg", "inks.jpg", "palette.gif", "half_transparent.png"])
def test_photographs_that_are_not_rgb_are_reconstructed_as_what_they_show(
    name: str, project: Path, tmp_path: Path
) -> None:
    modes = {"grey.jpg": "L", "inks.jpg": "CMYK", "palette.gif": "P", "half_transparent.png": "RGBA"}
    with Image.open(tmp_path / "car.png") as car:
        photograph = car.convert(modes[name])
    if name == "half_transparent.png":
        photograph.paste((0, 0, 0, 0), (0, 0, 32, 16))
    photograph.save(tmp_path / name)
    with Image.open(tmp_path / name) as saved:
        shown = saved.convert("RGB")
    if name == "half_transparent.png":
        shown.paste("white", (0, 0, 32, 16))
    shown.save(tmp_path / "shown.png")
    reconstruct(project, str(tmp_path / name), str(tmp_path / "shown.png"))
    for output in ("photograph", "reconstruction", "texture"):
        first, second = (pixels(project / f"out/{stem}_{output}.png") for stem in (Path(name).stem, "shown"))
        assert torch.equal(first, second)


def test_fine_tuning_takes_more_photographs_than_the_stage(project: Path, tmp_path: Path) -> None:
    params = YAML(typ="safe").load(project / "params.yaml")
    params["fine_tune"]["photographs"] = 1
    YAML(typ="safe").dump(params, project / "params.yaml")
    photographs = [str(tmp_path / "car.png"), str(tmp_path / "van.png")]
    assert "van_pose.json" in reconstruct(project, *photographs, "--outputs", "pose", "--fine-tune")


def test_what_is_found_of_a_photograph_holds_no_other(project: Path) -> None:
    """Or each would travel to its process with the whole batch."""
    extractor = load_feature_extractor(
        project / "models/features/toybox-laptop.safetensors", torch.device("cpu"), torch.float32
    )
    found = reconstruction._inferred(photographs(2)[0], tiny_model().eval(), extractor)[1]
    for tensor in (found.vertices, found.texture, found.background, found.image, *found.pose):
        assert tensor.untyped_storage().nbytes() == tensor.nbytes


def test_mirror_symmetric_textures_alone_are_painted_alike() -> None:
    for mirror in (True, False):
        model = tiny_model(mirror_texture=mirror)
        assert writing(model, Reading(32, "crop"), ["mesh"], TURNTABLE, PAINT).mirror_texture == mirror
