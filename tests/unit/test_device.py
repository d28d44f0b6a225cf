"""Devices, and the memory that a process keeps."""

import platform
import subprocess
import sys

import pytest
import torch

from pipeline.device import prepare_process, resolve_device, resolve_precision
from pipeline.errors import ConfigError

SMALL_PAGES = 41  # PR_SET_THP_DISABLE: on some hosts a fault maps 2 MB instead of 4 kB

FAULTS = f"""
import ctypes, resource, sys, torch
ctypes.CDLL(None).prctl({SMALL_PAGES}, 1, 0, 0, 0)
if sys.argv[1:]:
    from pipeline.device import resolve_device
    resolve_device("cpu")

def large_tensors(): [torch.ones(2**24) for _ in range(5)]

for _ in range(8): large_tensors()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
large_tensors()
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def test_devices_are_checked() -> None:
    assert resolve_device("cpu") == torch.device("cpu")
    with pytest.raises(ConfigError, match="device is 'gpu'; expected auto, cpu or cuda"):
        resolve_device("gpu")


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_missing_gpu_is_an_error() -> None:
    assert resolve_device("auto") == torch.device("cpu")
    with pytest.raises(ConfigError, match="no GPU"):
        resolve_device("cuda")


@pytest.mark.parametrize(("avx512", "amx"), [(True, False), (False, True), (False, False)])
def test_precision_is_what_the_device_multiplies_fast(avx512: bool, amx: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("torch.cpu._is_avx512_bf16_supported", lambda: avx512)
    monkeypatch.setattr("torch.cpu._is_amx_tile_supported", lambda: amx)
    expected = torch.bfloat16 if avx512 or amx else torch.float32
    device = torch.device("cpu")
    assert resolve_precision("auto", device) == expected
    assert resolve_precision("float32", device) == torch.float32
    assert resolve_precision("bfloat16", device) == torch.bfloat16
    with pytest.raises(ConfigError, match="precision is 'half'; expected auto, float32 or bfloat16"):
        resolve_precision("half", device)


@pytest.mark.parametrize(("capability", "expected"), [((7, 5), torch.float32), ((8, 0), torch.bfloat16)])
def test_gpus_multiply_bfloat16_faster_from_capability_8(
    capability: tuple[int, int], expected: torch.dtype, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("torch.cuda.get_device_capability", lambda _: capability)
    assert resolve_precision("auto", torch.device("cuda")) == expected


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc's allocator can be told so")
def test_large_tensors_come_from_memory_that_was_freed() -> None:
    def page_faults(*arguments: str) -> int:
        command = [sys.executable, "-c", FAULTS, *arguments]
        return int(subprocess.run(command, check=True, capture_output=True, text=True).stdout)

    assert page_faults("keep") < 50 < 5000 < page_faults()


def test_matrix_products_of_a_gpu_are_not_rounded() -> None:
    prepare_process()
    assert torch.backends.cudnn.conv.fp32_precision == "tf32"  # pyright: ignore[reportAttributeAccessIssue]
    assert torch.backends.cuda.matmul.fp32_precision == "ieee"
