"""Numba's compiler, set up to leave PyTorch's threads alone; importing this module imports numba."""

import numba
from numba import njit, prange

__all__ = ["njit", "prange"]

# The OpenMP layer would change PyTorch's number of threads at its first parallel call, and rounding with it: a resumed
# training would then differ from an uninterrupted one.
numba.config.THREADING_LAYER = "workqueue"
