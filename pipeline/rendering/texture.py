"""Textures on the sphere of directions, stored as equirectangular maps."""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable


class _CompiledSample(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, texture_maps: Tensor, directions: Tensor) -> Tensor:
        from pipeline.rendering import texture_cpu

        inputs = [tensor.detach().contiguous() for tensor in (texture_maps, directions)]
        ctx.save_for_backward(*inputs)
        return torch.from_numpy(texture_cpu.sample(*(tensor.numpy() for tensor in inputs)))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        from pipeline.rendering import texture_cpu

        texture_maps, directions = (tensor.numpy() for tensor in ctx.saved_tensors)
        gradient = gradients[0].contiguous().numpy()
        return tuple(map(torch.from_numpy, texture_cpu.sample_backward(texture_maps, directions, gradient)))


def sample_sphere_texture(
    texture_maps: Float[Tensor, "B 3 T T"], directions: Float[Tensor, "B H W 3"]
) -> Float[Tensor, "B 3 H W"]:
    """Look up equirectangular maps along directions, bilinearly.

    The middle column is the front (+z), three quarters to the right is +x, and the first row is up (+y). Columns wrap
    around, so there is no seam; rows end at the poles. Directions need no unit length, but more than 1e-4; the zero
    direction, which `interpolate` gives the background, is black. Gradients flow to the maps and to the directions.
    """
    if texture_maps.is_cuda:
        from pipeline.rendering import texture_triton

        return texture_triton.sample_sphere_texture(texture_maps, directions)
    return _CompiledSample.apply(texture_maps, directions)
