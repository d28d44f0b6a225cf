"""Tensors come back as they were saved, and what is no file of theirs is told in a sentence."""

import errno
from pathlib import Path

import pytest
import safetensors.torch
import torch

from pipeline.errors import DataError, in_one_sentence
from pipeline.files import sha256
from pipeline.tensor_files import load_tensors, save_tensors


def test_tensors_that_cannot_be_written_leave_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(path: Path, content: bytes) -> None:
        with path.open("wb") as stream:
            stream.write(content[:4])
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    monkeypatch.setattr(Path, "write_bytes", refuse)
    with pytest.raises(SystemExit, match="No space left on device; look at the path"), in_one_sentence():
        save_tensors(tmp_path / "model.safetensors", {"weight": torch.ones(3)}, {})
    assert not list(tmp_path.iterdir())


def test_tensors_come_back(tmp_path: Path) -> None:
    shared = torch.arange(6.0).reshape(2, 3)
    tensors = {"transposed": shared.T, "same": shared, "index": torch.tensor(3), "empty": torch.zeros(0, 3)}
    save_tensors(tmp_path / "a.safetensors", tensors, {"note": "text"})
    loaded, texts = load_tensors(tmp_path / "a.safetensors")
    assert texts == {"note": "text"}
    assert loaded.keys() == tensors.keys()
    for name, tensor in tensors.items():
        assert torch.equal(loaded[name], tensor)
        assert loaded[name].dtype == tensor.dtype


@pytest.mark.parametrize("damage", ["missing", "truncated", "foreign"])
def test_a_file_that_holds_no_tensors_is_named(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "a.safetensors"
    if damage == "foreign":
        safetensors.torch.save_file({"a": torch.ones(9)}, path)
    if damage == "truncated":
        save_tensors(path, {"a": torch.ones(9)}, {})
        path.write_bytes(path.read_bytes()[:-8])
    with pytest.raises(DataError, match=r"a\.safetensors .*; run the stage that writes it"):
        load_tensors(path)


def test_an_entry_that_a_file_has_not_is_named(tmp_path: Path) -> None:
    path = tmp_path / "mesh.safetensors"
    save_tensors(path, {"faces": torch.zeros(2)}, {"size": "3"})
    tensors, texts = load_tensors(path)
    for entries, name in ((tensors, "vertices"), (texts, "config")):
        with pytest.raises(DataError, match=rf"mesh\.safetensors has no '{name}': it was written by another stage"):
            entries[name]


def test_equal_tensors_are_equal_bytes(tmp_path: Path) -> None:
    tensors = {name: torch.ones(3) for name in "cab"}
    texts = {f"key {number}": "text" for number in range(8)}
    save_tensors(tmp_path / "first", tensors, texts)
    save_tensors(tmp_path / "second", dict(sorted(tensors.items())), dict(reversed(texts.items())))
    assert sha256(tmp_path / "first") == sha256(tmp_path / "second")
