"""Stage scripts take every path as an argument and speak in sentences."""

import errno
import sys
from pathlib import Path

import pytest

from pipeline.errors import DataError
from stages.command_line import parse, run

COMMON = ["stage", "--params", "params.yaml", "--sections", "stage", "sizes.laptop.stage"]


def test_arguments_are_typed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", [*COMMON, "--test-images", "a.npy", "--seed", "3", "--out", "o"])
    arguments = parse("Do it.", test_images=Path, seed=int, out=Path)
    assert arguments.sections == ["stage", "sizes.laptop.stage"]
    assert arguments.test_images == Path("a.npy")
    assert (arguments.seed, arguments.out) == (3, Path("o"))


def test_every_argument_is_required(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys, "argv", COMMON)
    with pytest.raises(SystemExit):
        parse("Do it.", out=Path)
    assert "--out" in capsys.readouterr().err


def test_a_user_error_is_one_line() -> None:
    def fail() -> None:
        raise DataError("data/car.npy is empty; expected pictures")

    with pytest.raises(SystemExit) as caught:
        run(fail)
    assert caught.value.code == "error: data/car.npy is empty; expected pictures"


def test_a_missing_input_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(SystemExit) as caught:
        run(lambda: (tmp_path / "car.npy").open())  # pyright: ignore[reportArgumentType]
    assert str(caught.value.code).startswith(f"error: {tmp_path / 'car.npy'} does not exist; run the stage")


def test_a_place_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(SystemExit) as caught:
        run(lambda: (tmp_path / "file/inside").mkdir())
    assert str(caught.value.code).startswith(f"error: {tmp_path / 'file/inside'}: Not a directory; look at")


def test_what_is_not_the_user_s_keeps_its_traceback() -> None:
    def fail() -> None:
        raise BrokenPipeError(errno.EPIPE, "Broken pipe")

    with pytest.raises(BrokenPipeError):
        run(fail)


def test_an_interruption_is_no_traceback(capsys: pytest.CaptureFixture[str]) -> None:
    def stop() -> None:
        raise KeyboardInterrupt

    with pytest.raises(SystemExit) as caught:
        run(stop)
    assert caught.value.code == 130
    assert capsys.readouterr().err == "stopped; the same command goes on where it can\n"
