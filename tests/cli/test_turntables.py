"""Turntables of `kato3d reconstruct`, as GIF and as films."""

import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from PIL import Image, ImageSequence

from pipeline.errors import DataError
from pipeline.export.animation import write_gif, write_mp4
from pipeline.export.views import ViewConfig, on_white, render_textured
from pipeline.geometry.camera import CameraConfig
from tests.tiny_full_model import base_mesh, photographs
from tests.trained_project import inferred, reconstruct


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


def test_an_animation_is_endless_and_as_fast_as_asked(tmp_path: Path) -> None:
    write_gif(tmp_path / "turn.gif", torch.linspace(0, 1, 4)[:, None, None, None].expand(-1, 3, 8, 8), 60)
    with Image.open(tmp_path / "turn.gif") as turn:
        assert (turn.info["loop"], turn.info["duration"]) == (0, 60)
