"""Numba's compiler as kernels need it; importing this module imports numba."""

import hashlib
from functools import partial
from pathlib import Path

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
config.CACHE_DIR = str(Path(config.CACHE_DIR or _FOLDER / "__pycache__") / f"kernels-{_CONTENT}")  # pyright: ignore[reportAttributeAccessIssue]

njit = partial(numba.njit, cache=True, error_model="numpy")
"""Compile a function and keep what was compiled; a division by zero gives infinity instead of being looked for."""
