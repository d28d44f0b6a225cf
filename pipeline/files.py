"""Write files whole or not at all, with bytes that depend on their content alone."""

import errno
import fcntl
import hashlib
import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pipeline.errors import DataError

_FULL = {errno.ENOSPC, errno.EDQUOT}


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path` that becomes `path` when the block ends without an error.

    The block creates a file or a directory there. After an error, `path` is as it was before, and after a kill too, but
    for a directory that was just being replaced, which is missing then. What an earlier kill left is removed first. A
    link at `path` is replaced, and what it points to stays. A full disk is an OSError that names `path`.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".partial-{path.name}")
    _remove(temporary)
    try:
        yield temporary
        if path.is_dir():
            _remove(path)
        temporary.replace(path)
    except OSError as error:
        if error.errno in _FULL:
            error.filename = error.filename or str(path)
        raise
    finally:
        _remove(temporary)


@contextmanager
def alone(path: Path) -> Iterator[None]:
    """Keep other processes that ask for the same from `path` inside the block. Raises DataError where one is there."""
    path.parent.mkdir(parents=True, exist_ok=True)
    lock = path.with_name(f".lock-{path.name}")
    with lock.open("w") as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            is_free = lock.exists() and os.path.samestat(os.fstat(stream.fileno()), lock.stat())  # else just removed
        except BlockingIOError:
            is_free = False
        if not is_free:
            raise DataError(f"another process is writing {path}; wait for it, or name another path")
        try:
            yield
        finally:
            lock.unlink(missing_ok=True)


def write_text(path: Path, text: str, errors: str = "strict") -> None:
    """Write a text as UTF-8, its lines ended as on Unix, atomically; `errors` as of `str.encode`."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8", errors=errors, newline="\n")


def write_json(path: Path, value: Any) -> None:
    """Write a value as JSON with sorted keys and a final newline, atomically. Raises DataError for NaN or infinity."""
    try:
        text = json.dumps(value, indent=2, sort_keys=True, allow_nan=False)
    except ValueError:
        raise DataError(f"{path} would hold a figure that is not finite; look at the stage's inputs") from None
    write_text(path, text + "\n")


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


def _files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
