"""The command line, on a project with a tiny trained model."""

import base64
import errno
import json
import math
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np
import pytest
import torch
import trimesh
from jaxtyping import UInt8
from PIL import Image, ImageSequence
from ruamel.yaml import YAML
from torch import Tensor

from pipeline.cli import doctor
from pipeline.cli import reconstruct as reconstruction
from pipeline.cli.__main__ import main
from pipeline.cli.finishing import Reading, writing
from pipeline.cli.outputs import Found
from pipeline.cli.photographs import RECORD, Target, Task, list_tasks
from pipeline.cli.reconstruct import Settings, Steps, _way
from pipeline.cli.runs import Run
from pipeline.datasets.decoding import Fit, decode
from pipeline.errors import DataError
from pipeline.export.animation import write_gif, write_mp4
from pipeline.export.views import TurntableConfig, ViewConfig, on_white, render_textured
from pipeline.files import alone
from pipeline.geometry.camera import CameraConfig, pose_to_tensor
from pipeline.networks.feature_extractor import extract, load_feature_extractor, save_feature_extractor
from pipeline.networks.full_model import Reconstruction, save_full_model
from pipeline.networks.wide_resnet import WideResNet
from pipeline.tensor_files import load_tensors, save_tensors
from tests.fresh_params import write_fresh_params
from tests.learning.test_full_training import FINE_TUNING
from tests.picture_trees import picture, write_folder
from tests.report_inputs import VIEW
from tests.tiny_full_model import base_mesh, photographs, tiny_model
from tests.unit.test_painting import CONFIG as PAINT

TURNTABLE = TurntableConfig(frames=4, view=VIEW)


@pytest.fixture(scope="module")
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
    model = tiny_model()
    save_full_model(folder / "models/full/toybox-car.safetensors", model, {})
    save_feature_extractor(folder / "models/features/toybox-laptop.safetensors", WideResNet(10, 1, 2), 2.0, {})
    for name, photograph in zip(("car", "van"), photographs(2)[0], strict=True):
        Image.fromarray(photograph.permute(1, 2, 0).contiguous().numpy()).save(parent / f"{name}.png")
    return parent


@pytest.fixture
def project(tmp_path: Path, original: Path) -> Path:
    """Copy the project to a folder of its own, and the photographs beside it."""
    shutil.copytree(original, tmp_path, dirs_exist_ok=True)
    return tmp_path / "project"


def reconstruct(project: Path, *words: str) -> list[str]:
    out = project / "out"
    main(["reconstruct", "--project", str(project), *words, "--out", str(out)])
    return sorted(path.relative_to(out).as_posix() for path in out.rglob("*") if path.suffix)


def inferred(project: Path, images: UInt8[Tensor, "B 3 H W"]) -> Reconstruction:
    """Return what the project's model reads off photographs."""
    path = project / "models/features/toybox-laptop.safetensors"
    extractor = load_feature_extractor(path, torch.device("cpu"), torch.float32)
    features = [layer.float() for layer in extract(extractor, images, len(images))]
    return tiny_model().eval().infer(images / 255, features)


def pixels(path: Path) -> UInt8[Tensor, "H W 3"]:
    """Read a picture."""
    with Image.open(path) as picture:
        return torch.from_numpy(np.asarray(picture.convert("RGB")).copy())


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


def test_a_turntable_goes_once_around_with_growing_azimuth(project: Path, tmp_path: Path) -> None:
    reconstruct(project, str(tmp_path / "car.png"), "--outputs", "turntable")
    with Image.open(project / "out/car_turntable.gif") as turntable:
        frames = [np.asarray(frame.convert("RGB")) / 255 for frame in ImageSequence.Iterator(turntable)]
    found, mesh, view = inferred(project, photographs(2)[0][:1]), base_mesh(), ViewConfig(64, 1, 15)
    shape, texture, camera = found.vertices[0], found.texture_maps[0], CameraConfig(2.7, 30.0)
    views = render_textured(shape, mesh.faces, mesh.directions, texture, [0, 90, 180, 270], camera, view)
    views = on_white(views).permute(0, 2, 3, 1).numpy()
    distances = [[np.abs(frame - view).mean() for view in views] for frame in frames]
    assert np.diag(distances).max() < 0.004
    assert np.min(distances + np.eye(4)) > 0.01, "frames differ by more than GIF rounds"


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


