"""Compiled texture look-up for the CPU, parallel over pictures; importing this module imports numba."""

from math import floor, pi, sqrt
from typing import no_type_check

import numpy as np
from jaxtyping import Float, Int

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
def covered(
    directions: Float[np.ndarray, "pixels 3"],
) -> tuple[Int[np.ndarray, " K"], Float[np.ndarray, " K"], Float[np.ndarray, " K"], Float[np.ndarray, " K"]]:
    """Return which pixels have a direction, and the directions' components."""
    count, pixels, rows = 0, np.zeros(len(directions), np.int32), np.zeros((3, len(directions)), directions.dtype)
    xs, ys, zs = rows[0], rows[1], rows[2]  # unpacked, they would not be known to be contiguous
    for pixel in range(len(directions)):
        x, y, z = directions[pixel]
        # Always written, and kept by counting it: a branch would be mispredicted at every outline.
        pixels[count], xs[count], ys[count], zs[count] = pixel, x, y, z
        count += (x != 0.0) | (y != 0.0) | (z != 0.0)
    return pixels[:count], xs[:count], ys[:count], zs[:count]


@njit()
@no_type_check
def texel_coordinates(
    x: Float[np.ndarray, " K"], y: Float[np.ndarray, " K"], z: Float[np.ndarray, " K"], size: int
) -> tuple[Float[np.ndarray, " K"], Float[np.ndarray, " K"]]:
    """Return the rows and columns that directions fall on, 0 at the centre of the first; all at once, as vectors."""
    rows, columns = np.zeros(len(x)), np.zeros(len(x))
    for i in range(len(x)):
        u = 0.5 + arctangent(x[i], z[i]) / (2.0 * pi)
        v = 0.5 - arctangent(y[i], sqrt(x[i] * x[i] + z[i] * z[i])) / pi
        rows[i] = min(max(v * size - 0.5, 0.0), size - 1.0)
        columns[i] = u * size - 0.5
    return rows, columns


@njit()
@no_type_check
def texels(row: float, column: float, size: int) -> tuple[int, int, int, int, float, float]:
    """Return the two rows, the two columns and the fractions between them of a place in the map."""
    top, first = min(int(row), size - 2), floor(column)
    left = first + size if first < 0 else first
    right = 0 if left + 1 == size else left + 1
    return top, top + 1, left, right, row - top, column - first


@njit(parallel=True)
@no_type_check
def sample(
    texture_maps: Float[np.ndarray, "B 3 T T"], directions: Float[np.ndarray, "B H W 3"]
) -> Float[np.ndarray, "B 3 H W"]:
    """Return bilinear look-ups along directions, 0 for the zero direction."""
    batch, height, width = directions.shape[:3]
    texture_size, colors = texture_maps.shape[2], np.zeros((batch, 3, height * width), texture_maps.dtype)
    for picture in prange(batch):
        pixels, x, y, z = covered(directions[picture].reshape(-1, 3))
        rows, columns = texel_coordinates(x, y, z, texture_size)
        for i in range(len(pixels)):
            top, bottom, left, right, down, across = texels(rows[i], columns[i], texture_size)
            for channel in range(3):
                texture = texture_maps[picture, channel]
                upper_left, lower_left = texture[top, left], texture[bottom, left]
                upper = upper_left + across * (texture[top, right] - upper_left)
                lower = lower_left + across * (texture[bottom, right] - lower_left)
                colors[picture, channel, pixels[i]] = upper + down * (lower - upper)
    return colors.reshape(batch, 3, height, width)


@njit(parallel=True)
@no_type_check
def sample_backward(
    texture_maps: Float[np.ndarray, "B 3 T T"],
    directions: Float[np.ndarray, "B H W 3"],
    gradient: Float[np.ndarray, "B 3 H W"],
) -> tuple[Float[np.ndarray, "B 3 T T"], Float[np.ndarray, "B H W 3"]]:
    """Return the gradients with respect to texture maps and directions."""
    batch, height, width = directions.shape[:3]
    texture_size, map_gradient = texture_maps.shape[2], np.zeros_like(texture_maps)
    direction_gradient = np.zeros((batch, height * width, 3), directions.dtype)
    for picture in prange(batch):
        pixels, xs, ys, zs = covered(directions[picture].reshape(-1, 3))
        rows, columns = texel_coordinates(xs, ys, zs, texture_size)
        upstreams = gradient[picture].reshape(3, -1)
        for i in range(len(pixels)):
            top, bottom, left, right, down, across = texels(rows[i], columns[i], texture_size)
            slope_across, slope_down = 0.0, 0.0
            for channel in range(3):
                upstream = upstreams[channel, pixels[i]]
                texture, total = texture_maps[picture, channel], map_gradient[picture, channel]
                total[top, left] += upstream * (1.0 - down) * (1.0 - across)
                total[top, right] += upstream * (1.0 - down) * across
                total[bottom, left] += upstream * down * (1.0 - across)
                total[bottom, right] += upstream * down * across
                upper = texture[top, right] - texture[top, left]
                lower = texture[bottom, right] - texture[bottom, left]
                slope_across += upstream * (upper + down * (lower - upper))
                left_step = texture[bottom, left] - texture[top, left]
                right_step = texture[bottom, right] - texture[top, right]
                slope_down += upstream * (left_step + across * (right_step - left_step))
            if down == 0.0 or down == 1.0:
                slope_down = 0.0
            x, y, z = xs[i], ys[i], zs[i]
            square = x * x + z * z + 1e-12
            level = sqrt(square)
            slope_around = slope_across * texture_size / (2.0 * pi * square)
            slope_upward = -slope_down * texture_size / (pi * (square + y * y))
            direction_gradient[picture, pixels[i], 0] = slope_around * z - slope_upward * y * x / level
            direction_gradient[picture, pixels[i], 1] = slope_upward * level
            direction_gradient[picture, pixels[i], 2] = -slope_around * x - slope_upward * y * z / level
    return map_gradient, direction_gradient.reshape(directions.shape)
