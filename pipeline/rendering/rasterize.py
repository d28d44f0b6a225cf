"""Rasterisation: which face each pixel shows, and where on that face."""

from typing import Any, NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.autograd.function import once_differentiable


class Fragments(NamedTuple):
    """Say what each pixel's centre sees."""

    face_index: Int[Tensor, "B H W"]
    """The nearest face, -1 where there is background."""
    barycentric: Float[Tensor, "B H W 3"]
    """Perspective-correct weights of that face's corners, summing to 1; 0 in the background."""


class _CompiledRasterize(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, vertices_ndc: Tensor, faces: Tensor, size: int) -> tuple[Tensor, Tensor]:
        from pipeline.rendering import rasterize_cpu

        vertices = vertices_ndc.detach().contiguous()
        face_index, barycentric = rasterize_cpu.rasterize(vertices.numpy(), faces.numpy(), size)
        result = torch.from_numpy(face_index), torch.from_numpy(barycentric)
        ctx.save_for_backward(vertices, faces, result[0])
        ctx.mark_non_differentiable(result[0])
        return result

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None, None]:  # pyright: ignore[reportIncompatibleMethodOverride]
        from pipeline.rendering import rasterize_cpu

        vertices, faces, face_index = (tensor.numpy() for tensor in ctx.saved_tensors)
        gradient = gradients[1].contiguous().numpy()
        return torch.from_numpy(rasterize_cpu.barycentric_backward(vertices, faces, face_index, gradient)), None, None


def rasterize(vertices_ndc: Float[Tensor, "B V 3"], faces: Int[Tensor, "F 3"], size: int) -> Fragments:
    """Find the nearest face at every pixel's centre of a size x size picture.

    Both sides of a face are seen. Faces with a corner behind the camera and faces without area are left out.
    Gradients flow from the barycentric coordinates to the vertices.
    """
    if vertices_ndc.is_cuda:
        from pipeline.rendering import rasterize_triton

        return Fragments(*rasterize_triton.rasterize(vertices_ndc, faces, size))
    return Fragments(*_CompiledRasterize.apply(vertices_ndc, faces.contiguous(), size))
