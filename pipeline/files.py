"""Write files whole or not at all, with bytes that depend on their content alone."""

import hashlib
import json
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor, nn

from pipeline.errors import DataError

Entry = TypeVar("Entry")


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path` that becomes `path` when the block ends without an error.

    The block creates a file or a directory there. After an error, `path` is as it was before, and after a kill too, but
    for a directory that was just being replaced, which is missing then. What an earlier kill left is removed first. A
    link at `path` is replaced, and what it points to stays.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".partial-{path.name}")
    _remove(temporary)
    try:
        yield temporary
        if path.is_dir():
            _remove(path)
        temporary.replace(path)
    finally:
        _remove(temporary)


def write_json(path: Path, value: Any) -> None:
    """Write a value as JSON with sorted keys and a final newline, atomically. Raises DataError for NaN or infinity."""
    try:
        text = json.dumps(value, indent=2, sort_keys=True, allow_nan=False)
    except ValueError:
        raise DataError(f"{path} would hold a figure that is not finite; look at the stage's inputs") from None
    with atomic_path(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8", newline="\n")


def read_json(path: Path) -> Any:
    """Read the value of a JSON file. Raises DataError for a file that is damaged."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except ValueError:
        raise DataError(f"{path} is damaged: it holds no JSON; remove it, and run again what writes it") from None


def sha256(path: Path) -> str:
    """Hash a file, or every file of a directory with its relative name, as 64 hexadecimal digits."""
    if path.is_dir():
        listing = [f"{sha256(file)} {file.relative_to(path).as_posix()}\n" for file in _files(path)]
        return hashlib.sha256("".join(listing).encode()).hexdigest()
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def save_tensors(path: Path, tensors: Mapping[str, Tensor], metadata: Mapping[str, str]) -> None:
    """Save named tensors and a few texts as safetensors, atomically and byte-stable.

    Tensors are copied to the CPU. The texts share one header entry, because the format does not order its entries.
    """
    copies = {name: tensors[name].detach().cpu().clone().contiguous() for name in sorted(tensors)}
    header = {"texts": json.dumps(dict(metadata), sort_keys=True)}
    with atomic_path(path) as temporary:
        # save_file would write, and after a kill leave, a temporary file of its own.
        temporary.write_bytes(save(copies, header))


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


def _files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
