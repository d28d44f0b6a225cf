"""Interpolation for CUDA devices; importing this module imports triton."""

from typing import Any, no_type_check

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.autograd.function import once_differentiable

from pipeline.rendering.triton_compiler import launch, tl, triton

SAMPLES = 256
"""Samples that a program works on."""


@triton.jit
@no_type_check
def _interpolate(
    attributes,
    faces,
    face_index,
    barycentric,
    values,
    vertex_count,
    sample_count,
    channels: tl.constexpr,
    block: tl.constexpr,
):
    picture = tl.program_id(0).to(tl.int64)
    sample = tl.program_id(1) * block + tl.arange(0, block)
    within = sample < sample_count
    place = picture * sample_count + sample
    face = tl.load(face_index + place, within, other=-1)
    covered = face >= 0
    a = picture * vertex_count + tl.load(faces + 3 * face, covered, other=0)
    b = picture * vertex_count + tl.load(faces + 3 * face + 1, covered, other=0)
    c = picture * vertex_count + tl.load(faces + 3 * face + 2, covered, other=0)
    weight0 = tl.load(barycentric + 3 * place, covered, other=0.0)
    weight1 = tl.load(barycentric + 3 * place + 1, covered, other=0.0)
    weight2 = tl.load(barycentric + 3 * place + 2, covered, other=0.0)
    for channel in tl.static_range(channels):
        value = (
            weight0 * tl.load(attributes + a * channels + channel, covered, other=0.0)
            + weight1 * tl.load(attributes + b * channels + channel, covered, other=0.0)
            + weight2 * tl.load(attributes + c * channels + channel, covered, other=0.0)
        )
        tl.store(values + place * channels + channel, value, within)


@triton.jit
@no_type_check
def _interpolate_backward(
    attributes,
    faces,
    face_index,
    barycentric,
    gradient,
    attribute_gradient,
    barycentric_gradient,
    vertex_count,
    sample_count,
    channels: tl.constexpr,
    attributes_learn: tl.constexpr,
    block: tl.constexpr,
):
    picture = tl.program_id(0).to(tl.int64)
    sample = tl.program_id(1) * block + tl.arange(0, block)
    within = sample < sample_count
    place = picture * sample_count + sample
    face = tl.load(face_index + place, within, other=-1)
    covered = face >= 0
    for corner in tl.static_range(3):
        vertex = picture * vertex_count + tl.load(faces + 3 * face + corner, covered, other=0)
        weight = tl.load(barycentric + 3 * place + corner, covered, other=0.0)
        slope = tl.zeros((block,), tl.float32)
        for channel in tl.static_range(channels):
            upstream = tl.load(gradient + place * channels + channel, covered, other=0.0)
            slope += upstream * tl.load(attributes + vertex * channels + channel, covered, other=0.0)
            if attributes_learn:
                target = attribute_gradient + vertex * channels + channel
                tl.atomic_add(target, weight * upstream, mask=covered, sem="relaxed")
        tl.store(barycentric_gradient + 3 * place + corner, slope, within)


class _Interpolate(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, attributes: Tensor, faces: Tensor, face_index: Tensor, barycentric: Tensor) -> Tensor:
        inputs = [tensor.detach().contiguous() for tensor in (attributes, faces, face_index, barycentric)]
        ctx.save_for_backward(*inputs)
        (batch, vertex_count, channels), samples = attributes.shape, face_index.shape[1:].numel()
        values = attributes.new_empty(*face_index.shape, channels)
        launch(_interpolate, batch, samples, SAMPLES, *inputs, values, vertex_count, samples, channels)
        return values

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, None, None, Tensor]:  # pyright: ignore[reportIncompatibleMethodOverride]
        attributes, _, face_index, barycentric = ctx.saved_tensors
        (batch, vertex_count, channels), samples = attributes.shape, face_index.shape[1:].numel()
        results = torch.zeros_like(attributes), torch.empty_like(barycentric)
        arguments = (*ctx.saved_tensors, gradients[0].contiguous(), *results, vertex_count, samples, channels)
        learn = ctx.needs_input_grad[0]
        launch(_interpolate_backward, batch, samples, SAMPLES, *arguments, learn)
        return results[0] if learn else None, None, None, results[1]


def interpolate(
    attributes: Float[Tensor, "B V C"],
    faces: Int[Tensor, "F 3"],
    face_index: Int[Tensor, "B H W"],
    barycentric: Float[Tensor, "B H W 3"],
) -> Float[Tensor, "B H W C"]:
    """Return interpolated attributes, 0 in the background, with gradients as `interpolate.interpolate` has them."""
    return _Interpolate.apply(attributes, faces, face_index, barycentric)
