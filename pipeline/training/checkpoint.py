"""Keep the state of a training so that a killed one resumes and ends with the same bytes."""

import fcntl
import hashlib
import json
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.optim import Optimizer
from tqdm import tqdm

from pipeline.distributed import from_first, is_first, leads
from pipeline.errors import DataError
from pipeline.files import sha256
from pipeline.tensor_files import load_tensors, save_tensors

Part = nn.Module | Optimizer | torch.Generator | Tensor
ROOT = Path(__file__).parents[2]


class Checkpoint:
    """Hold the restart state of one training: tensors and JSON values in one file of a folder, or one for each part.

    The key says what the state belongs to (see `restart_key`): a state with another key is never loaded. Where
    processes share the training, the first one reads and writes the file and the others receive what it read.
    """

    def __init__(self, folder: Path, key: str, part: str = "") -> None:
        """Name the folder, the key and perhaps a part of the work; nothing is read or written yet."""
        self._folder = folder
        self._path = folder / f"state{part}.safetensors"
        self._key = key

    def part(self, name: str) -> "Checkpoint":
        """Return the state of one part of the work: what is done in parts need not be written again and again."""
        return Checkpoint(self._folder, self._key, f"-{name}")

    def load(self) -> tuple[dict[str, Tensor], dict[str, Any]] | None:
        """Return the saved tensors, on the CPU, and values; None, with a word, where their key differs."""
        return from_first(self._read() if is_first() else None)

    def save(self, tensors: Mapping[str, Tensor], values: Mapping[str, Any]) -> None:
        """Replace the saved state in one step: a kill leaves either the old or the new one, whole."""
        if is_first():
            save_tensors(self._path, tensors, {"key": self._key, "values": json.dumps(dict(values))})

    def clear(self) -> None:
        """Remove the saved state and that of all parts, once the stage's outputs are written."""
        for path in self._folder.glob("state*.safetensors"):
            path.unlink(missing_ok=True)

    def _read(self) -> tuple[dict[str, Tensor], dict[str, Any]] | None:
        if not self._path.exists():
            return None
        try:
            tensors, metadata = load_tensors(self._path)
        except DataError:
            raise DataError(f"the restart state {self._path} is damaged; remove it to train anew") from None
        if metadata["key"] != self._key:
            _say_left_out(self._folder)
            return None
        return tensors, json.loads(metadata["values"])


@cache
def _say_left_out(folder: Path) -> None:
    """Say once, however many parts the work has."""
    tqdm.write(
        f"restart states in {folder} are left out: they are of other code, settings or inputs, and the work starts "
        "anew",
        file=sys.stderr,
    )


@contextmanager
def reserved(folder: Path) -> Iterator[None]:
    """Keep others from the restart states in a folder until the block or its process ends, however that happens.

    Of processes that share a training the first one keeps it for all. Raises DataError, naming the process, where
    another has them: the stage of a `dvc repro` that was killed may still be at work.
    """
    if not leads():
        yield
        return
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "lock").open("a+") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            lock.seek(0)
            raise DataError(
                f"process {lock.read()} already trains with the restart states in {folder}; wait for it, or end it "
                "and run the same command again"
            ) from None
        lock.truncate(0)
        lock.write(str(os.getpid()))
        lock.flush()
        yield


def restart_key(
    config: object, inputs: Sequence[Path], seed: int | None, device: torch.device, precision: torch.dtype
) -> str:
    """Hash what a training's state depends on.

    That is the config, the seed (None where nothing is drawn), the kind of device (random generators differ), the
    precision, the bytes of the inputs, which are files or directories, every Python file of `pipeline` and `stages`,
    and PyTorch's version.
    """
    code = sorted(path for folder in ("pipeline", "stages") for path in (ROOT / folder).rglob("*.py"))
    contents = [sha256(path) for path in [*inputs, *code]]
    everything = [config, seed, device.type, precision, contents, torch.__version__]
    return hashlib.sha256(repr(everything).encode()).hexdigest()


def pack(**parts: Part) -> dict[str, Tensor]:
    """Collect the state of modules, optimizers, generators and tensors as tensors named `<part>.<entry>`.

    The tensors share memory with the parts. A tensor is stored under its part's own name.
    """
    return {name: tensor for part_name, part in parts.items() for name, tensor in _state(part_name, part).items()}


def unpack(tensors: Mapping[str, Tensor], **parts: Part) -> None:
    """Put packed state back into the same parts, in place. Raises KeyError or RuntimeError where they do not match."""
    for name, part in parts.items():
        own = {entry.removeprefix(f"{name}."): tensors[entry] for entry in tensors if entry.startswith(f"{name}.")}
        if isinstance(part, nn.Module):
            part.load_state_dict(own)
        elif isinstance(part, Optimizer):
            _restore_optimizer(part, own)
        elif isinstance(part, torch.Generator):
            part.set_state(own["state"])
        else:
            with torch.no_grad():
                part.copy_(tensors[name])


def _state(name: str, part: Part) -> dict[str, Tensor]:
    if isinstance(part, nn.Module):
        return {f"{name}.{entry}": tensor for entry, tensor in part.state_dict().items()}
    if isinstance(part, Optimizer):
        return {f"{name}.{entry}": tensor for entry, tensor in _optimizer_state(part).items()}
    if isinstance(part, torch.Generator):
        return {f"{name}.state": part.get_state()}
    return {name: part}


def _optimizer_state(optimizer: Optimizer) -> dict[str, Tensor]:
    tensors: dict[str, Tensor] = {}
    for position, group in enumerate(optimizer.param_groups):
        for name, value in group.items():
            if _is_number(value):
                tensors[f"group.{position}.{name}"] = torch.tensor(value, dtype=torch.float64)
    for position, parameter in enumerate(_parameters(optimizer)):
        for name, value in optimizer.state[parameter].items():
            if isinstance(value, Tensor):
                tensors[f"state.{position}.{name}"] = value
    return tensors


def _restore_optimizer(optimizer: Optimizer, tensors: Mapping[str, Tensor]) -> None:
    parameters = _parameters(optimizer)
    optimizer.state.clear()
    for entry, tensor in tensors.items():
        kind, position, name = entry.split(".", 2)
        if kind == "group":
            value = tensor.tolist()
            optimizer.param_groups[int(position)][name] = tuple(value) if isinstance(value, list) else value
        else:
            parameter = parameters[int(position)]
            # The parameter's memory layout (channels last) too: element-wise kernels may round by layout.
            # Numbers go to its device as well, where a fused Adam counts its steps.
            same_shape = tensor.shape == parameter.shape
            restored = torch.empty_like(parameter).copy_(tensor) if same_shape else tensor.to(parameter.device)
            optimizer.state[parameter][name] = restored


def _parameters(optimizer: Optimizer) -> list[Tensor]:
    return [parameter for group in optimizer.param_groups for parameter in group["params"]]


def _is_number(value: object) -> bool:
    if isinstance(value, tuple):
        return all(_is_number(item) for item in value)
    return isinstance(value, float)
