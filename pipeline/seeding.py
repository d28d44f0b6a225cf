"""Derive independent streams of random numbers from one seed, by name."""

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import torch


def generator(seed: int, *stream: str | int, device: torch.device | str = "cpu") -> torch.Generator:
    """Create a generator for one named stream, such as `generator(seed, "viewpoints", candidate)`.

    Streams of different names, or of different seeds, are independent; the same ones repeat exactly.
    """
    return torch.Generator(device).manual_seed(_stream_seed(seed, *stream))


def numpy_generator(seed: int, *stream: str | int) -> np.random.Generator:
    """Create the NumPy generator of one named stream."""
    return np.random.default_rng(_stream_seed(seed, *stream))


@contextmanager
def initialised(seed: int, *stream: str | int) -> Iterator[None]:
    """Draw the initial weights of modules built inside the block, on the CPU, from one named stream.

    PyTorch's layers take their initial weights from its global generator: its state is put back when the block ends.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(_stream_seed(seed, *stream))
        yield


def _stream_seed(seed: int, *stream: str | int) -> int:
    digest = hashlib.sha256(repr((seed, *stream)).encode()).digest()
    return int.from_bytes(digest[:8], "big") >> 1
