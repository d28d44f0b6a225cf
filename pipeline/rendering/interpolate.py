"""Interpolation of vertex attributes over the pixels."""

from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.autograd.function import once_differentiable

from pipeline.rendering.rasterize import Fragments


class _CompiledInterpolate(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, attributes: Tensor, faces: Tensor, face_index: Tensor, barycentric: Tensor) -> Tensor:
        from pipeline.rendering import interpolate_cpu

        inputs = [tensor.detach().contiguous() for tensor in (attributes, faces, face_index, barycentric)]
        ctx.save_for_backward(*inputs)
        return torch.from_numpy(interpolate_cpu.interpolate(*(tensor.numpy() for tensor in inputs)))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None, None, Tensor]:  # pyright: ignore[reportIncompatibleMethodOverride]
        from pipeline.rendering import interpolate_cpu

        attributes, faces, face_index, barycentric = (tensor.numpy() for tensor in ctx.saved_tensors)
        attribute_gradient, barycentric_gradient = interpolate_cpu.interpolate_backward(
            attributes, faces, face_index, barycentric, gradients[0].contiguous().numpy()
        )
        return torch.from_numpy(attribute_gradient), None, None, torch.from_numpy(barycentric_gradient)


def interpolate(
    attributes: Float[Tensor, "B V C"], faces: Int[Tensor, "F 3"], fragments: Fragments
) -> Float[Tensor, "B H W C"]:
    """Interpolate attributes of vertices with perspective correction; the background gets 0.

    Gradients flow to the attributes and, through the barycentric coordinates, to the vertices.
    """
    if attributes.is_cuda:
        from pipeline.rendering import interpolate_triton

        return interpolate_triton.interpolate(attributes, faces, *fragments)
    return _CompiledInterpolate.apply(attributes, faces, *fragments)
