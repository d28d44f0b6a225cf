"""Steps of optimisers and their learning rates."""

from collections.abc import Iterable

import torch
from jaxtyping import Float
from torch import Tensor, nn

from pipeline.distributed import average_gradients


def adam(parameters: Iterable[nn.Parameter], rate: float, betas: tuple[float, float]) -> torch.optim.Adam:
    """Build an optimiser; on a GPU its learning rate is a tensor, which a recorded step reads each time it is taken."""
    parameters = list(parameters)
    device = parameters[0].device
    if device.type == "cpu":
        return torch.optim.Adam(parameters, lr=rate, betas=betas, fused=True)
    return torch.optim.Adam(parameters, lr=torch.tensor(rate, device=device), betas=betas, fused=True, capturable=True)


def take_step(loss: Float[Tensor, ""], optimizer: torch.optim.Optimizer) -> None:
    """Descend along a loss's gradient, averaged over the processes that share the training."""
    optimizer.zero_grad(set_to_none=True)
    loss.backward()
    average_gradients(optimizer)
    optimizer.step()


def set_learning_rate(rate: float, *optimizers: torch.optim.Optimizer) -> None:
    """Give all parameters of some optimisers one learning rate."""
    for optimizer in optimizers:
        for group in optimizer.param_groups:
            if isinstance(group["lr"], Tensor):
                group["lr"].fill_(rate)
            else:
                group["lr"] = rate


def falling(rate: float, iteration: int, iterations: int, cool_down: float) -> float:
    """Return the learning rate of an iteration, counted from 0: over the last part, `cool_down`, it falls to zero."""
    return rate * min(1.0, (iterations - iteration) / max(1.0, cool_down * iterations))
