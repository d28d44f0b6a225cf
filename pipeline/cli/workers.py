"""Processes among which photographs are divided, where there are enough of them."""

import pickle  # noqa: TID251 - between processes, as they always talk; no file holds it
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import repeat
from typing import Any, Protocol, TypeVar

import torch

from pipeline.launch import process_pool

Item = TypeVar("Item")
Result = TypeVar("Result")
PHOTOGRAPHS = 50
"""For a process of its own: so many take about as long as it takes to start one."""
FEWEST = 4
"""Processes: two gain nothing for what it takes to start them and to send them what to write."""
_MOST = 8
"""Processes, of 600 MB each."""


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
    count = min(torch.get_num_threads(), photographs // PHOTOGRAPHS, _MOST)
    if count < FEWEST:
        yield map
        return
    with process_pool(count, "reads and writes photographs") as pool:

        def divide(function: Callable[[Item], Result], items: Sequence[Item], /) -> Iterator[Result]:
            # Pickled here: PyTorch's way of sending tensors takes an open file for each.
            yield from pool.map(_call, repeat(pickle.dumps(function)), map(pickle.dumps, items))

        yield divide


def _call(function: bytes, item: bytes) -> Any:
    return pickle.loads(function)(pickle.loads(item))
