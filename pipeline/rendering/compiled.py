"""Numba's compiler as kernels need it; importing this module imports numba."""

from functools import partial

import numba
from numba import prange
from numba.core import config

__all__ = ["njit", "prange"]

# The OpenMP layer would change PyTorch's number of threads at its first parallel call, and rounding with it: a resumed
# training would then differ from an uninterrupted one.
config.THREADING_LAYER = "workqueue"  # pyright: ignore[reportAttributeAccessIssue]

njit = partial(numba.njit, cache=True, error_model="numpy")
"""Compile a function and keep what was compiled; a division by zero gives infinity instead of being looked for."""