def test_fine_tuning_takes_more_photographs_than_the_stage(project: Path, tmp_path: Path) -> None:
    params = YAML(typ="safe").load(project / "params.yaml")
    params["fine_tune"]["photographs"] = 1
    YAML(typ="safe").dump(params, project / "params.yaml")
    photographs = [str(tmp_path / "car.png"), str(tmp_path / "van.png")]
    assert "van_pose.json" in reconstruct(project, *photographs, "--outputs", "pose", "--fine-tune")


def test_a_folder_is_reconstructed_but_for_what_cannot_be_read(
    project: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "photographs"
    (folder / "vans").mkdir(parents=True)
    shutil.copy(tmp_path / "car.png", folder / "car.png")
    shutil.copy(tmp_path / "van.png", folder / "vans/van.png")
    (folder / "broken.jpg").write_bytes(b"not a picture")
    (folder / "notes.txt").write_text("nor this")
    (folder / "moved.jpg").symlink_to(tmp_path / "nothing.jpg")
    with pytest.raises(SystemExit) as caught:
        reconstruct(project, str(folder), "--outputs", "pose, mesh")
    for line, name in zip(str(caught.value.code).splitlines(), ("broken.jpg", "moved.jpg"), strict=True):
        assert re.match(rf"error: \S*{name} cannot be read as a picture .*; replace or remove it$", line)
    printed = capsys.readouterr().out
    assert "2 written to" in printed
    assert printed.endswith("no page: it needs `mesh`, `picture` and `pose` among --outputs\n")
    assert (project / "out/car.glb").is_file()
    assert (project / "out/vans/van_pose.json").is_file()
    assert not list((project / "out").rglob("*.gif"))


def test_processes_that_share_a_folder_write_what_one_does(
    project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, outputs = tmp_path / "photographs", ("--outputs", "mesh,picture,pose", "--paint")
    folder.mkdir()
    for name in ("car", "van"):
        shutil.move(tmp_path / f"{name}.png", folder)
    reconstruct(project, str(folder), *outputs)
    alone = {path.name: path.read_bytes() for path in (project / "out").iterdir() if path.name != "index.html"}
    shutil.rmtree(project / "out")
    (folder / "broken.jpg").write_bytes(b"not a picture")
    monkeypatch.setattr("pipeline.cli.workers.PHOTOGRAPHS", 1)
    monkeypatch.setattr("pipeline.cli.workers.FEWEST", 2)
    monkeypatch.setattr(torch, "get_num_threads", lambda: 2)
    here = patch("pipeline.cli.outputs.write_glb", side_effect=AssertionError("written by the process that shares"))
    with here, pytest.raises(SystemExit, match=r"^error: \S*broken\.jpg cannot be read as a picture"):
        reconstruct(project, str(folder), *outputs)
    assert len(alone) == 2 * 8 + 1
    assert {name: (project / "out" / name).read_bytes() for name in alone} == alone
    (folder / "vans").mkdir()
    shutil.copy(folder / "van.png", folder / "vans/van.png")
    (project / "out/vans").write_text("where a folder should be")
    with pytest.raises(SystemExit, match=r"^error: \S*out/vans"):
        reconstruct(project, str(folder), *outputs)


def test_what_is_found_of_a_photograph_holds_no_other(project: Path) -> None:
    """Or each would travel to its process with the whole batch."""
    extractor = load_feature_extractor(
        project / "models/features/toybox-laptop.safetensors", torch.device("cpu"), torch.float32
    )
    found = reconstruction._inferred(photographs(2)[0], tiny_model().eval(), extractor)[1]
    for tensor in (found.vertices, found.texture, found.background, found.image, *found.pose):
        assert tensor.untyped_storage().nbytes() == tensor.nbytes


def test_a_photograph_that_cannot_be_opened_stops_no_other(
    project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read_bytes = Path.read_bytes

    def refuse(path: Path) -> bytes:
        if path.name == "car.png":
            raise PermissionError(13, "Permission denied")
        return read_bytes(path)

    monkeypatch.setattr(Path, "read_bytes", refuse)
    with pytest.raises(SystemExit, match=r"^error: .*car\.png cannot be read as a picture .*Permission denied"):
        reconstruct(project, str(tmp_path / "car.png"), str(tmp_path / "van.png"), "--outputs", "pose")
    assert (project / "out/van_pose.json").is_file()


def test_a_model_of_other_code_names_the_stage_that_makes_it(project: Path, tmp_path: Path) -> None:
    path = project / "models/full/toybox-car.safetensors"
    tensors, texts = load_tensors(path)
    save_tensors(path, {name: value for name, value in tensors.items() if "texture_decoder" not in name}, texts)
    with pytest.raises(SystemExit, match=r"^error: .*toybox-car\.safetensors holds other weights than this code's"):
        reconstruct(project, str(tmp_path / "car.png"))


def test_what_was_made_of_photographs_is_none_of_them(tmp_path: Path) -> None:
    files = ("reconstruct.json", "x/a_texture.png", "b_photograph.png", "b_reconstruction.png")
    made = {f"{folder}/{name}": b"" for folder in ("meshes", "sub/painted") for name in files}
    write_folder(tmp_path / "cars", {"car.png": b"", "sub/van_texture.png": b"", **made})
    for out in (tmp_path / "cars/meshes", tmp_path / "cars/more", tmp_path / "elsewhere"):
        assert list_tasks([tmp_path / "cars"], out) == [
            Task(tmp_path / "cars/car.png", Target(out / "car")),
            Task(tmp_path / "cars/sub/van_texture.png", Target(out / "sub/van_texture")),
        ]


def test_what_is_made_of_another_photograph_stays(
    project: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "other").mkdir()
    shutil.copy(tmp_path / "van.png", tmp_path / "other/car.png")
    reconstruct(project, str(tmp_path / "car.png"), "--outputs", "pose")
    first = (project / "out/car_pose.json").read_text()
    photographs = [str(tmp_path / "other/car.png"), str(tmp_path / "van.png")]
    with pytest.raises(SystemExit, match=r"^error: \S*out/car is made of another photograph than \S*other/car.png is"):
        reconstruct(project, *photographs, "--outputs", "pose")
    assert "1 written to" in (printed := capsys.readouterr().out.splitlines()[-2])
    assert "0 already there, 1 failed" in printed
    assert (project / "out/car_pose.json").read_text() == first
    (project / "out/car_photograph.sha256").write_bytes(b"\xff\0")
    with pytest.raises(SystemExit, match=r"remove car_photograph\.sha256 there to write over it$"):
        reconstruct(project, str(tmp_path / "car.png"), "--outputs", "pose")
    (project / "out/car_photograph.sha256").unlink()
    assert "car_pose.json" not in reconstruct(project, photographs[0], "--outputs", "mesh")
    capsys.readouterr()
    reconstruct(project, *photographs, "--outputs", "pose")
    assert "1 already there, 0 failed" in capsys.readouterr().out
    assert (project / "out/car_pose.json").read_text() == (project / "out/van_pose.json").read_text() != first


def test_what_was_not_written_is_not_already_there(
    project: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    reconstruct(project, str(tmp_path / "car.png"), "--outputs", "mesh,pose")
    first = (project / "out/car.glb").read_bytes()
    shutil.copy(tmp_path / "van.png", tmp_path / "car.png")
    (project / "out/car_photograph.sha256").unlink()
    full = patch("pipeline.cli.outputs.write_glb", side_effect=OSError(errno.ENOSPC, "No space left on device"))
    with full, pytest.raises(SystemExit, match="No space left on device"):
        reconstruct(project, str(tmp_path / "car.png"), "--outputs", "mesh,pose")
    reconstruct(project, str(tmp_path / "car.png"), "--outputs", "mesh,pose")
    assert "1 written to" in capsys.readouterr().out
    assert (project / "out/car.glb").read_bytes() != first


def test_a_photograph_that_is_replaced_meanwhile_is_told(project: Path, tmp_path: Path) -> None:
    def replaced(*arguments: Any) -> list[Found]:
        shutil.copy(tmp_path / "van.png", tmp_path / "car.png")
        return infer(*arguments)

    infer = reconstruction._inferred
    sentence = r"^error: \S*car\.png was replaced while it was reconstructed; run the same command again$"
    with patch.object(reconstruction, "_inferred", replaced), pytest.raises(SystemExit, match=sentence):
        reconstruct(project, str(tmp_path / "car.png"), "--outputs", "mesh,picture")
    assert not list((project / "out").glob("car*"))


def test_a_folder_without_reconstructions_is_free_for_any(
    project: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "broken.png").touch()
    with pytest.raises(SystemExit, match=r"broken\.png cannot be read as a picture"):
        reconstruct(project, str(tmp_path / "broken.png"))
    assert not (project / "out").exists()
    assert "no page" not in capsys.readouterr().out
    assert "car_pose.json" in reconstruct(project, str(tmp_path / "car.png"), "--outputs", "pose", "--fine-tune")


def test_a_folder_of_other_files_keeps_them(project: Path, tmp_path: Path) -> None:
    write_folder(project / "out", {"car.obj": b"mine"})
    with pytest.raises(
        SystemExit, match=r"out holds car\.obj, which is no reconstruction; name a new or an empty folder"
    ):
        reconstruct(project, str(tmp_path / "car.png"), "--outputs", "pose")
    assert [path.read_bytes() for path in (project / "out").iterdir()] == [b"mine"]


def test_one_call_at_a_time_writes_to_a_folder(project: Path, tmp_path: Path) -> None:
    with alone(project / "out" / RECORD), pytest.raises(SystemExit, match=r"another process is writing \S*out/"):
        reconstruct(project, str(tmp_path / "car.png"), "--outputs", "pose")
    assert list((project / "out").iterdir()) == []
    assert "car_pose.json" in reconstruct(project, str(tmp_path / "car.png"), "--outputs", "pose")


def test_a_folder_in_the_place_of_an_output_fails_its_photograph_alone(project: Path, tmp_path: Path) -> None:
    photographs = write_folder(tmp_path / "photographs", {"a.glb/x.png": (tmp_path / "car.png").read_bytes()})
    shutil.copy(tmp_path / "car.png", photographs / "a.png")
    shutil.copy(tmp_path / "van.png", photographs / "b.png")
    with pytest.raises(SystemExit, match=r"a\.png: .*Is a directory"):
        reconstruct(project, str(photographs), "--outputs", "mesh,pose")
    assert (project / "out/b.glb").is_file()
    assert (project / "out/a.glb/x.glb").is_file()


def test_photographs_and_what_is_written_do_not_share_a_folder(tmp_path: Path) -> None:
    photographs = write_folder(tmp_path / "photographs", {"car.png": b""})
    for given in (photographs, photographs / "car.png"):
        for out in (photographs / "sub" / "..", tmp_path):
            with pytest.raises(DataError, match="is the folder of the photographs or one above it; name another for"):
                list_tasks([given], out)


@pytest.mark.parametrize("other", ["", "tuned"])
def test_folders_of_outputs_do_not_lie_in_each_other(tmp_path: Path, other: str) -> None:
    photographs = write_folder(tmp_path / "photographs", {"tuned/car.png": b""})
    write_folder(tmp_path / "meshes" / other, {"reconstruct.json": b"{}"})
    out = tmp_path / "meshes" if other else tmp_path / "meshes/tuned/more"
    with pytest.raises(
        DataError, match=rf"meshes/?{other} is another folder of outputs, and .* is inside or around it"
    ):
        list_tasks([photographs], out)
    assert len(list_tasks([photographs], tmp_path / "meshes" / other)) == 1


def test_a_linked_folder_of_photographs_is_not_passed_over(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "photographs", {"car.png": b"", "more/van.png": b""})
    (folder / "linked").symlink_to(folder / "more")
    with pytest.raises(DataError, match=r"linked is a link to a folder; copy the folder there, or name it itself"):
        list_tasks([folder], tmp_path / "meshes")


def test_a_stopped_reconstruction_goes_on_where_it_stopped(
    project: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    photographs = [str(tmp_path / "car.png"), str(tmp_path / "van.png")]
    reconstruct(project, *photographs, "--outputs", "mesh,pose")
    car, van = (project / f"out/{name}.glb" for name in ("car", "van"))
    bounds = trimesh.load_mesh(van).bounds
    car.write_bytes(b"not written again")
    van.unlink()
    reconstruct(project, *photographs, "--outputs", "mesh,pose")
    assert "1 written to" in (printed := capsys.readouterr().out.splitlines()[-2])
    assert "1 already there" in printed
    assert car.read_bytes() == b"not written again"
    assert trimesh.load_mesh(van).bounds == pytest.approx(bounds, abs=1e-5)


def test_a_turntable_may_be_a_film(project: Path, tmp_path: Path) -> None:
    assert reconstruct(project, str(tmp_path / "car.png"), "--outputs", "video") == [
        "car_photograph.sha256",
        "car_turntable.mp4",
        "reconstruct.json",
    ]
    film = cv2.VideoCapture(str(project / "out/car_turntable.mp4"))
    assert int(film.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little") in (b"avc1", b"h264")
    assert [film.read()[1].shape for _ in range(4)] == [(64, 64, 3)] * 4
    assert not film.read()[0]
    assert film.get(cv2.CAP_PROP_FPS) == pytest.approx(1000 / 600, rel=0.01)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["reconstruct", "missing.jpg", "--out", "out"],
            r"missing\.jpg does not exist; give the path of a photograph or",
        ),
        (["reconstruct", "x.jpg", "--run", "toybox-cat", "--out", "out"], r"has no run 'toybox-cat'.*toybox-car"),
        (["runs"], r"metrics has no figures of a run; make them with `make repro`"),
        (["view"], r"index\.html does not exist; make it with `make repro`, which brings all runs up to date"),
    ],
)
def test_what_is_wrong_is_one_sentence(
    project: Path, words: list[str], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(project)
    with pytest.raises(SystemExit, match=r"^error: .*" + message):
        main([*words, "--project", str(project)])
    assert not (project / "out").exists()


def test_a_film_that_cannot_be_written_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "encoder").write_text("#!/bin/sh\nhead -c 100 > /dev/null\necho No space left >&2\nexit 1\n")
    (tmp_path / "encoder").chmod(0o755)
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(tmp_path / "encoder"))
    with pytest.raises(DataError, match=r"car\.mp4 cannot be written \(No space left\); look at its folder"):
        write_mp4(tmp_path / "car.mp4", torch.zeros(4, 3, 64, 64), 100)
    assert not (tmp_path / "car.mp4").exists()


def test_a_film_may_be_written_below_a_name_with_a_colon(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "12:30").mkdir()
    monkeypatch.chdir(tmp_path)
    write_mp4(Path("12:30/car.mp4"), torch.zeros(4, 3, 65, 64), 100)
    assert cv2.VideoCapture(str(tmp_path / "12:30/car.mp4")).read()[1].shape == (66, 64, 3)


def test_closed_streams_stop_nothing(tmp_path: Path) -> None:
    photographs = write_folder(tmp_path / "photographs", {f"{name}.png": picture() for name in "abc"})
    words = [sys.executable, "-m", "pipeline.cli", "arrange", str(photographs), "--category", "car", "--out"]
    ended = subprocess.run(["sh", "-c", 'exec "$@" 2>&-', "sh", *words, str(tmp_path / "mine")], check=False)
    assert ended.returncode == 0
    assert len(list((tmp_path / "mine").rglob("*.jpg"))) == 3


def test_a_closed_output_is_no_traceback(project: Path) -> None:
    command = [sys.executable, "-m", "pipeline.cli", "doctor", "--project", str(project)]
    ended = subprocess.run(["sh", "-c", 'exec "$@" >&-', "sh", *command], capture_output=True, text=True, check=False)
    assert "Traceback" not in ended.stderr


def test_what_is_wrong_is_told_before_pytorch_is_imported(project: Path) -> None:
    script = (
        "import sys; from pipeline.cli.__main__ import main\ntry: main()\nfinally: assert 'torch' not in sys.modules"
    )
    for words, message in (
        (["reconstruct", "missing.jpg", "--out", "out"], "missing.jpg does not exist"),
        (["reconstruct", "missing.jpg", "--out", "out", "--run", "no"], "has no run 'no'"),
        (["view"], "index.html does not exist"),
    ):
        command = [sys.executable, "-c", script, *words, "--project", str(project)]
        ended = subprocess.run(command, capture_output=True, text=True, check=False)
        assert ended.returncode == 1
        assert ended.stderr.startswith("error: ")
        assert message in ended.stderr


def test_a_damaged_record_is_one_sentence(project: Path, tmp_path: Path) -> None:
    (project / "out").mkdir()
    (project / "out/reconstruct.json").touch()
    with pytest.raises(SystemExit, match=r"^error: .*reconstruct\.json is damaged: it holds no JSON; remove it"):
        reconstruct(project, str(tmp_path / "car.png"))


def test_a_missing_encoder_is_said_before_anything_is_inferred(
    project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(SystemExit, match=r"^error: films need the encoder of imageio-ffmpeg; install it with"):
        reconstruct(project, str(tmp_path / "car.png"), "--outputs", "pose,video")
    assert not (project / "out").exists()


def test_an_encoder_that_is_gone_is_said_before_anything_is_inferred(
    project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(tmp_path / "gone"))
    with pytest.raises(SystemExit, match=r"^error: films need ffmpeg, which imageio-ffmpeg does not find; install it"):
        reconstruct(project, str(tmp_path / "car.png"), "--outputs", "pose,video")
    assert not (project / "out").exists()


def test_a_photograph_that_is_named_twice_is_listed_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "car.png").touch()
    monkeypatch.chdir(tmp_path)
    assert list_tasks([Path("car.png"), tmp_path / "car.png", tmp_path], Path("out")) == [
        Task(Path("car.png"), Target(Path("out/car")))
    ]


def test_a_name_that_is_no_text_becomes_one(project: Path, tmp_path: Path) -> None:
    folder = tmp_path / "cars" / os.fsdecode(b"g\xe9n\xe9ral")
    folder.mkdir(parents=True)
    shutil.copy(tmp_path / "car.png", folder / os.fsdecode(b"caf\xe9.png"))
    written = reconstruct(project, str(tmp_path / "cars"))
    assert {f"{folder.name}/caf_{ending}" for ending in (".glb", ".obj", "_pose.json")} < set(written)
    assert r'data-name="g\udce9n\udce9ral/caf_"' in (project / "out/index.html").read_text(encoding="utf-8")


def test_a_folder_that_cannot_be_written_is_said_before_anything_is_inferred(project: Path, tmp_path: Path) -> None:
    (project / "out").touch()
    with pytest.raises(SystemExit, match=r"^error: \S*out is a file; name a folder$"):
        reconstruct(project, str(tmp_path / "car.png"))
    (project / "out").unlink()
    (project / "out").symlink_to(project / "params.yaml" / "out")
    with pytest.raises(SystemExit, match=r"^error: .*out.*(Not a directory|File exists); look at the path"):
        reconstruct(project, str(tmp_path / "car.png"))


@pytest.mark.parametrize(("name", "becomes"), [(" .png", "_"), ("..png", "._"), ("...png", ".._"), ("a\\b.png", "a_b")])
def test_a_name_that_readers_would_misunderstand_becomes_another(tmp_path: Path, name: str, becomes: str) -> None:
    (tmp_path / name).touch()
    assert list_tasks([tmp_path / name], tmp_path / "out") == [
        Task(tmp_path / name, Target(tmp_path / "out" / becomes))
    ]


def test_a_closed_pipe_is_no_error(project: Path) -> None:
    words = [sys.executable, "-m", "pipeline.cli", "doctor", "--project", str(project)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == b""
    assert process.returncode == 141


def test_a_name_that_is_too_long_for_what_is_written_stops_no_other(project: Path, tmp_path: Path) -> None:
    folder = tmp_path / "cars"
    folder.mkdir()
    names = [f"{letter * length}.png" for letter, length in (("a", 3), ("b", 232), ("c", 246), ("d", 3))]
    for name in names:
        shutil.copy(tmp_path / "car.png", folder / name)
    with pytest.raises(SystemExit) as caught:
        reconstruct(project, str(folder), "--outputs", "pose,picture")
    lines = sorted(str(caught.value.code).splitlines())
    assert [
        name in line and "File name too long" in line and line.endswith("or name another folder")
        for name, line in zip(names[1:3], lines, strict=True)
    ] == [
        True,
        True,
    ]
    assert {path.name for path in (project / "out").glob("*_pose.json")} >= {"aaa_pose.json", "ddd_pose.json"}


def test_spaces_in_names_become_underscores(project: Path, tmp_path: Path) -> None:
    (tmp_path / "my cars").mkdir()
    shutil.copy(tmp_path / "car.png", tmp_path / "my cars/red  car.png")
    for words in (tmp_path / "my cars", tmp_path / "my cars/red  car.png"):
        assert "red_car.obj" in reconstruct(project, str(words), "--outputs", "mesh")
    assert "mtllib red_car.mtl\n" in (project / "out/red_car.obj").read_text()


def test_the_second_photograph_of_a_name_stops_no_other(
    project: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "cars"
    folder.mkdir()
    for name in ("1.BMP", "1.png", "a b.png", "a_b.png", "c.png"):
        Image.open(tmp_path / "car.png").save(folder / name)
    with pytest.raises(SystemExit) as caught:
        reconstruct(project, str(folder), "--outputs", "pose")
    assert str(caught.value.code).splitlines() == [
        f"error: the outputs of {folder / second} would be written over those of {folder / first}; rename one"
        for first, second in (("1.BMP", "1.png"), ("a b.png", "a_b.png"))
    ]
    assert "3 written to" in (printed := capsys.readouterr().out)
    assert "0 already there, 2 failed" in printed
    assert {path.name for path in (project / "out").glob("*.json")} == {
        "1_pose.json",
        "a_b_pose.json",
        "c_pose.json",
        "reconstruct.json",
    }


def test_the_help_says_how_to_name_a_photograph_that_begins_like_an_option(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit):
        main(["reconstruct", "--help"])
    assert "-NAME is written ./-NAME" in " ".join(capsys.readouterr().out.split())


def test_an_unknown_output_is_named(project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        reconstruct(project, "x.jpg", "--outputs", "mesh,film")
    assert "'film' is no output; expected some of mesh,picture" in capsys.readouterr().err


def test_an_untrained_model_names_the_command_that_trains_it(project: Path, tmp_path: Path) -> None:
    (project / "models/full/toybox-car.safetensors").unlink()
    with pytest.raises(SystemExit, match=r"toybox-car\.safetensors does not exist; make it with `make repro`"):
        reconstruct(project, str(tmp_path / "car.png"))


def test_view_opens_the_page(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = project / "results/report/toybox-car/index.html"
    page.parent.mkdir(parents=True)
    page.touch()
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", lambda address: opened.append(address) or True)
    main(["view", "--project", str(project)])
    assert opened == [page.resolve().as_uri()]


def test_runs_writes_and_opens_a_table_of_all_runs(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, has_page in (("horse", True), ("car", False)):
        (project / "results/metrics").mkdir(parents=True, exist_ok=True)
        (project / f"results/metrics/{name}.json").write_text('{"pose": {"acc": 0.5}, "reconstruction": {}}')
        page = project / f"results/report/{name}/index.html"
        page.parent.mkdir(parents=True)
        if has_page:
            page.touch()
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", lambda address: opened.append(address) or True)
    main(["runs", "--project", str(project)])
    page = project / "results/report/index.html"
    assert opened == [page.resolve().as_uri()]
    text = page.read_text()
    assert '<td><a href="horse/index.html">horse</a></td>' in text
    assert "<td>car</td>" in text


def test_runs_names_a_file_that_holds_no_figures(project: Path) -> None:
    (project / "results/metrics").mkdir(parents=True)
    (project / "results/metrics/car.json").write_text("0.5")
    with pytest.raises(SystemExit, match=r"^error: \S*car\.json is damaged: it holds no figures by name; remove it"):
        main(["runs", "--project", str(project)])


def test_doctor_names_what_is_missing(project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as exit_:
        main(["doctor", "--project", str(project)])
    assert exit_.value.code == 1
    lines = capsys.readouterr().out.splitlines()
    missing = [line for line in lines if line.startswith("MISSING")]
    assert [line for line in missing if "page of 'toybox-car'" in line]
    assert [line for line in missing if "photographs of 'toybox'" in line]
    assert any(line.startswith("ok      torch ") for line in lines)
    assert any(line.startswith("ok      model of 'toybox-car'") for line in lines)
    assert any(line.startswith("ok      features of 'toybox-car'") for line in lines)


def test_doctor_names_a_source_that_is_no_path(project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    params = project / "params.yaml"
    settings = YAML().load(params)
    settings["datasets"]["toybox"]["source"] = 2024
    YAML().dump(settings, params)
    with pytest.raises(SystemExit):
        main(["doctor", "--project", str(project)])
    assert "'datasets.toybox.source' must be text, not 2024" in capsys.readouterr().out


def test_doctor_needs_no_runs(project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    params = project / "params.yaml"
    settings = YAML().load(params)
    settings |= {"runs": None, "datasets": None}
    YAML().dump(settings, params)
    main(["doctor", "--project", str(project)])
    assert "MISSING" not in capsys.readouterr().out


def test_doctor_tells_what_it_finds_before_what_it_cannot_read(
    project: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (project / "params.yaml").write_text("runs: [")
    with pytest.raises(SystemExit, match=r"^error: \S*params\.yaml"):
        main(["doctor", "--project", str(project)])
    assert "ok      MeshLab loads" in capsys.readouterr().out


def test_doctor_names_an_entry_that_is_no_section(project: Path) -> None:
    params = project / "params.yaml"
    whole = params.read_text()
    for section, broken, words in (
        ("runs", {"toybox-car": "toybox"}, "'runs.toybox-car' must be a section of keys and values, not 'toybox'"),
        ("runs", {"toybox-car": {"size": "laptop", "dataset": "toybox"}}, "has no 'runs.toybox-car.features'"),
        ("runs", ["toybox-car"], "'runs' must be a section of keys and values"),
        ("datasets", {"toybox": None}, "'datasets.toybox' must be a section of keys and values, not None"),
        ("datasets", {"toybox": {"kind": "toybox"}}, "has no 'datasets.toybox.source'"),
    ):
        YAML().dump(YAML().load(whole) | {section: broken}, params)
        with pytest.raises(SystemExit, match=words):
            main(["doctor", "--project", str(project)])


@pytest.mark.parametrize("package", ["packaging", "pandas", "torch"])
def test_doctor_sees_that_what_it_uses_itself_is_missing(project: Path, package: str) -> None:
    code = f"""
import sys
sys.modules[{package!r}] = None  # importing it fails
from pipeline.cli import doctor
def version(name):
    if name == {package!r}:
        raise doctor.PackageNotFoundError
    return real(name)
real, doctor.version = doctor.version, version
from pipeline.cli.__main__ import main
main(["doctor", "--project", {str(project)!r}])
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 1, done.stderr
    assert done.stderr == ""
    assert f"MISSING {package}: install it with" in done.stdout
    assert "photographs of 'toybox'" in done.stdout


def test_doctor_sees_that_meshlab_does_not_load(monkeypatch: pytest.MonkeyPatch) -> None:
    assert doctor.meshlab().found

    def refuse(name: str) -> None:
        raise ImportError(f"libGL.so.1: cannot open shared object file, needed by {name}")

    monkeypatch.setattr(doctor, "import_module", refuse)
    finding = doctor.meshlab()
    assert not finding.found
    assert finding.advice.startswith("libGL.so.1: cannot open")


def test_doctor_sees_packages_that_are_missing_or_old(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "requires", lambda _: ["numpy<1", "no-such-package", "torch>=2", "x; extra == 'none'"])
    found = [(finding.found, finding.what.split()[0], finding.advice) for finding in doctor.packages()]
    assert found[0][:2] == (False, "numpy")
    assert found[0][2].startswith("needs <1; install it with")
    assert found[1][:2] == (False, "no-such-package")
    assert found[1][2].startswith("install it with")
    assert found[2][:2] == (True, "torch")
    assert len(found) == 3


def test_an_animation_is_endless_and_as_fast_as_asked(tmp_path: Path) -> None:
    write_gif(tmp_path / "turn.gif", torch.linspace(0, 1, 4)[:, None, None, None].expand(-1, 3, 8, 8), 60)
    with Image.open(tmp_path / "turn.gif") as turn:
        assert (turn.info["loop"], turn.info["duration"]) == (0, 60)


def test_mirror_symmetric_textures_alone_are_painted_alike() -> None:
    for mirror in (True, False):
        model = tiny_model(mirror_texture=mirror)
        assert writing(model, Reading(32, "crop"), ["mesh"], TURNTABLE, PAINT).mirror_texture == mirror


def test_a_folder_holds_reconstructions_by_one_network_of_features(tmp_path: Path) -> None:
    run, ways = Run(tmp_path, "car", "laptop", "toybox", "features"), []
    for folder in ("full", "features"):
        (tmp_path / "models" / folder).mkdir(parents=True)
    (tmp_path / "models/full/car.safetensors").write_bytes(b"model")
    for content in (b"first", b"second"):
        (tmp_path / "models/features/features.safetensors").write_bytes(content)
        ways.append(_way(run, Settings(FINE_TUNING, PAINT, "crop", TURNTABLE), Steps(False, False)))
    assert ways[0] != ways[1]
