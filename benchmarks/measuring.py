"""What benchmarks on any device share: waiting for it, its rates, and what a step asks of it."""

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor
from torch.profiler import profile
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves
from torch.utils.flop_counter import flop_registry

from pipeline.device import resolve_device

DEVICE = resolve_device("auto")
ON_GPU = DEVICE.type == "cuda"


def complete(function: Callable[[], object]) -> Callable[[], None]:
    """Let a function end when the device has done what it asked for."""

    def call() -> None:
        function()
        if ON_GPU:
            torch.cuda.synchronize()

    return call


def seconds(function: Callable[[], object], repeats: int) -> float:
    """Return the mean time of a call, after two to warm up."""
    for _ in range(2):
        complete(function)()
    start = time.perf_counter()
    complete(lambda: [function() for _ in range(repeats)])()
    return (time.perf_counter() - start) / repeats


def seconds_on_gpu(function: Callable[[], object]) -> float:
    """Return the time that a GPU spends in a function, without the host's: a graph of it is replayed."""
    stream = torch.cuda.Stream()
    with torch.cuda.stream(stream):
        for _ in range(3):
            function()
    torch.cuda.synchronize()
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph, stream=stream):
        function()
    return seconds(graph.replay, repeats=200)


def matrix_rate(precision: torch.dtype) -> float:
    """Measure floating-point operations a second of a large matrix product; float32 as convolutions round it."""
    size = 8192 if ON_GPU else 2048
    factors = torch.randn(2, size, size, device=DEVICE, dtype=precision)
    rounding = torch.backends.cuda.matmul.fp32_precision
    torch.backends.cuda.matmul.fp32_precision = "tf32"
    rate = 2 * size**3 / seconds(lambda: factors[0] @ factors[1], repeats=10)
    torch.backends.cuda.matmul.fp32_precision = rounding
    return rate


def bandwidth() -> float:
    """Measure bytes a second that a copy reads and writes."""
    source = torch.zeros(2**30 if ON_GPU else 2**27, dtype=torch.uint8, device=DEVICE)
    target = torch.empty_like(source)
    return 2 * source.numel() / seconds(lambda: target.copy_(source), repeats=10)


class CountWork(TorchDispatchMode):
    """Add up the operations of matrix products, and the bytes that all but views read and write if nothing is kept."""

    def __init__(self) -> None:
        super().__init__()
        self.operations, self.bytes = 0, 0

    def __torch_dispatch__(
        self,
        func: Any,
        types: Sequence[type],
        args: tuple[Any, ...] = (),
        kwargs: Mapping[str, Any] | None = None,
    ) -> Any:
        result = func(*args, **(kwargs or {}))
        if not func.is_view:
            leaves = tree_leaves((args, kwargs, result))
            self.bytes += sum(leaf.numel() * leaf.element_size() for leaf in leaves if isinstance(leaf, Tensor))
        if (formula := flop_registry.get(func.overloadpacket)) is not None:
            self.operations += formula(*args, **(kwargs or {}), out_val=result)
        return result


def floors(step: Callable[[], object], precision: torch.dtype) -> dict[str, float]:
    """Return the least times of a step: its matrix products at the measured rate, its bytes at the measured bandwidth.

    All products count as if they had the precision of the networks. Kernels of ours count by the tensors they are given
    memory for.
    """
    with CountWork() as work:
        step()
    return {
        "operations": work.operations,
        "operations_floor_seconds": work.operations / matrix_rate(precision),
        "bytes": work.bytes,
        "bytes_floor_seconds": work.bytes / bandwidth(),
    }


def largest_items(step: Callable[[], object], count: int) -> list[dict[str, str | float]]:
    """Profile a step and list what takes most of the device's time, with its seconds and its share."""
    with profile() as profiler:
        complete(step)()
    averages = profiler.key_averages()
    if ON_GPU:  # operations of the CPU have the time of the kernels that they launch too
        times = {e.key: e.self_device_time_total for e in averages if e.device_type.name != "CPU"}
    else:
        times = {event.key: event.self_cpu_time_total for event in averages}
    whole = sum(times.values())
    largest = sorted(times.items(), key=lambda item: -item[1])[:count]
    return [{"name": name, "seconds": spent / 1e6, "share": spent / whole} for name, spent in largest]
