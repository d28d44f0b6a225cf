"""Share one training among processes.

Every process holds the whole state: weights, records and random generators, which are the same in all of them. Each
draws for the whole batch, takes its share of what was drawn, and takes the same step, because gradients are averaged
over the processes first. Where there is one process, the functions here return what they are given.
"""

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, NamedTuple, TypeVar

import torch
import torch.distributed as dist
from jaxtyping import Float
from torch import Tensor

from pipeline.errors import ConfigError

Batch = TypeVar("Batch", bound=Tensor | tuple[Any, ...])
Value = TypeVar("Value")

_is_alone: ContextVar[bool] = ContextVar("is_alone", default=False)


class World(NamedTuple):
    """The processes that share a training, and which of them this one is."""

    rank: int
    size: int


def world() -> World:
    """Return this process's number, from 0, and how many there are: `World(0, 1)` where nothing is shared."""
    if _is_alone.get() or not dist.is_initialized():
        return World(0, 1)
    return World(dist.get_rank(), dist.get_world_size())


def is_first() -> bool:
    """Tell whether this is the process that writes files."""
    return world().rank == 0


def leads() -> bool:
    """Tell, also before the processes have met, whether this one is the first or starts the others."""
    return not dist.is_torchelastic_launched() or os.environ["RANK"] == "0"


def silent() -> bool | None:
    """Return tqdm's `disable`: the first process shows progress where there is a terminal, the others never do."""
    return True if dist.is_initialized() and dist.get_rank() > 0 else None


def whole(count: int) -> int:
    """Return the size of the batch of which every process holds `count`."""
    return count * world().size


def shared_batch(wanted: int, available: int) -> int:
    """Return the size of a batch of what there is: as wanted, or else as much as divides among the processes."""
    if wanted <= available:
        return wanted
    return available - available % world().size or available


def require_divisible(batch_size: int) -> None:
    """Raise ConfigError for a batch that the processes cannot share evenly."""
    size = world().size
    if batch_size % size:
        raise ConfigError(
            f"a batch of {batch_size} cannot be shared by {size} processes; set batch sizes (or the number of "
            f"photographs, where it is smaller) to multiples of {size}, or processes to a divisor of them"
        )


def share(batch: Batch, dim: int = 0) -> Batch:
    """Take this process's part of a batch along a dimension; of a named tuple, each entry's.

    Raises ConfigError for a batch that cannot be divided evenly.
    """
    rank, size = world()
    if size == 1:
        return batch
    if isinstance(batch, tuple):
        return type(batch)(*(share(entry, dim) for entry in batch))
    require_divisible(batch.shape[dim])
    return batch.chunk(size, dim)[rank]  # pyright: ignore[reportReturnType]


def gather(tensor: Tensor) -> Tensor:
    """Put the processes' parts of a batch together again, along the first dimension; without gradients."""
    if world().size == 1:
        return tensor.detach()
    parts = [torch.zeros_like(tensor, memory_format=torch.contiguous_format) for _ in range(world().size)]
    dist.all_gather(parts, tensor.detach().contiguous())
    return torch.cat(parts)


def average(tensor: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Average a tensor over the processes.

    Gradients flow to every process's tensor, such that the averages of parameters' gradients are those of the average
    of all processes' losses.
    """
    if world().size == 1:
        return tensor
    return _Sum.apply(tensor) / world().size


def average_all(tensors: Sequence[Tensor]) -> list[Tensor]:
    """Average each of several tensors of one type, as `average` does, in one message."""
    if world().size == 1:
        return list(tensors)
    averages = average(torch.cat([tensor.flatten() for tensor in tensors]))
    parts = averages.split([tensor.numel() for tensor in tensors])
    return [part.view_as(tensor) for part, tensor in zip(parts, tensors, strict=True)]


def average_gradients(optimizer: torch.optim.Optimizer) -> None:
    """Average the gradients of an optimiser's parameters over the processes, between backward pass and step."""
    if world().size == 1:
        return
    parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
    gradients = [parameter.grad for parameter in parameters if parameter.grad is not None]
    for gradient, average_gradient in zip(gradients, average_all(gradients), strict=True):
        gradient.copy_(average_gradient)


def average_losses(losses: Mapping[str, Float[Tensor, ""]]) -> dict[str, Float[Tensor, ""]]:
    """Average losses over the processes, without gradients."""
    return dict(zip(losses, average_all([loss.detach() for loss in losses.values()]), strict=True))


def agree(tensors: Iterable[Tensor]) -> None:
    """Overwrite tensors by those of the first process: what a device rounds differently must not drift apart."""
    if world().size == 1:
        return
    for tensor in tensors:
        value = tensor.detach().contiguous()
        dist.broadcast(value, 0)
        tensor.detach().copy_(value)


def from_first(value: Value) -> Value:
    """Return the first process's value; its tensors must be on the CPU."""
    if world().size == 1:
        return value
    values: list[Any] = [value]
    dist.broadcast_object_list(values, 0)
    return values[0]


def divide(function: Callable[[int], Value], count: int) -> list[Value]:
    """Return what a function gives for every number below `count`; tensors in it must be on the CPU.

    Processes take the numbers in turn and each works alone, so that the results are those of a single process. They
    wait for each other before they take the next. On one number alone they all work together.
    """
    rank, size = world()
    if size == 1 or count == 1:
        return [function(number) for number in range(count)]
    results: dict[int, Value] = {}
    for first in range(0, count, size):
        number = first + rank
        with _alone():
            own = {number: function(number)} if number < count else {}
        found: list[Any] = [None] * size
        dist.all_gather_object(found, own)
        results |= {number: result for part in found for number, result in part.items()}
    return [results[number] for number in range(count)]


@contextmanager
def _alone() -> Iterator[None]:
    """Let this process work inside the block as if it were the only one."""
    token = _is_alone.set(True)
    try:
        yield
    finally:
        _is_alone.reset(token)


class _Sum(torch.autograd.Function):
    """Add a tensor up over the processes; backward, the gradients of all processes' losses."""

    @staticmethod
    def forward(_context: Any, tensor: Tensor) -> Tensor:  # pyright: ignore[reportIncompatibleMethodOverride]
        total = tensor.clone(memory_format=torch.contiguous_format)
        dist.all_reduce(total)
        return total

    @staticmethod
    def backward(_context: Any, gradient: Tensor) -> Tensor:  # pyright: ignore[reportIncompatibleMethodOverride]
        return _Sum.apply(gradient)
