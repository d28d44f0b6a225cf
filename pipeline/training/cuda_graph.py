"""Steps of trainings that a GPU repeats without its host (CUDA graphs)."""

import warnings
from collections.abc import Callable, Mapping
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.distributed import world

_REHEARSALS = 3
"""Steps that are taken as they are: libraries choose algorithms, kernels are compiled, optimisers make their state."""


class GraphedStep:
    """Take steps of a training; on a GPU by a graph of one, which is captured after the first few.

    A step asks a GPU for thousands of small operations, and asking takes the host several times as long as they take
    the GPU. A captured step must ask nothing back and change everything in place: its inputs are tensors of the same
    shapes each time, its random numbers come from the generators named here, its learning rate is a tensor (see
    `adam`). On a CPU, and where processes share the training, every step is taken as it is.
    """

    def __init__(
        self,
        step: Callable[..., Mapping[str, Float[Tensor, ""]]],
        device: torch.device,
        *generators: torch.Generator,
    ) -> None:
        self._step, self._generators = step, generators
        self._stream = torch.cuda.Stream(device) if device.type == "cuda" and world().size == 1 else None
        self._rehearsals = 0
        self._graph: _Graph | None = None

    def __call__(self, *inputs: Tensor) -> dict[str, Float[Tensor, ""]]:
        """Take a step and return its losses, on the device."""
        if self._stream is None:
            return dict(self._step(*inputs))
        if self._rehearsals < _REHEARSALS:
            self._rehearsals += 1
            return _rehearse(self._step, inputs, self._stream)
        if self._graph is None:
            self._graph = _Graph(self._step, inputs, self._generators)
        return self._graph.replay(inputs)


class _Graph:
    """A captured step: what it reads, the operations, and where they leave its losses."""

    def __init__(
        self,
        step: Callable[..., Mapping[str, Float[Tensor, ""]]],
        inputs: tuple[Tensor, ...],
        generators: tuple[torch.Generator, ...],
    ) -> None:
        self._inputs = [tensor.clone() for tensor in inputs]
        self._graph = torch.cuda.CUDAGraph()
        for generator in generators:
            self._graph.register_generator_state(generator)
        with torch.cuda.graph(self._graph):
            losses = step(*self._inputs)
            self._losses = torch.stack([*losses.values()])
        self._names = list(losses)

    def replay(self, inputs: tuple[Tensor, ...]) -> dict[str, Float[Tensor, ""]]:
        """Take the captured step with these inputs."""
        for own, given in zip(self._inputs, inputs, strict=True):
            own.copy_(given)
        self._graph.replay()
        return dict(zip(self._names, self._losses.clone(), strict=True))


def _rehearse(
    step: Callable[..., Mapping[str, Any]], inputs: tuple[Tensor, ...], stream: torch.cuda.Stream
) -> dict[str, Any]:
    """Take a step on another stream than the current one, as PyTorch asks of what is then captured."""
    stream.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(stream), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "This instance was constructed with capturable=True")
        losses = dict(step(*inputs))
    torch.cuda.current_stream().wait_stream(stream)
    return losses
