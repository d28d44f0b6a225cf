"""Compiled texture look-up for the CPU, parallel over pictures; importing this module imports numba."""

from math import floor, pi, sqrt
from typing import no_type_check

import numpy as np
from jaxtyping import Float

from pipeline.rendering.compiled import njit, prange


@njit()
@no_type_check
def arctangent(y: float, x: float) -> float:
    """Return atan2(y, x) to 2e-8, several times as fast (Abramowitz & Stegun 4.4.49); 0 at the origin."""
    near, far = min(abs(x), abs(y)), max(abs(x), abs(y))
    slope = near / max(far, 1e-300)
    square = slope * slope
    angle = 0.0028662257
    angle = angle * square - 0.0161657367
    angle = angle * square + 0.0429096138
    angle = angle * square - 0.0752896400
    angle = angle * square + 0.1065626393
    angle = angle * square - 0.1420889944
    angle = angle * square + 0.1999355085
    angle = angle * square - 0.3333314528
    angle = slope + slope * square * angle
    angle = 0.5 * pi - angle if abs(y) > abs(x) else angle
    angle = pi - angle if x < 0.0 else angle
    return -angle if y < 0.0 else angle


@njit()
@no_type_check
def texels(x: float, y: float, z: float, size: int) -> tuple[int, int, int, int, float, float]:
    """Return the two rows, the two columns and the fractions between them that a direction falls on."""
    u = 0.5 + arctangent(x, z) / (2.0 * pi)
    v = 0.5 - arctangent(y, sqrt(x * x + z * z)) / pi
    column = u * size - 0.5
    row = min(max(v * size - 0.5, 0.0), size - 1.0)
    first, top = floor(column), min(int(row), size - 2)
    left = first + size if first < 0 else first
    right = 0 if left + 1 == size else left + 1
    return top, top + 1, left, right, row - top, column - first


@njit(parallel=True)
@no_type_check
def sample(
    texture_maps: Float[np.ndarray, "B 3 T T"], directions: Float[np.ndarray, "B H W 3"]
) -> Float[np.ndarray, "B 3 H W"]:
    """Return bilinear look-ups along directions, 0 for the zero direction."""
    batch, size = directions.shape[:2]
    colors = np.zeros((batch, 3, size, size), texture_maps.dtype)
    for picture in prange(batch):
        for i in range(size):
            for j in range(size):
                x, y, z = directions[picture, i, j]
                if x != 0.0 or y != 0.0 or z != 0.0:
                    top, bottom, left, right, down, across = texels(x, y, z, texture_maps.shape[2])
                    for channel in range(3):
                        texture = texture_maps[picture, channel]
                        upper = texture[top, left] + across * (texture[top, right] - texture[top, left])
                        lower = texture[bottom, left] + across * (texture[bottom, right] - texture[bottom, left])
                        colors[picture, channel, i, j] = upper + down * (lower - upper)
    return colors


@njit(parallel=True)
@no_type_check
def sample_backward(
    texture_maps: Float[np.ndarray, "B 3 T T"],
    directions: Float[np.ndarray, "B H W 3"],
    gradient: Float[np.ndarray, "B 3 H W"],
) -> tuple[Float[np.ndarray, "B 3 T T"], Float[np.ndarray, "B H W 3"]]:
    """Return the gradients with respect to texture maps and directions."""
    batch, size = directions.shape[:2]
    map_gradient = np.zeros_like(texture_maps)
    direction_gradient = np.zeros_like(directions)
    texture_size = texture_maps.shape[2]
    for picture in prange(batch):
        for i in range(size):
            for j in range(size):
                x, y, z = directions[picture, i, j]
                if x != 0.0 or y != 0.0 or z != 0.0:
                    top, bottom, left, right, down, across = texels(x, y, z, texture_size)
                    slope_across, slope_down = 0.0, 0.0
                    for channel in range(3):
                        upstream = gradient[picture, channel, i, j]
                        texture, total = texture_maps[picture, channel], map_gradient[picture, channel]
                        total[top, left] += upstream * (1.0 - down) * (1.0 - across)
                        total[top, right] += upstream * (1.0 - down) * across
                        total[bottom, left] += upstream * down * (1.0 - across)
                        total[bottom, right] += upstream * down * across
                        upper, lower = (
                            texture[top, right] - texture[top, left],
                            texture[bottom, right] - texture[bottom, left],
                        )
                        slope_across += upstream * (upper + down * (lower - upper))
                        left_step, right_step = (
                            texture[bottom, left] - texture[top, left],
                            texture[bottom, right] - texture[top, right],
                        )
                        slope_down += upstream * (left_step + across * (right_step - left_step))
                    if down == 0.0 or down == 1.0:
                        slope_down = 0.0
                    square = x * x + z * z + 1e-12
                    level = sqrt(square)
                    slope_around = slope_across * texture_size / (2.0 * pi * square)
                    slope_upward = -slope_down * texture_size / (pi * (square + y * y))
                    direction_gradient[picture, i, j, 0] = slope_around * z - slope_upward * y * x / level
                    direction_gradient[picture, i, j, 1] = slope_upward * level
                    direction_gradient[picture, i, j, 2] = -slope_around * x - slope_upward * y * z / level
    return map_gradient, direction_gradient
