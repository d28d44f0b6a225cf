"""The whole chain at toy size, driven the way a user drives it."""

import json
import signal
import subprocess
import time
from itertools import pairwise
from pathlib import Path

import pytest
from PIL import Image

from pipeline.files import read_json
from pipeline.networks.seed_choice import load_seed
from pipeline.rows.turn_on import Options, turn_on, turn_on_baseline
from tests.smoke.tiny_project import commands, environment, make_tiny_project, read_params, run, write_params

pytestmark = pytest.mark.slow

TRAINING = ["train_features", "learn_base_shape", "train_full", "fine_tune", "train_hologan"]


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run `dvc repro` once, from nothing to the report, with a baseline beside it."""
    folder = tmp_path_factory.mktemp("project")
    make_tiny_project(folder)
    turn_on_baseline(folder / "params.yaml", "hologan", "toybox-car")
    run(folder, "dvc", "repro")
    return folder


def _stages_run(printed: str) -> list[str]:
    return [line.split("'")[1].split("@")[0] for line in printed.splitlines() if line.startswith("Running stage")]


def _outputs(folder: Path, stage: str) -> list[Path]:
    return [folder / word for word in commands(folder)[stage] if word.startswith(("models/", "results/"))]


def test_the_chain_ends_with_metrics_and_a_page(project: Path) -> None:
    metrics = json.loads((project / "results/metrics/toybox-car.json").read_text())
    assert {"acc_pi6", "n"} <= set(json.dumps(metrics).replace('"', " ").split())
    baseline = read_json(project / "results/metrics/toybox-car-hologan.json")
    assert metrics["multiview"].keys() - baseline["multiview"].keys() == {"own_network"}
    assert (project / "results/figures/hologan/toybox-car.png").stat().st_size > 0
    page = (project / "results/report/toybox-car/index.html").read_text()
    assert "toybox-car" in page
    assert "default-src 'none'" in page


def test_a_second_run_does_nothing(project: Path) -> None:
    assert _stages_run(run(project, "dvc", "repro")) == []
    assert json.loads(run(project, "dvc", "status", "--json")) == {}


def test_restart_state_is_gone_when_a_stage_is_done(project: Path) -> None:
    assert _restart_states(project / ".checkpoints") == []


@pytest.mark.parametrize("stage", TRAINING)
def test_a_killed_training_resumes_to_the_same_bytes(project: Path, stage: str, tmp_path: Path) -> None:
    """Kill the stage as soon as there is restart state, run it again and compare with the undisturbed run."""
    command = commands(project)[stage]
    written = {word: tmp_path / word for option, word in pairwise(command) if _writes(option)}
    checkpoints = tmp_path / "checkpoints"
    command = [str(written.get(word, word)) for word in command]
    command[command.index("--checkpoints") + 1] = str(checkpoints)

    process = subprocess.Popen(command, cwd=project, env=environment(), stderr=subprocess.PIPE)
    while process.poll() is None and not _restart_states(checkpoints):
        time.sleep(0.002)
    process.send_signal(signal.SIGKILL)
    _, errors = process.communicate()
    assert process.returncode == -signal.SIGKILL, errors.decode()
    assert not any(path.exists() for path in written.values())
    assert _restart_states(checkpoints)

    run(project, *command)
    for word, path in written.items():
        assert path.read_bytes() == (project / word).read_bytes(), word


def test_seeds_in_two_processes_write_the_same_bytes(project: Path, tmp_path: Path) -> None:
    params = read_params(project)
    params["processes"]["learn_base_shape"] = 2
    write_params(tmp_path, params)
    command = commands(project)["learn_base_shape"]
    written = {word: tmp_path / word for option, word in pairwise(command) if _writes(option)}
    command = [str(written.get(word, word)) for word in command]
    command[command.index("--params") + 1] = str(tmp_path / "params.yaml")
    run(project, *command)
    for word, path in written.items():
        assert path.read_bytes() == (project / word).read_bytes(), word


def _restart_states(folder: Path) -> list[Path]:
    return list(folder.rglob("state*.safetensors"))


def _writes(option: str) -> bool:
    return option in ("--out", "--metrics", "--curve")


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
