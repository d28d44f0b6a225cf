"""A training stopped anywhere and resumed ends with the same bits."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import pytest
import torch
from torch import Tensor, nn
from torch.optim import SGD, Adam, Optimizer

from pipeline.errors import DataError
from pipeline.training.checkpoint import Checkpoint, pack, reserved, restart_key, unpack


def adam(parameters: Iterable[nn.Parameter]) -> Optimizer:
    return Adam(parameters, lr=0.1, betas=(0.5, 0.99))


def fused_adam(parameters: Iterable[nn.Parameter]) -> Optimizer:
    return Adam(parameters, lr=0.1, betas=(0.5, 0.99), fused=True)


def nesterov(parameters: Iterable[nn.Parameter]) -> Optimizer:
    return SGD(parameters, lr=0.1, momentum=0.9, nesterov=True)


class Training:
    """A small training with every kind of state: weights, running statistics, optimizer, generator, memory."""

    def __init__(self, make_optimizer: Callable[[Iterable[nn.Parameter]], Optimizer]) -> None:
        self.rng = torch.Generator().manual_seed(1)
        with torch.random.fork_rng():
            torch.manual_seed(0)
            self.model = nn.Sequential(nn.Conv2d(3, 4, 3), nn.BatchNorm2d(4), nn.Flatten(), nn.Linear(16, 1))
        for parameter in self.model.parameters():
            if parameter.ndim == 4:
                parameter.data = parameter.data.contiguous(memory_format=torch.channels_last)
        self.optimizer = make_optimizer(self.model.parameters())
        self.best = torch.full((2,), torch.inf)

    def parts(self) -> dict[str, nn.Module | Optimizer | torch.Generator | Tensor]:
        return {"model": self.model, "optimizer": self.optimizer, "rng": self.rng, "best": self.best}

    def step(self) -> None:
        pictures = torch.rand(2, 3, 4, 4, generator=self.rng)
        losses = (self.model(pictures)[:, 0] - 1).square()
        self.best.copy_(torch.minimum(self.best, losses.detach()))
        self.optimizer.zero_grad()
        losses.sum().backward()
        self.optimizer.step()
        self.optimizer.param_groups[0]["lr"] *= 0.9


@pytest.mark.parametrize("make_optimizer", [adam, fused_adam, nesterov])
@pytest.mark.parametrize("stop", [0, 1, 3])
def test_resumed_equals_uninterrupted(make_optimizer: Callable[..., Optimizer], stop: int, tmp_path: Path) -> None:
    whole, stopped, resumed = Training(make_optimizer), Training(make_optimizer), Training(make_optimizer)
    for _ in range(5):
        whole.step()
    for _ in range(stop):
        stopped.step()
    Checkpoint(tmp_path, "key").save(pack(**stopped.parts()), {"iteration": stop})

    loaded = Checkpoint(tmp_path, "key").load()
    assert loaded is not None
    tensors, values = loaded
    unpack(tensors, **resumed.parts())
    for _ in range(values["iteration"], 5):
        resumed.step()
    expected, actual = pack(**whole.parts()), pack(**resumed.parts())
    assert expected.keys() == actual.keys()
    for name in expected:
        assert torch.equal(expected[name], actual[name]), name


def test_restoring_replaces_later_state() -> None:
    training = Training(adam)
    training.step()
    early = {name: tensor.clone() for name, tensor in pack(**training.parts()).items()}
    training.step()
    unpack(early, **training.parts())
    assert all(torch.equal(tensor, early[name]) for name, tensor in pack(**training.parts()).items())


def test_state_of_another_training_is_refused(tmp_path: Path) -> None:
    Checkpoint(tmp_path, "one").save({"weight": torch.ones(2)}, {"rows": [{"loss": 0.5}]})
    assert Checkpoint(tmp_path, "other").load() is None
    assert Checkpoint(tmp_path / "nowhere", "one").load() is None
    loaded = Checkpoint(tmp_path, "one").load()
    assert loaded is not None
    assert loaded[1] == {"rows": [{"loss": 0.5}]}


def test_cleared_state_is_gone(tmp_path: Path) -> None:
    checkpoint = Checkpoint(tmp_path, "key")
    checkpoint.clear()
    checkpoint.save({}, {})
    checkpoint.part("0").save({}, {})
    checkpoint.clear()
    assert checkpoint.load() is None
    assert not [*tmp_path.iterdir()]


def test_parts_are_kept_apart(tmp_path: Path) -> None:
    checkpoint = Checkpoint(tmp_path, "key")
    checkpoint.part("0").save({}, {"done": 1})
    checkpoint.part("1").save({}, {"done": 2})
    assert checkpoint.load() is None
    assert Checkpoint(tmp_path, "key").part("0").load() == ({}, {"done": 1})
    assert Checkpoint(tmp_path, "other").part("0").load() is None


def test_a_damaged_state_is_named(tmp_path: Path) -> None:
    (tmp_path / "state.safetensors").touch()
    with pytest.raises(DataError, match=r"restart state .*state\.safetensors is damaged; remove it"):
        Checkpoint(tmp_path, "key").load()


def test_parts_that_do_not_match_are_refused() -> None:
    with pytest.raises(RuntimeError, match="Missing key"):
        unpack({"model.weight": torch.ones(1, 2)}, model=nn.Linear(2, 1))
    with pytest.raises(KeyError, match="best"):
        unpack({}, best=torch.ones(2))


def test_a_state_of_other_settings_is_left_out_with_a_word(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Checkpoint(tmp_path, "before").save({"best": torch.ones(2)}, {})
    assert Checkpoint(tmp_path, "before").load() is not None
    assert capsys.readouterr().err == ""
    assert Checkpoint(tmp_path, "now").load() is None
    said = f"restart states in {tmp_path} are left out: they are of other code, settings or inputs"
    assert said in capsys.readouterr().err


def test_states_of_many_parts_are_left_out_with_one_word(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in "ab":
        Checkpoint(tmp_path, "before").part(name).save({}, {})
    assert [Checkpoint(tmp_path, "now").part(name).load() for name in "ab"] == [None, None]
    assert capsys.readouterr().err.count("left out") == 1


HOLD = "import sys, time; from pathlib import Path; from pipeline.training.checkpoint import reserved\n\
with reserved(Path(sys.argv[1])): print('held', flush=True); time.sleep(60)"


def test_restart_states_are_one_process_s_until_it_ends(tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", HOLD, str(tmp_path)], stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "held\n"
        with pytest.raises(DataError, match=f"^process {other.pid} already trains with the restart states in"):
            reserved(tmp_path).__enter__()
        other.kill()
    for _ in range(2):
        with reserved(tmp_path):
            assert (tmp_path / "lock").read_text() == str(os.getpid())


@dataclass(frozen=True)
class Settings:
    rate: float


def test_the_key_depends_on_config_inputs_seed_device_and_precision(tmp_path: Path) -> None:
    def key(rate: float, inputs: list[Path], seed: int, precision: torch.dtype, device: str = "cpu") -> str:
        return restart_key(Settings(rate), inputs, seed, torch.device(device), precision)

    data = tmp_path / "data"
    data.mkdir()
    (data / "car.npy").write_bytes(b"1")
    keys = [key(0.1, [data], 0, torch.float32), key(0.2, [data], 0, torch.float32)]
    keys += [key(0.1, [data], 1, torch.float32), key(0.1, [], 0, torch.float32), key(0.1, [data], 0, torch.bfloat16)]
    keys.append(key(0.1, [data], 0, torch.float32, "cuda"))
    (data / "car.npy").write_bytes(b"2")
    keys.append(key(0.1, [data], 0, torch.float32))
    assert len(set(keys)) == 7
    assert keys[6] == key(0.1, [data], 0, torch.float32)


@pytest.mark.parametrize("code", ["pipeline/training/full.py", "stages/train_full.py"])
def test_the_key_depends_on_the_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: str) -> None:
    monkeypatch.setattr("pipeline.training.checkpoint.ROOT", tmp_path)
    keys = []
    for text in ("a = 1", "a = 2"):
        (tmp_path / code).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / code).write_text(text)
        keys.append(restart_key(Settings(0.1), [], 0, torch.device("cpu"), torch.float32))
    assert keys[0] != keys[1]


def test_optimizer_state_is_restored_where_the_parameters_are() -> None:
    training, elsewhere = Training(fused_adam), Training(fused_adam)
    training.step()
    elsewhere.model.to("meta")
    optimizer = fused_adam(elsewhere.model.parameters())
    unpack(pack(optimizer=training.optimizer), optimizer=optimizer)
    devices = {value.device.type for state in optimizer.state.values() for value in state.values()}
    assert devices == {"meta"}


def test_the_key_depends_on_pytorchs_version(monkeypatch: pytest.MonkeyPatch) -> None:
    def key() -> str:
        return restart_key(None, [], 0, torch.device("cpu"), torch.float32)

    before = key()
    monkeypatch.setattr(torch, "__version__", "0.0")
    assert key() != before
