"""Save tensors and texts as safetensors, and load them."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TypeVar

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor, nn

from pipeline.errors import DataError
from pipeline.files import atomic_path

Entry = TypeVar("Entry")


def save_tensors(path: Path, tensors: Mapping[str, Tensor], metadata: Mapping[str, str]) -> None:
    """Save named tensors and a few texts as safetensors, atomically and byte-stable.

    Tensors are copied to the CPU. The texts share one header entry, because the format does not order its entries.
    """
    copies = {name: _copied(tensors[name]) for name in sorted(tensors)}
    header = {"texts": json.dumps(dict(metadata), sort_keys=True)}
    with atomic_path(path) as temporary:
        # save_file would write, and after a kill leave, a temporary file of its own.
        temporary.write_bytes(save(copies, header))


def _copied(tensor: Tensor) -> Tensor:
    return tensor.detach().to("cpu", copy=True, memory_format=torch.contiguous_format)


class _Entries(dict[str, Entry]):
    """What a file holds by name; a name that it has not is an error in one sentence."""

    def __init__(self, entries: Mapping[str, Entry], path: Path) -> None:
        super().__init__(entries)
        self.path = path

    def __missing__(self, name: str) -> Entry:
        raise DataError(f"{self.path} has no '{name}': it was written by another stage or by other code; name another")


def load_tensors(path: Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    """Load what `save_tensors` saved: tensors on the CPU, and texts.

    Raises DataError for any other file, and later for an entry that is asked for by name but is not there.
    """
    if not path.is_file():
        raise DataError(f"{path} does not exist; run the stage that writes it first")
    path.open("rb").close()  # an error names what forbids it; one of safe_open says that there is no such file
    try:
        return _read_tensors(path)
    except (SafetensorError, KeyError):
        raise DataError(
            f"{path} is damaged or not one of this pipeline's files; run the stage that writes it"
        ) from None


def load_weights(network: nn.Module, tensors: Mapping[str, Tensor], path: Path) -> None:
    """Put the tensors of a file into a network. Raises DataError where some are missing or of another shape."""
    state = network.state_dict()
    try:
        network.load_state_dict({name: tensor for name, tensor in tensors.items() if name in state})
    except RuntimeError:
        raise DataError(
            f"{path} holds other weights than this code's networks have; run the stage that writes it again"
        ) from None


def _read_tensors(path: Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    with safe_open(path, framework="pt") as stored:
        tensors = {name: stored.get_tensor(name) for name in stored.keys()}  # noqa: SIM118
        texts = json.loads((stored.metadata() or {})["texts"])
        return _Entries(tensors, path), _Entries(texts, path)
