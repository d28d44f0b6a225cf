"""Two processes that share a training do what one does, hold the same state, and resume when one was killed."""

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
import torch
import torch.distributed as dist

from pipeline import distributed
from pipeline.errors import ConfigError, ProcessKilled
from pipeline.files import read_json
from pipeline.launch import resolve_processes, share_work
from pipeline.tensor_files import load_tensors
from pipeline.training import full_trainer
from pipeline.training.checkpoint import Checkpoint
from tests.shared_trainings import SEEDS, take_steps, train
from tests.tiny_full_model import TRAINING

CPU = torch.device("cpu")
ROOT = Path(__file__).parents[2]

# Biases before a batch normalisation, and the running means that follow them, change nothing: their gradients are zero
# but for rounding, which Adam enlarges.
WITHOUT_EFFECT = re.compile(r"^(?!gradient).*(texture_decoder.image|texture.weights)\.(blocks\S*bias|\S*running_mean)")

pytestmark = pytest.mark.slow

ROUNDING = 1e-9
"""Of sums over 8 pictures and over twice 4, in float64."""


@pytest.fixture(scope="module")
def one(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder, threads = tmp_path_factory.mktemp("one"), torch.get_num_threads()
    torch.set_num_threads(max(1, threads // 2))  # as each of two processes has: rounding differs with them
    try:
        share_work(1, CPU, take_steps, folder)
    finally:
        torch.set_num_threads(threads)
    return folder


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("two")
    share_work(2, CPU, take_steps, folder)
    return folder


def test_steps_are_those_of_a_single_process(one: Path, two: Path) -> None:
    alone, _ = load_tensors(one / "0.safetensors")
    assert _differences(one / "0.safetensors", two / "0.safetensors") == {}
    assert alone["near record.visits"].sum() == alone["everything record.visits"].sum() == TRAINING.batch_size


def _differences(alone: Path, shared: Path) -> dict[str, float]:
    """Return which tensors of two files differ by more than rounding, and how much."""
    (first, _), (second, _) = load_tensors(alone), load_tensors(shared)
    assert first.keys() == second.keys()
    found = {name: _difference(name, first, second) for name in first if not WITHOUT_EFFECT.search(name)}
    return {name: value for name, value in found.items() if value > ROUNDING}


def _difference(name: str, alone: dict[str, torch.Tensor], shared: dict[str, torch.Tensor]) -> float:
    """Return the largest difference, in units of the largest value where that is above 1.

    Weights whose gradient is rounding do not count: Adam's first step goes by its direction alone. Their gradients do.
    """
    first, second = alone[name].double(), shared[name].double()
    difference = (first - second).abs() / first.abs().amax().clamp(min=1)
    gradient = alone.get(f"gradient of {name}")
    counted = difference if gradient is None else difference[gradient.abs() > ROUNDING]
    return max(counted.flatten().tolist(), default=0)


def test_every_process_holds_the_same_state(two: Path) -> None:
    assert (two / "0.safetensors").read_bytes() == (two / "1.safetensors").read_bytes()


def test_started_processes_round_convolutions_of_a_gpu_as_a_single_one_does(two: Path) -> None:
    assert {read_json(two / f"{rank}.convolutions.json") for rank in range(2)} == {"tf32"}


def test_seeds_learned_side_by_side_are_those_learned_in_turn(one: Path, two: Path) -> None:
    assert (two / "seeds.safetensors").read_bytes() == (one / "seeds.safetensors").read_bytes()


def test_processes_take_equally_many_steps_of_three_seeds(one: Path, two: Path) -> None:
    assert read_json(one / "0.steps.json") == SEEDS.seeds * SEEDS.iterations
    assert {read_json(two / f"{rank}.steps.json") for rank in range(2)} == {SEEDS.seeds * SEEDS.iterations // 2}


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Kill one of two processes that train the full model."""
    folder = tmp_path_factory.mktemp("killed")
    with pytest.raises(ProcessKilled, match="process 1 of 2 was killed"):
        share_work(2, CPU, train, folder, 1)
    assert [path.name for path in folder.rglob("*") if path.is_file()] == ["state.safetensors"]
    state = Checkpoint(folder / "full", "key").load()
    assert state is not None
    assert state[1]["iteration"] == TRAINING.checkpoint_every
    return folder


def test_a_killed_process_ends_the_training_which_resumes_to_the_same_bytes(
    two: Path, killed: Path, tmp_path: Path
) -> None:
    shutil.copytree(killed, tmp_path, dirs_exist_ok=True)
    share_work(2, CPU, train, tmp_path, None)
    for name in ("full.safetensors", "full.csv"):
        assert (tmp_path / name).read_bytes() == (two / name).read_bytes()


def test_one_process_goes_on_where_one_of_two_was_killed(one: Path, killed: Path, tmp_path: Path) -> None:
    shutil.copytree(killed, tmp_path, dirs_exist_ok=True)
    with patch.object(full_trainer, "warm_up", side_effect=AssertionError("the training began anew")):
        share_work(1, CPU, train, tmp_path, None)
    assert _differences(one / "full.safetensors", tmp_path / "full.safetensors") == {}
    resumed, whole = (np.loadtxt(folder / "full.csv", delimiter=",", skiprows=1) for folder in (tmp_path, one))
    np.testing.assert_allclose(resumed, whole, rtol=1e-5, atol=ROUNDING)


@pytest.mark.parametrize("working", [True, False], ids=["at work", "not yet at work"])
def test_processes_end_with_the_one_that_started_them(tmp_path: Path, working: bool) -> None:
    numbers, left_behind = tmp_path / "numbers", tmp_path / "left_behind"
    numbers.mkdir()
    left_behind.mkdir()
    words = [sys.executable, "-m", "tests.lasting_work", numbers]
    starter = subprocess.Popen(words, cwd=ROOT, env=os.environ | {"TMPDIR": str(left_behind)})
    try:
        assert soon(lambda: len(list(numbers.iterdir()) if working else children(starter.pid)) >= 2)
        started = children(starter.pid)
    finally:
        starter.kill()
        starter.wait()
    assert soon(lambda: not any(map(is_alive, started)))


def children(process: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{process}/task/{process}/children").read_text().split()]


def is_alive(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def soon(happens: Callable[[], bool]) -> bool:
    """Say whether something happens within a minute."""
    end = time.monotonic() + 60
    while not happens() and time.monotonic() < end:
        time.sleep(0.1)
    return happens()


def be_ended() -> None:
    """Let the second process be ended from outside, and the first notice that it is gone."""
    if dist.get_rank() == 1:
        os.kill(os.getpid(), signal.SIGTERM)
    dist.barrier()


def test_a_process_that_another_signal_ends_is_named() -> None:
    with pytest.raises(ProcessKilled, match="process 1 of 2 was ended by signal SIGTERM, and the others were stopped"):
        share_work(2, CPU, be_ended)


def test_what_a_file_system_refuses_a_process_is_raised_here(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(NotADirectoryError):
        share_work(2, CPU, (tmp_path / "file/folder").mkdir)


@pytest.mark.parametrize("processes", [0, True, "2"])
def test_the_number_of_processes_is_checked(processes: object) -> None:
    with pytest.raises(ConfigError, match="expected auto or a whole number from 1"):
        resolve_processes(processes, CPU, parts=1)


@pytest.mark.parametrize(("threads", "parts", "processes"), [(1, 3, 1), (2, 3, 2), (16, 3, 2), (16, 1, 1)])
def test_auto_is_two_processes_on_a_cpu_that_has_threads_and_parts_for_them(
    threads: int, parts: int, processes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch, "get_num_threads", lambda: threads)
    assert resolve_processes("auto", CPU, parts) == processes


@pytest.mark.parametrize(("available", "shared"), [(600, 512), (501, 500), (512, 512), (1, 1)])
def test_a_batch_of_all_there_is_divides_among_processes(
    available: int, shared: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(distributed, "world", lambda: distributed.World(0, 4))
    assert distributed.shared_batch(512, available) == shared


@pytest.mark.parametrize(
    ("gpus", "batches", "seeds"), [(1, 1, 1), (2, 2, 2), (3, 2, 3), (4, 4, 4), (7, 4, 7), (8, 8, 8), (16, 16, 10)]
)
def test_auto_is_as_many_gpus_as_divide_batches_or_have_seeds(
    gpus: int, batches: int, seeds: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.cuda, "device_count", lambda: gpus)
    assert resolve_processes("auto", torch.device("cuda"), parts=1) == batches
    assert resolve_processes("auto", torch.device("cuda"), parts=10) == seeds


def test_more_processes_than_gpus_share_seeds_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    assert resolve_processes(4, torch.device("cuda"), parts=10) == 4
    assert resolve_processes(2, torch.device("cuda"), parts=1) == 2
    with pytest.raises(ConfigError, match=r"processes of a stage are 3, but .* there are 2 GPUs; expected at most as"):
        resolve_processes(3, torch.device("cuda"), parts=1)
