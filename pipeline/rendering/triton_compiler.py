"""Triton's compiler for CUDA devices, where PyTorch brings it; importing this module imports triton."""

from typing import Any

from pipeline.errors import DeviceError

try:
    import triton
    import triton.language as tl
except ImportError:
    raise DeviceError(
        "rendering on a GPU needs Triton, which is not installed here: install PyTorch's CUDA build, which brings it, "
        "or set device to cpu"
    ) from None

__all__ = ["launch", "tl", "triton"]


def launch(kernel: Any, pictures: int, count: int, block: int, *arguments: Any) -> None:
    """Start a kernel whose programs work on a block of the `count` items of one picture.

    The kernel takes the block's size last. Products and sums are rounded one by one, as on the CPU: fused, they would
    choose other faces at edges.
    """
    kernel[(pictures, triton.cdiv(count, block))](*arguments, block, enable_fp_fusion=False)
