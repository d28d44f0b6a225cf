"""Names of photographs, and of what `kato3d reconstruct` makes of them."""

import os
import shutil
from pathlib import Path

import pytest
from PIL import Image

from pipeline.cli.photographs import Target, Task, list_tasks
from tests.picture_trees import write_folder
from tests.trained_project import reconstruct


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


@pytest.mark.parametrize(("name", "becomes"), [(" .png", "_"), ("..png", "._"), ("...png", ".._"), ("a\\b.png", "a_b")])
def test_a_name_that_readers_would_misunderstand_becomes_another(tmp_path: Path, name: str, becomes: str) -> None:
    (tmp_path / name).touch()
    assert list_tasks([tmp_path / name], tmp_path / "out") == [
        Task(tmp_path / name, Target(tmp_path / "out" / becomes))
    ]


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
