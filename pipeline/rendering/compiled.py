"""Numba's compiler, set up to leave PyTorch's threads alone; importing this module imports numba."""

from numba import njit, prange
from numba.core import config

__all__ = ["njit", "prange"]

# The OpenMP layer would change PyTorch's number of threads at its first parallel call, and rounding with it: a resumed
# training would then differ from an uninterrupted one.
config.THREADING_LAYER = "workqueue"  # pyright: ignore[reportAttributeAccessIssue]
