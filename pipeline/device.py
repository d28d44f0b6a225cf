"""Choose where tensors live, and how many of them."""

import ctypes
import math
import platform
from functools import cache
from typing import Any

import torch
from torch import Tensor

from pipeline.errors import ConfigError

_M_TRIM_THRESHOLD, _M_MMAP_MAX = -1, -4  # of glibc's malloc.h; -1 never trims, 0 maps no allocation by itself


def resolve_device(name: str) -> torch.device:
    """Turn `cpu`, `cuda` or `auto` (a GPU where there is one) into a device, and prepare this process for it.

    Raises ConfigError for any other name, and for `cuda` on a machine without a GPU.
    """
    if name not in ("auto", "cpu", "cuda"):
        raise ConfigError(f"device is '{name}'; expected auto, cpu or cuda")
    if name == "cuda" and not torch.cuda.is_available():
        raise ConfigError("device is 'cuda' but PyTorch finds no GPU here; set device to auto or cpu")
    prepare_process()
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    return torch.device(name)


def prepare_process() -> None:
    """Set what every process that computes has in common.

    On a GPU, convolutions round their factors to TF32; matrix products do not, which would move projected vertices
    (docs/decisions/gpu.md). Memory that is freed stays with the process.
    """
    torch.backends.cudnn.conv.fp32_precision = "tf32"  # pyright: ignore[reportAttributeAccessIssue]
    torch.backends.cuda.matmul.fp32_precision = "ieee"
    _keep_freed_memory()


def _keep_freed_memory() -> None:
    """Let this process use the memory again that its main thread frees, where its C library is glibc.

    Otherwise every large tensor is memory that the system has just cleared, page by page: a fifth of a training step
    (docs/decisions/speed.md). The system gets it back when the process ends.
    """
    if platform.libc_ver()[0] == "glibc":
        libc = ctypes.CDLL(None)
        libc.mallopt(_M_MMAP_MAX, 0)
        libc.mallopt(_M_TRIM_THRESHOLD, -1)


def resolve_precision(name: Any, device: torch.device) -> torch.dtype:
    """Turn `float32`, `bfloat16` or `auto` (bfloat16 where the device multiplies it faster) into a type of numbers.

    GPUs since Ampere do, and CPUs with AVX512-BF16 or AMX; others are many times slower with it
    (docs/decisions/features.md).
    Raises ConfigError for any other name.
    """
    if name not in ("auto", "float32", "bfloat16"):
        raise ConfigError(f"precision is {name!r}; expected auto, float32 or bfloat16")
    low = name == "bfloat16" or (name == "auto" and _multiplies_bfloat16(device))
    return torch.bfloat16 if low else torch.float32


def _multiplies_bfloat16(device: torch.device) -> bool:
    if device.type == "cuda":
        return torch.cuda.get_device_capability(device) >= (8, 0)
    return torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported()


def resolve_memory(gibibytes: Any) -> int:
    """Turn the parameter `memory` into bytes. Raises ConfigError for anything but a number above zero."""
    if isinstance(gibibytes, bool) or not isinstance(gibibytes, int | float) or not 0 < gibibytes * 2**30 < math.inf:
        raise ConfigError(f"memory is {gibibytes!r}; expected a number of GiB above 0, such as 8")
    return int(gibibytes * 2**30)


def constant(values: tuple[float | tuple[float, ...], ...], like: Tensor) -> Tensor:
    """Return numbers as a tensor of the type and on the device of another; it is shared: do not change it.

    Made once: copying numbers to a GPU makes the host wait for everything before it.
    """
    return _constant(values, like.dtype, like.device)


@cache
def _constant(values: tuple[float | tuple[float, ...], ...], dtype: torch.dtype, device: torch.device) -> Tensor:
    return torch.tensor(values, dtype=dtype, device=device)
