"""Texture look-up for CUDA devices; importing this module imports triton."""

from math import pi
from typing import Any, no_type_check

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from pipeline.rendering.triton_compiler import launch, tl, triton

SAMPLES = 256
"""Samples that a program works on."""


@triton.jit
@no_type_check
def _direction(directions, place, within):
    """Return a direction and whether it is not zero."""
    x = tl.load(directions + 3 * place, within, other=0.0)
    y = tl.load(directions + 3 * place + 1, within, other=0.0)
    z = tl.load(directions + 3 * place + 2, within, other=0.0)
    return x, y, z, (x != 0.0) | (y != 0.0) | (z != 0.0)


@triton.jit
@no_type_check
def _texels(coordinates, place, seen, size: tl.constexpr):
    """Return the places of the four texels around map coordinates, and the fractions downwards and across."""
    column = tl.load(coordinates + 2 * place, seen, other=0.0) * size - 0.5
    row = tl.load(coordinates + 2 * place + 1, seen, other=0.0) * size - 0.5
    row = tl.minimum(tl.maximum(row, 0.0), size - 1.0)
    left, top = tl.floor(column), tl.minimum(tl.floor(row), size - 2.0)
    first = top.to(tl.int32) * size
    second = first + size
    first_column = (left.to(tl.int32) + size) % size
    second_column = (first_column + 1) % size
    return (
        first + first_column,
        first + second_column,
        second + first_column,
        second + second_column,
        row - top,
        column - left,
    )


@triton.jit
@no_type_check
def _sample(maps, directions, coordinates, colors, sample_count, size: tl.constexpr, block: tl.constexpr):
    picture = tl.program_id(0).to(tl.int64)
    sample = tl.program_id(1) * block + tl.arange(0, block)
    within = sample < sample_count
    place = picture * sample_count + sample
    _, _, _, seen = _direction(directions, place, within)
    upper_left, upper_right, lower_left, lower_right, down, across = _texels(coordinates, place, seen, size)
    for channel in tl.static_range(3):
        texture = maps + (3 * picture + channel) * size * size
        a, b = tl.load(texture + upper_left, seen, other=0.0), tl.load(texture + upper_right, seen, other=0.0)
        c, d = tl.load(texture + lower_left, seen, other=0.0), tl.load(texture + lower_right, seen, other=0.0)
        upper, lower = a + across * (b - a), c + across * (d - c)
        tl.store(colors + (3 * picture + channel) * sample_count + sample, upper + down * (lower - upper), within)


@triton.jit
@no_type_check
def _sample_backward(
    maps,
    directions,
    coordinates,
    gradient,
    map_gradient,
    direction_gradient,
    sample_count,
    size: tl.constexpr,
    pi: tl.constexpr,
    block: tl.constexpr,
):
    picture = tl.program_id(0).to(tl.int64)
    sample = tl.program_id(1) * block + tl.arange(0, block)
    within = sample < sample_count
    place = picture * sample_count + sample
    x, y, z, seen = _direction(directions, place, within)
    upper_left, upper_right, lower_left, lower_right, down, across = _texels(coordinates, place, seen, size)
    slope_across, slope_down = tl.zeros((block,), tl.float32), tl.zeros((block,), tl.float32)
    for channel in tl.static_range(3):
        upstream = tl.load(gradient + (3 * picture + channel) * sample_count + sample, seen, other=0.0)
        texture = maps + (3 * picture + channel) * size * size
        total = map_gradient + (3 * picture + channel) * size * size
        tl.atomic_add(total + upper_left, upstream * (1.0 - down) * (1.0 - across), mask=seen, sem="relaxed")
        tl.atomic_add(total + upper_right, upstream * (1.0 - down) * across, mask=seen, sem="relaxed")
        tl.atomic_add(total + lower_left, upstream * down * (1.0 - across), mask=seen, sem="relaxed")
        tl.atomic_add(total + lower_right, upstream * down * across, mask=seen, sem="relaxed")
        a, b = tl.load(texture + upper_left, seen, other=0.0), tl.load(texture + upper_right, seen, other=0.0)
        c, d = tl.load(texture + lower_left, seen, other=0.0), tl.load(texture + lower_right, seen, other=0.0)
        slope_across += upstream * (b - a + down * ((d - c) - (b - a)))
        slope_down += upstream * (c - a + across * ((d - b) - (c - a)))
    slope_down = tl.where((down == 0.0) | (down == 1.0), 0.0, slope_down)  # beyond the rows' ends nothing changes
    square = x * x + z * z + 1e-12
    level = tl.sqrt(square)
    slope_around = slope_across * size / (2.0 * pi * square)
    slope_upward = -slope_down * size / (pi * (square + y * y))
    tl.store(direction_gradient + 3 * place, slope_around * z - slope_upward * y * x / level, within)
    tl.store(direction_gradient + 3 * place + 1, slope_upward * level, within)
    tl.store(direction_gradient + 3 * place + 2, -slope_around * x - slope_upward * y * z / level, within)


class _Sample(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, texture_maps: Tensor, directions: Tensor) -> Tensor:
        maps, directions = (tensor.detach().contiguous() for tensor in (texture_maps, directions))
        x, y, z = directions.unbind(-1)
        around, upward = torch.atan2(x, z) / (2 * pi), torch.atan2(y, torch.hypot(x, z)) / pi
        coordinates = torch.stack((0.5 + around, 0.5 - upward), dim=-1)
        colors = maps.new_empty(len(maps), 3, *directions.shape[1:3])
        samples = directions.shape[1:3].numel()
        launch(_sample, len(maps), samples, SAMPLES, maps, directions, coordinates, colors, samples, maps.shape[-1])
        ctx.save_for_backward(maps, directions, coordinates)
        return colors

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, Tensor]:  # pyright: ignore[reportIncompatibleMethodOverride]
        maps, directions, _ = ctx.saved_tensors
        results = torch.zeros_like(maps), torch.empty_like(directions)
        samples = directions.shape[1:3].numel()
        arguments = (*ctx.saved_tensors, gradients[0].contiguous(), *results, samples, maps.shape[-1], pi)
        launch(_sample_backward, len(maps), samples, SAMPLES, *arguments)
        return results


def sample_sphere_texture(
    texture_maps: Float[Tensor, "B 3 T T"], directions: Float[Tensor, "B H W 3"]
) -> Float[Tensor, "B 3 H W"]:
    """Look up equirectangular maps as `texture.sample_sphere_texture` does, with its gradients."""
    return _Sample.apply(texture_maps, directions)
