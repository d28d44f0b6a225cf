"""Antialiasing of silhouettes, which is also where the gradients of silhouettes come from.

Where a silhouette edge passes between the centres of two neighbouring pixels, one of the two is blended with the other
by the area that the edge cuts off. This is the idea of nvdiffrast (Laine et al. 2020, section 3.5), but it walks along
the silhouette edges instead of starting at pixels: at 32 pixels most faces at a silhouette cover no pixel's centre.
"""

from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.autograd.function import once_differentiable

from pipeline.geometry.topology import topology_of
from pipeline.rendering.rasterize import Fragments


class _CompiledAntialias(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, colors: Tensor, face_index: Tensor, barycentric: Tensor, vertices_ndc: Tensor, faces: Tensor
    ) -> Tensor:
        from pipeline.rendering import antialias_cpu

        colors, vertices = colors.detach().contiguous(), vertices_ndc.detach().contiguous()
        edges, edge_faces, *_ = topology_of(faces)
        inputs = (vertices, faces, edges, edge_faces, face_index, barycentric.detach())
        codes, excesses = antialias_cpu.find_crossings(*(value.contiguous().numpy() for value in inputs))
        ctx.save_for_backward(colors, torch.from_numpy(codes), torch.from_numpy(excesses), vertices, edges)
        return torch.from_numpy(antialias_cpu.blend(colors.numpy(), codes, excesses))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None, None, Tensor, None]:  # pyright: ignore[reportIncompatibleMethodOverride]
        from pipeline.rendering import antialias_cpu

        inputs = (*ctx.saved_tensors, gradients[0].contiguous())
        color_gradient, vertex_gradient = antialias_cpu.blend_backward(*(value.numpy() for value in inputs))
        return torch.from_numpy(color_gradient), None, None, torch.from_numpy(vertex_gradient), None


def antialias(
    colors: Float[Tensor, "B C H W"],
    fragments: Fragments,
    vertices_ndc: Float[Tensor, "B V 3"],
    faces: Int[Tensor, "F 3"],
) -> Float[Tensor, "B C H W"]:
    """Blend the pixels on both sides of visible silhouette edges by the area that the edges cut off.

    An edge is a silhouette where it joins a face seen from outside to one seen from inside. It is visible where its
    outer pixel shows something farther away; of several that pass between the same two pixels the one that reaches
    farthest counts, as the others lie in front of the object. Edges that cut one pixel together take no more than all
    of it. Gradients flow to the colors and, through where the edges are, to the vertices. Raises MeshError if the mesh
    is not closed.
    """
    if colors.is_cuda:
        from pipeline.rendering import antialias_triton

        return antialias_triton.antialias(colors, *fragments, vertices_ndc, faces)
    return _CompiledAntialias.apply(colors, *fragments, vertices_ndc, faces)
