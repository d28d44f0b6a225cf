"""The whole chain at toy size, driven the way a user drives it."""

import csv
import json
import re
import shutil
import signal
import subprocess
from collections.abc import Callable
from functools import cache
from itertools import pairwise
from pathlib import Path

import pytest
from PIL import Image

from pipeline.files import read_json, sha256
from pipeline.networks.seed_choice import load_seed
from pipeline.rows.options import Options
from pipeline.rows.turn_on import turn_on
from pipeline.tensor_files import load_tensors
from tests.smoke.tiny_project import commands, environment, make_tiny_project, read_params, run, write_params

pytestmark = pytest.mark.slow

RESTART_STATES = {
    "train_features": (12, 12),
    "learn_base_shape": (6, 12),
    "train_full": (9, 9),
    "fine_tune": (3, 4),
    "train_hologan": (15, 20),
}
"""In the middle of writing which one a training is killed, and how many it writes."""
DYING_STAGE = str(Path(__file__).with_name("dying_stage.py"))
TORCHRUN = ["torchrun", "--standalone", "--nproc-per-node", "2"]


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run `dvc repro` once, from nothing to the report, with a baseline beside it."""
    folder = tmp_path_factory.mktemp("project")
    make_tiny_project(folder)
    turn_on(folder / "params.yaml", Options("toybox-car", baseline="hologan"))
    run(folder, "dvc", "repro")
    return folder


def _stages_run(printed: str) -> list[str]:
    return [line.split("'")[1].split("@")[0] for line in printed.splitlines() if line.startswith("Running stage")]


def _outputs(folder: Path, stage: str) -> list[Path]:
    return [folder / word for word in commands(folder)[stage] if word.startswith(("models/", "results/"))]


def test_the_chain_ends_with_metrics_and_a_page(project: Path) -> None:
    metrics = read_json(project / "results/metrics/toybox-car.json")
    counts = read_params(project)["prepare_data"]["toybox"]
    assert metrics["pose"]["test"]["n"] == metrics["shape"]["test"]["mask_iou"]["n"] == counts["test_count"]
    visits = load_tensors(project / "models/full/toybox-car.safetensors")[0]["train_visits"]
    assert len(visits) == counts["train_count"]
    assert metrics["pose"]["train"]["n"] == (visits > 0).sum()
    baseline = read_json(project / "results/metrics/toybox-car-hologan.json")
    assert metrics["multiview"].keys() - baseline["multiview"].keys() == {"own_network"}
    assert (project / "results/figures/hologan/toybox-car.png").stat().st_size > 0
    page = (project / "results/report/toybox-car/index.html").read_text()
    assert "toybox-car" in page
    assert "default-src 'none'" in page
    best = read_json(project / "results/metrics/base_shape/toybox-car.json")["best_seed"]
    assert re.search(rf"seed {best} · score [\d.]+ <b>chosen</b>", page)


def test_a_second_run_does_nothing(project: Path) -> None:
    assert _stages_run(run(project, "dvc", "repro")) == []
    assert json.loads(run(project, "dvc", "status", "--json")) == {}


def test_restart_state_is_gone_when_a_stage_is_done(project: Path) -> None:
    assert list((project / ".checkpoints").rglob("*state*")) == []


@pytest.fixture(scope="module")
def kill(project: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Kill a training while it writes a restart state, its second process where it divides seeds; return what is left.

    The result is a folder, and is kept for the next test.
    """

    @cache
    def kill(stage: str) -> Path:
        folder, divides = tmp_path_factory.mktemp(stage), stage == "learn_base_shape"
        words, _ = _redirected(project, stage, folder)
        command = [*(TORCHRUN if divides else ["python"]), DYING_STAGE, str(RESTART_STATES[stage][0]), *words]
        finished = subprocess.run(command, cwd=project, env=environment(), capture_output=True, text=True, check=False)
        assert finished.returncode == -signal.SIGKILL or "(SIGKILL)" in finished.stderr, finished.stderr
        assert [path.name for path in folder.iterdir()] == ["checkpoints"]
        partial = [path.name for path in (folder / "checkpoints").glob(".partial-state*")]
        assert ".partial-state-1.safetensors" in partial if divides else partial
        return folder

    return kill


@pytest.mark.parametrize("stage", RESTART_STATES)
def test_a_killed_training_resumes_to_the_same_bytes(
    project: Path, stage: str, kill: Callable[[str], Path], tmp_path: Path
) -> None:
    """It would be killed again if it wrote more restart states than were left to write."""
    shutil.copytree(kill(stage), tmp_path, dirs_exist_ok=True)
    words, written = _redirected(project, stage, tmp_path)
    deadly, states = RESTART_STATES[stage]
    run(project, "python", DYING_STAGE, str(states - deadly + 2), *words)
    for word, path in written.items():
        assert path.read_bytes() == (project / word).read_bytes(), word
    assert list(tmp_path.rglob("*state*")) == []


@pytest.mark.parametrize("stage", ["train_features", "train_full"])
def test_two_processes_go_on_where_one_was_killed(
    project: Path, stage: str, kill: Callable[[str], Path], tmp_path: Path
) -> None:
    shutil.copytree(kill(stage), tmp_path, dirs_exist_ok=True)
    words, written = _redirected(project, stage, tmp_path)
    run(project, *([*TORCHRUN, "-m", *words] if stage == "train_full" else _by_parameter(project, words, tmp_path)))
    [(alone, shared)] = [(project / word, path) for word, path in written.items() if "curves" in word]
    for ours, theirs in zip(*map(_losses, (shared, alone)), strict=True):
        assert ours == pytest.approx(theirs, rel=1e-3)
    [(alone, shared)] = [(project / word, path) for word, path in written.items() if "models" in word]
    assert sha256(shared) != sha256(alone)  # sums over the halves of a batch are rounded
    assert list(tmp_path.rglob("*state*")) == []


