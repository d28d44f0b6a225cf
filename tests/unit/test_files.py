"""Files appear whole or not at all, and their bytes depend on their content alone."""

import errno
from pathlib import Path

import pytest
import torch

from pipeline.errors import DataError, in_one_sentence
from pipeline.files import alone, atomic_path, read_json, sha256, write_json


def _write_half(path: Path) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text("half")
        raise RuntimeError("interrupted")


def test_an_error_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "value.txt"
    path.write_text("old")
    with pytest.raises(RuntimeError, match="interrupted"):
        _write_half(path)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_memory_that_does_not_suffice_is_one_sentence() -> None:
    with (
        pytest.raises(SystemExit, match=r"^error: there is not enough memory \(.*\); lower `memory`"),
        in_one_sentence(),
    ):
        torch.empty(1 << 50, dtype=torch.uint8)
    with pytest.raises(SystemExit, match=r"\(CUDA out of memory\. Tried to allocate 1 GiB\); lower"), in_one_sentence():
        raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 1 GiB\nSee documentation")
    with pytest.raises(SystemExit, match=r"not enough memory \(\[Errno 12\] mapped\); lower"), in_one_sentence():
        raise OSError(errno.ENOMEM, "mapped")
    with pytest.raises(RuntimeError, match="shapes"), in_one_sentence():
        torch.mm(torch.ones(2, 2), torch.ones(3, 3))


def test_a_full_disk_names_what_was_written(tmp_path: Path) -> None:
    expected = rf"^error: {tmp_path}/value.txt: No space left on device; look at the path"
    with pytest.raises(SystemExit, match=expected), in_one_sentence(), atomic_path(tmp_path / "value.txt"):
        raise OSError(errno.ENOSPC, "No space left on device")


def test_what_a_system_error_wraps_is_told() -> None:
    wrapped, own = SystemError("a function returned a result with an exception set"), SystemError("its own")
    wrapped.__cause__ = DataError("the disk is gone")
    with pytest.raises(SystemExit, match=r"^error: the disk is gone$"), in_one_sentence():
        raise wrapped
    with pytest.raises(SystemError, match="its own"), in_one_sentence():
        raise own


def test_one_process_at_a_time_writes(tmp_path: Path) -> None:
    path = tmp_path / "folder"
    with (
        alone(path),
        alone(tmp_path / "other"),
        pytest.raises(DataError, match=r"is writing .*folder; wait"),
        alone(path),
    ):
        pass
    with alone(path):
        pass
    assert not list(tmp_path.iterdir())


def test_what_a_kill_left_behind_is_removed(tmp_path: Path) -> None:
    path = tmp_path / "folder"
    with atomic_path(path) as temporary:
        temporary.mkdir()
        (temporary / "half").touch()
        leftover = temporary
    leftover.mkdir()
    (leftover / "stale").touch()
    with atomic_path(path) as temporary:
        temporary.mkdir()
        (temporary / "whole").touch()
    assert [file.name for file in path.iterdir()] == ["whole"]
    assert list(tmp_path.iterdir()) == [path]


def test_a_link_is_replaced_and_not_followed(tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "old").touch()
    (tmp_path / "link").symlink_to(elsewhere)
    with atomic_path(tmp_path / "link") as temporary:
        temporary.mkdir()
        (temporary / "new").touch()
    assert not (tmp_path / "link").is_symlink()
    assert [[file.name for file in folder.iterdir()] for folder in (tmp_path / "link", elsewhere)] == [["new"], ["old"]]


def test_temporary_names_keep_the_suffix(tmp_path: Path) -> None:
    with atomic_path(tmp_path / "new" / "image.png") as temporary:
        assert temporary.suffix == ".png"
        temporary.touch()
    assert (tmp_path / "new" / "image.png").exists()


def test_json_is_sorted_and_ends_with_a_newline(tmp_path: Path) -> None:
    path = tmp_path / "value.json"
    write_json(path, {"b": 1, "a": [1.5, None]})
    assert path.read_bytes() == b'{\n  "a": [\n    1.5,\n    null\n  ],\n  "b": 1\n}\n'
    assert read_json(path) == {"a": [1.5, None], "b": 1}


def test_json_refuses_values_that_are_not_numbers(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="would hold a figure that is not finite"):
        write_json(tmp_path / "value.json", {"loss": float("nan")})
    assert not list(tmp_path.iterdir())


def test_the_hash_of_a_directory_depends_on_names_and_contents(tmp_path: Path) -> None:
    hashes = []
    for name, content in (("a", "1"), ("b", "1"), ("a", "2")):
        folder = tmp_path / f"{name}{content}"
        (folder / "inner").mkdir(parents=True)
        (folder / "inner" / name).write_text(content)
        hashes.append(sha256(folder))
    assert len(set(hashes)) == 3
    assert sha256(tmp_path / "a1") == hashes[0]
