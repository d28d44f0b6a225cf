"""What the command line says when something is wrong, and when nobody listens."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from pipeline.cli.__main__ import main
from pipeline.tensor_files import load_tensors, save_tensors
from tests.picture_trees import picture, write_folder
from tests.trained_project import reconstruct


def test_a_model_of_other_code_names_the_stage_that_makes_it(project: Path, tmp_path: Path) -> None:
    path = project / "models/full/toybox-car.safetensors"
    tensors, texts = load_tensors(path)
    save_tensors(path, {name: value for name, value in tensors.items() if "texture_decoder" not in name}, texts)
    with pytest.raises(SystemExit, match=r"^error: .*toybox-car\.safetensors holds other weights than this code's"):
        reconstruct(project, str(tmp_path / "car.png"))


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


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["reconstruct", "x.jpg", "--out", "y", "--finetune"], r"'--finetune' is not .*; did you mean '--fine-tune'\?"),
        (["view", "toybox-car"], r"'toybox-car' is not understood; expected one of: --project, --run"),
    ],
)
def test_a_misspelt_option_is_named_with_the_nearest(
    words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as caught:
        main(words)
    assert caught.value.code == 2
    said = capsys.readouterr().err
    assert said.startswith(f"usage: kato3d {words[0]} ")
    assert re.search(message, said)


def test_closed_streams_stop_nothing(tmp_path: Path) -> None:
    photographs = write_folder(
        tmp_path / "photographs", {f"{width}.png": picture(width=width) for width in (32, 33, 34)}
    )
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


def test_a_closed_pipe_is_no_error(project: Path) -> None:
    words = [sys.executable, "-m", "pipeline.cli", "doctor", "--project", str(project)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == b""
    assert process.returncode == 141


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
    what_to_do = "make it with `make repro`, .*, or take one that comes with the code, by --pretrained$"
    with pytest.raises(SystemExit, match=rf"toybox-car\.safetensors does not exist; {what_to_do}"):
        reconstruct(project, str(tmp_path / "car.png"))
