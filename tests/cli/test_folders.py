"""Folders of photographs and of outputs of `kato3d reconstruct`."""

import errno
import os
import re
import shutil
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest
import torch
import trimesh

from pipeline.cli import reconstruct as reconstruction
from pipeline.cli.__main__ import main
from pipeline.cli.outputs import Found
from pipeline.cli.photographs import RECORD, list_tasks
from pipeline.cli.reconstruct import Settings, Steps, _way
from pipeline.cli.runs import Run
from pipeline.errors import DataError
from pipeline.files import alone
from tests.learning.test_full_training import FINE_TUNING
from tests.picture_trees import write_folder
from tests.trained_project import TURNTABLE, reconstruct
from tests.unit.test_painting import CONFIG as PAINT


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
    assert printed.startswith("passed over: 1 with the ending '.txt'\nwith the model of 'toybox-car'\n")
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


def test_an_emptied_output_is_written_again(project: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    reconstruct(project, str(tmp_path / "car.png"), "--outputs", "mesh")
    whole = (project / "out/car.glb").read_bytes()
    (project / "out/car.glb").write_bytes(b"")
    reconstruct(project, str(tmp_path / "car.png"), "--outputs", "mesh")
    assert "1 written to" in capsys.readouterr().out.splitlines()[-2]
    assert (project / "out/car.glb").read_bytes() == whole


@pytest.mark.parametrize(
    ("damage", "what"), [("{}", "no azimuth_degrees and elevation_degrees"), ("[]", "no azimuth_deg"), ("{", "no JSON")]
)
def test_a_damaged_pose_is_one_sentence_and_the_page_shows_the_others(
    project: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], damage: str, what: str
) -> None:
    outputs = ("--outputs", "mesh,picture,pose")
    reconstruct(project, str(tmp_path / "car.png"), *outputs)
    (project / "out/car_pose.json").write_text(damage)
    with pytest.raises(
        SystemExit, match=rf"^error: \S*car_pose\.json is damaged: it holds {what}.*; remove it, and run"
    ):
        reconstruct(project, str(tmp_path / "van.png"), *outputs)
    assert "1 written to" in capsys.readouterr().out
    text = (project / "out/index.html").read_text()
    assert 'data-name="van"' in text
    assert 'data-name="car"' not in text


def test_a_page_of_outputs_that_are_gone_is_removed(
    project: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    reconstruct(project, str(tmp_path / "car.png"), "--outputs", "mesh,picture,pose")
    (project / "out/car_pose.json").unlink()
    reconstruct(project, str(tmp_path / "van.png"), "--outputs", "mesh")
    assert capsys.readouterr().out.endswith("no page: it needs `mesh`, `picture` and `pose` among --outputs\n")
    assert not (project / "out/index.html").exists()


def test_outputs_below_the_photographs_are_not_said_to_be_passed_over(
    project: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "photographs"
    folder.mkdir()
    shutil.copy(tmp_path / "car.png", folder)
    words = ["reconstruct", str(folder), "--project", str(project), "--out", str(folder / "meshes")]
    for _ in range(2):
        main([*words, "--outputs", "mesh,picture,pose"])
        assert "passed over" not in capsys.readouterr().out


def test_what_is_neither_a_file_nor_a_folder_is_named(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(DataError, match=r"pipe is neither a file nor a folder; give the path of a photograph or"):
        list_tasks([tmp_path / "pipe"], tmp_path / "meshes")


def test_a_damaged_record_is_one_sentence(project: Path, tmp_path: Path) -> None:
    (project / "out").mkdir()
    (project / "out/reconstruct.json").touch()
    with pytest.raises(SystemExit, match=r"^error: .*reconstruct\.json is damaged: it holds no JSON; remove it"):
        reconstruct(project, str(tmp_path / "car.png"))


def test_a_folder_that_cannot_be_written_is_said_before_anything_is_inferred(project: Path, tmp_path: Path) -> None:
    (project / "out").touch()
    with pytest.raises(SystemExit, match=r"^error: \S*out is a file; name a folder$"):
        reconstruct(project, str(tmp_path / "car.png"))
    (project / "out").unlink()
    (project / "out").symlink_to(project / "params.yaml" / "out")
    with pytest.raises(SystemExit, match=r"^error: .*out.*(Not a directory|File exists); look at the path"):
        reconstruct(project, str(tmp_path / "car.png"))


def test_a_folder_holds_reconstructions_by_one_network_of_features(tmp_path: Path) -> None:
    run, ways = Run(tmp_path, "car", "laptop", "toybox", "features"), []
    for folder in ("full", "features"):
        (tmp_path / "models" / folder).mkdir(parents=True)
    (tmp_path / "models/full/car.safetensors").write_bytes(b"model")
    for content in (b"first", b"second"):
        (tmp_path / "models/features/features.safetensors").write_bytes(content)
        ways.append(_way(run, Settings(FINE_TUNING, PAINT, "crop", TURNTABLE), Steps(False, False)))
    assert ways[0] != ways[1]
