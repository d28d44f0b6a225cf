"""Values and gradients of an operation, by which two ways of calculating it are compared."""

from collections.abc import Callable

import pytest
import torch
from torch import Tensor


def gradients(function: Callable[..., Tensor], *inputs: Tensor) -> list[Tensor]:
    """Return a function's value and the gradients of its sum under fixed random weights, all in float32."""
    leaves = [value.detach().clone().requires_grad_() for value in inputs]
    value = function(*leaves)
    weights = torch.randn(value.shape, generator=torch.Generator().manual_seed(9))
    return [result.float() for result in (value.detach(), *torch.autograd.grad((weights * value).sum(), leaves))]


def assert_refuses_second_derivatives(function: Callable[..., Tensor], *inputs: Tensor) -> None:
    """See the error of a function whose gradients are no functions of its inputs to PyTorch."""
    leaves = [value.detach().clone().requires_grad_() for value in inputs]
    slopes = torch.autograd.grad(function(*leaves).square().sum(), leaves, create_graph=True)
    with pytest.raises(RuntimeError, match="once_differentiable"):
        torch.cat([slope.flatten() for slope in slopes]).sum().backward()