def test_seeds_in_two_processes_write_the_same_bytes(
    project: Path, kill: Callable[[str], Path], tmp_path: Path
) -> None:
    shutil.copytree(kill("learn_base_shape"), tmp_path, dirs_exist_ok=True)
    words, written = _redirected(project, "learn_base_shape", tmp_path)
    run(project, *_by_parameter(project, words, tmp_path))
    for word, path in written.items():
        assert path.read_bytes() == (project / word).read_bytes(), word


def _redirected(project: Path, stage: str, folder: Path) -> tuple[list[str], dict[str, Path]]:
    """Return a stage's module and arguments for another folder, and what it writes there by the name in the project."""
    words = commands(project)[stage][2:]
    written = {word: folder / word for option, word in pairwise(words) if option in ("--out", "--metrics", "--curve")}
    words = [str(written.get(word, word)) for word in words]
    words[words.index("--checkpoints") + 1] = str(folder / "checkpoints")
    return words, written


def _by_parameter(project: Path, words: list[str], folder: Path) -> list[str]:
    """Return the command that runs a stage in two processes."""
    params = read_params(project)
    params["processes"][words[0].removeprefix("stages.")] = 2
    write_params(folder, params)
    return ["python", "-m", *(str(folder / word) if word == "params.yaml" else word for word in words)]


def _losses(curve: Path) -> list[dict[str, float]]:
    """Read a curve, but for how many test pictures a network tells right."""
    with curve.open() as rows:
        return [{name: float(row[name]) for name in row if name != "test_accuracy"} for row in csv.DictReader(rows)]


def test_a_stage_runs_alone_and_writes_the_same_bytes(project: Path) -> None:
    outputs = _outputs(project, "remesh")[-2:]
    before = [path.read_bytes() for path in outputs]
    assert _stages_run(run(project, "dvc", "repro", "--single-item", "--force", "remesh@toybox-car")) == ["remesh"]
    assert [path.read_bytes() for path in outputs] == before


def test_a_changed_number_runs_what_depends_on_it(project: Path) -> None:
    params = read_params(project)
    params["fine_tune"]["pose"]["steps"] += 1
    write_params(project, params)
    assert _stages_run(run(project, "dvc", "repro")) == ["fine_tune", "evaluate", "report"]


def test_another_base_shape_is_taken_without_learning_it_again(project: Path) -> None:
    other = 1 - read_json(project / "results/metrics/base_shape/toybox-car.json")["best_seed"]
    params = read_params(project)
    params["base_shapes"]["toybox-car"]["chosen"] = other
    write_params(project, params)
    assert _stages_run(run(project, "dvc", "repro", "train_full@toybox-car")) == ["remesh", "train_full"]
    assert load_seed(project / "models/remesh/toybox-car.safetensors") == other


def test_a_misspelt_number_is_one_sentence_and_nothing_is_written(project: Path, tmp_path: Path) -> None:
    params = read_params(project)
    params["remesh"]["targt"] = 3
    write_params(tmp_path, params)
    command = commands(project)["remesh"]
    out = tmp_path / "mesh.safetensors"
    command[command.index("--params") + 1] = str(tmp_path / "params.yaml")
    command[command.index("--out") + 1] = str(out)
    finished = subprocess.run(command, cwd=project, env=environment(), capture_output=True, text=True, check=False)
    assert finished.returncode == 1
    assert finished.stderr.count("\n") == 1
    assert "unknown key 'remesh.targt'" in finished.stderr
    assert list(tmp_path.iterdir()) == [tmp_path / "params.yaml"]


def test_sharper_training_is_around_a_base_shape_of_reduced_pictures(project: Path) -> None:
    params = read_params(project)
    params["datasets"]["toybox64"] = params["datasets"]["toybox"] | {"toybox": {"photograph": {"size": 64}}}
    write_params(project, params)
    run_name = turn_on(project / "params.yaml", Options("toybox-car", dataset="toybox64", ablation="sharper"))
    run(project, "dvc", "repro", f"evaluate@{run_name}")
    _, base_shape = load_tensors(project / "models/base_shape/toybox64-car.safetensors")
    assert json.loads(base_shape["scene"])["image_size"] == 32
    _, model = load_tensors(project / f"models/full/{run_name}.safetensors")
    assert json.loads(model["config"])["renderer"]["size"] == 64
    assert "acc_pi6" in str(read_json(project / f"results/metrics/{run_name}.json"))


def test_own_photographs_take_one_command(project: Path, tmp_path: Path) -> None:
    for number in range(12):
        split, category = ("train", "test")[number % 2], ("cart", "stall")[number // 6]
        path = tmp_path / "pictures" / split / category / f"{number}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.new("RGB", (40, 32), (number, 0, 0)).save(path)
    options = Options("cifar10-automobile", source=tmp_path / "pictures", dataset="market", category="cart")
    assert turn_on(project / "params.yaml", options) == "market-cart"
    assert _stages_run(run(project, "dvc", "repro", "prepare_data@market")) == ["prepare_data"]
    assert read_json(project / "data/prepared/market/index.json")["categories"] == ["cart", "stall"]
    assert "report@market-cart" in run(project, "dvc", "stage", "list", "--name-only").split()
