"""Processes among which photographs are divided, where there are enough of them."""

import pickle  # noqa: TID251 - between processes, as they always talk; no file holds it
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from itertools import repeat
from multiprocessing import get_context
from typing import Any, Protocol, TypeVar

import torch

from pipeline.errors import ProcessKilled
from pipeline.launch import divided_threads, end_with_parent, interrupts_ignored

Item = TypeVar("Item")
Result = TypeVar("Result")
PHOTOGRAPHS = 50
"""For a process of its own: so many take about as long as it takes to start one."""


class Map(Protocol):
    """What `map` is."""

    def __call__(self, function: Callable[[Item], Result], items: Sequence[Item], /) -> Iterable[Result]:
        """Call a function with every item; results come in the order of the items."""
        ...


@contextmanager
def workers(photographs: int) -> Iterator[Map]:
    """Yield a `map` over as many processes as this one has threads, or over none where photographs are few.

    What is called and returned must be picklable, and what is returned holds no tensors. Raises ProcessKilled where a
    process was killed.
    """
    count = min(torch.get_num_threads(), photographs // PHOTOGRAPHS)
    if count < 2:
        yield map
        return
    with ProcessPoolExecutor(count, get_context("spawn"), end_with_parent) as pool:
        with interrupts_ignored(), divided_threads(count):
            for started in [pool.submit(int) for _ in range(count)]:
                started.result()

        def divide(function: Callable[[Item], Result], items: Sequence[Item], /) -> Iterator[Result]:
            # Pickled here: PyTorch's way of sending tensors takes an open file for each.
            packed, chunk = pickle.dumps(function), max(1, len(items) // (4 * count))
            yield from pool.map(_call, repeat(packed), map(pickle.dumps, items), chunksize=chunk)

        try:
            yield divide
        except BrokenProcessPool:
            raise ProcessKilled(
                "a process that reads and writes photographs was killed, perhaps for want of memory; run the same "
                "command again: it goes on where it stopped"
            ) from None


def _call(function: bytes, item: bytes) -> Any:
    return pickle.loads(function)(pickle.loads(item))
