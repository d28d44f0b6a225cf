"""Numba's compiler as kernels need it; importing this module imports numba."""

import atexit
import hashlib
from collections.abc import Iterable
from contextlib import suppress
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile

import numba
from numba import prange
from numba.core import config

__all__ = ["njit", "prange"]

# The OpenMP layer would change PyTorch's number of threads at its first parallel call, and rounding with it: a resumed
# training would then differ from an uninterrupted one.
config.THREADING_LAYER = "workqueue"  # pyright: ignore[reportAttributeAccessIssue]

_FOLDER = Path(__file__).parent
KERNELS = (*sorted(_FOLDER.glob("*_cpu.py")), Path(__file__), _FOLDER.parent / "geometry" / "camera.py")
"""What kernels are compiled from. Numba compiles a function anew when its own file changes, but not when one changes
from which it takes another kernel or a constant: what was compiled is kept apart by what these files hold."""
_CONTENT = hashlib.sha256(b"".join(path.read_bytes() for path in KERNELS)).hexdigest()[:16]


def first_writable(folders: Iterable[str | Path]) -> Path:
    """Return the first folder that can be written, made where it is missing, or else one that goes with the process.

    Where its folder cannot be written numba takes another by itself, which does not know what the files hold.
    """
    for folder in folders:
        with suppress(OSError, RuntimeError):  # the second where a user has no home
            path = Path(folder).expanduser()
            path.mkdir(parents=True, exist_ok=True)
            TemporaryFile(dir=path).close()
            return path
    passing = TemporaryDirectory(prefix="kernels-")
    atexit.register(passing.cleanup)
    return Path(passing.name)


_BASES = (config.CACHE_DIR or _FOLDER / "__pycache__", "~/.cache/kato3d")  # pyright: ignore[reportAttributeAccessIssue]
config.CACHE_DIR = str(first_writable(f"{base}/kernels-{_CONTENT}" for base in _BASES))  # pyright: ignore[reportAttributeAccessIssue]

njit = partial(numba.njit, cache=True, error_model="numpy")
"""Compile a function and keep what was compiled; a division by zero gives infinity instead of being looked for."""
