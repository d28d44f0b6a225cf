"""Antialiasing for CUDA devices: each pixel looks at its pairs with four neighbours; importing it imports triton."""

from typing import Any, no_type_check

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.autograd.function import once_differentiable

from pipeline.geometry.topology import topology_of
from pipeline.rendering.crossings_triton import NONE, find_crossings, point, unpack
from pipeline.rendering.triton_compiler import launch, tl, triton

PIXELS = 256
"""Pixels that a program blends."""


@triton.jit
@no_type_check
def _pairs(crossings, pixel, size: tl.constexpr):
    """Return slot, neighbour, excess and whether the pixel is the blended one, for its pairs with neighbours.

    The four columns are right, left, below and above; the excess is 0 where no edge passes.
    """
    pair = tl.arange(0, 4)[None, :]
    step, is_first = tl.where(pair >= 2, size, 1), pair % 2 == 0
    place = tl.where(is_first, pixel, pixel - step)
    slot = (pair // 2) * size * size + place
    key = tl.load(crossings + slot, (place >= 0) & (pixel < size * size), other=NONE)
    excess, _, inside_first, found = unpack(key)
    is_target = found & (((excess > 0.0) != inside_first) == is_first)
    neighbour = tl.where(found, tl.where(is_first, pixel + step, pixel - step), 0)
    return slot, neighbour, excess, is_target


@triton.jit
@no_type_check
def _blend(colors, crossings, taken, blended, channels: tl.constexpr, size: tl.constexpr, block: tl.constexpr):
    """Move pixels towards their neighbours by the shares that edges cut off."""
    picture = tl.program_id(0).to(tl.int64)
    pixel = (tl.program_id(1) * block + tl.arange(0, block))[:, None]
    within = pixel < size * size
    crossings += 2 * picture * size * size
    _, neighbour, excess, is_target = _pairs(crossings, pixel, size)
    share = tl.where(is_target, tl.abs(excess), 0.0)
    total = tl.sum(share, axis=1, keep_dims=True)
    tl.store(taken + picture * size * size + pixel, total, within)
    share = share / tl.maximum(total, 1.0)
    for channel in tl.static_range(channels):
        plane = (picture * channels + channel) * size * size
        own = tl.load(colors + plane + pixel, within, other=0.0)
        other = tl.load(colors + plane + neighbour, is_target, other=0.0)
        change = tl.where(is_target, share * (other - own), 0.0)
        tl.store(blended + plane + pixel, own + tl.sum(change, axis=1, keep_dims=True), within)


@triton.jit
@no_type_check
def _blend_backward(
    colors,
    crossings,
    taken,
    gradient,
    color_gradient,
    excess_gradient,
    channels: tl.constexpr,
    size: tl.constexpr,
    block: tl.constexpr,
):
    """Return gradients with respect to the colors and, in the crossings' slots, to the excesses."""
    picture = tl.program_id(0).to(tl.int64)
    pixel = (tl.program_id(1) * block + tl.arange(0, block))[:, None]
    within = pixel < size * size
    slot, neighbour, excess, is_target = _pairs(crossings + 2 * picture * size * size, pixel, size)
    share = tl.where(is_target, tl.abs(excess), 0.0)
    is_source = (excess != 0.0) & (is_target == 0)
    own_taken = tl.load(taken + picture * size * size + pixel, within, other=0.0)
    target_taken = tl.load(taken + picture * size * size + neighbour, is_source, other=0.0)
    given = tl.where(is_source, tl.abs(excess), 0.0) / tl.maximum(target_taken, 1.0)
    kept = 1.0 - tl.sum(share, axis=1, keep_dims=True) / tl.maximum(own_taken, 1.0)
    slope = tl.zeros_like(share)
    for channel in tl.static_range(channels):
        plane = (picture * channels + channel) * size * size
        own = tl.load(colors + plane + pixel, within, other=0.0)
        upstream = tl.load(gradient + plane + pixel, within, other=0.0)
        other = tl.load(colors + plane + neighbour, is_target, other=0.0)
        slope += tl.where(is_target, upstream * (other - own), 0.0)
        passed = given * tl.load(gradient + plane + neighbour, is_source, other=0.0)
        tl.store(color_gradient + plane + pixel, kept * upstream + tl.sum(passed, axis=1, keep_dims=True), within)
    # Where pixels give all of themselves, shares are divided by their sum.
    full = own_taken >= 1.0
    divisor = tl.where(full, own_taken, 1.0)
    common = tl.where(full, tl.sum(slope * share, axis=1, keep_dims=True) / (divisor * divisor), 0.0)
    slope = (slope / divisor - common) * tl.where(excess > 0.0, 1.0, -1.0)
    tl.store(excess_gradient + 2 * picture * size * size + slot, slope, is_target & (excess != 0.0))


@triton.jit
@no_type_check
def _move_edges(
    vertices,
    edges,
    crossings,
    excess_gradient,
    vertex_gradient,
    vertex_count,
    size: tl.constexpr,
    block: tl.constexpr,
):
    """Carry gradients from the excesses to the ends of the edges."""
    picture = tl.program_id(0).to(tl.int64)
    slot = tl.program_id(1) * block + tl.arange(0, block)
    within = slot < 2 * size * size
    key = tl.load(crossings + 2 * picture * size * size + slot, within, other=NONE)
    _, edge, inside_first, found = unpack(key)
    slope = tl.load(excess_gradient + 2 * picture * size * size + slot, found, other=0.0)
    slope = tl.where(inside_first, slope, -slope)
    first, second = tl.load(edges + 2 * edge, found, other=0), tl.load(edges + 2 * edge + 1, found, other=0)
    vertices += picture * vertex_count * 3
    start_column, start_row, _ = point(vertices, first, found, size)
    end_column, end_row, _ = point(vertices, second, found, size)
    sideways = slot >= size * size
    line = tl.where(sideways, slot % size, (slot // size) % size)
    rightwards, downwards = end_column - start_column, end_row - start_row
    length = tl.where(found, tl.where(sideways, rightwards, downwards), 1.0)
    portion = (line - tl.where(sideways, start_column, start_row)) / length
    tilt = tl.where(sideways, downwards, rightwards) / length
    at_start, at_end = slope * (1.0 - portion), slope * portion
    # Across the edge's longer axis an end carries its crossing along, in columns or in rows (whose y points up).
    column_part, row_part = tl.where(sideways, -tilt, 1.0) * 0.5 * size, tl.where(sideways, -1.0, tilt) * 0.5 * size
    vertex_gradient += picture * vertex_count * 3
    tl.atomic_add(vertex_gradient + 3 * first, column_part * at_start, mask=found, sem="relaxed")
    tl.atomic_add(vertex_gradient + 3 * first + 1, row_part * at_start, mask=found, sem="relaxed")
    tl.atomic_add(vertex_gradient + 3 * second, column_part * at_end, mask=found, sem="relaxed")
    tl.atomic_add(vertex_gradient + 3 * second + 1, row_part * at_end, mask=found, sem="relaxed")


class _Antialias(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, colors: Tensor, face_index: Tensor, barycentric: Tensor, vertices_ndc: Tensor, faces: Tensor
    ) -> Tensor:
        inputs = (colors, face_index, barycentric, vertices_ndc)
        colors, face_index, barycentric, vertices = (tensor.detach().contiguous() for tensor in inputs)
        batch, channels, size, _ = colors.shape
        topology = topology_of(faces)
        crossings = find_crossings(face_index, barycentric, vertices, faces.contiguous(), topology)
        taken, blended = colors.new_empty(batch, size, size), torch.empty_like(colors)
        launch(_blend, batch, size * size, PIXELS, colors, crossings, taken, blended, channels, size)
        ctx.save_for_backward(colors, crossings, taken, vertices, topology.edges)
        return blended

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None, None, Tensor, None]:  # pyright: ignore[reportIncompatibleMethodOverride]
        colors, crossings, taken, vertices, edges = ctx.saved_tensors
        batch, channels, size, _ = colors.shape
        color_gradient, excess_gradient = torch.empty_like(colors), colors.new_zeros(crossings.shape)
        arguments = (colors, crossings, taken, gradients[0].contiguous(), color_gradient, excess_gradient)
        launch(_blend_backward, batch, size * size, PIXELS, *arguments, channels, size)
        vertex_gradient = torch.zeros_like(vertices)
        arguments = (vertices, edges, crossings, excess_gradient, vertex_gradient, vertices.shape[1])
        launch(_move_edges, batch, 2 * size * size, PIXELS, *arguments, size)
        return color_gradient, None, None, vertex_gradient, None


def antialias(
    colors: Float[Tensor, "B C H W"],
    face_index: Int[Tensor, "B H W"],
    barycentric: Float[Tensor, "B H W 3"],
    vertices_ndc: Float[Tensor, "B V 3"],
    faces: Int[Tensor, "F 3"],
) -> Float[Tensor, "B C H W"]:
    """Blend pixels at silhouettes as `antialias.antialias` does, with its gradients and errors.

    Of crossings that reach equally far between the same two pixels one is kept.
    """
    return _Antialias.apply(colors, face_index, barycentric, vertices_ndc, faces)
