"""Smooth random fields: foliage, clouds, asphalt, dirt."""

import numpy as np
from jaxtyping import Float

LATTICE = 32


def lattices(count: int, rng: np.random.Generator) -> Float[np.ndarray, "B 32 32"]:
    """Draw the random values that `fractal` interpolates."""
    return rng.uniform(-1.0, 1.0, (count, LATTICE, LATTICE)).astype(np.float32)


def fractal(
    lattice: Float[np.ndarray, "B 32 32"], u: Float[np.ndarray, "B H W"], v: Float[np.ndarray, "B H W"], octaves: int
) -> Float[np.ndarray, "B H W"]:
    """Sum octaves of periodic value noise at the points (u, v); range about [-1, 1], the largest features about 1 wide."""
    total = np.zeros(u.shape, np.float32)
    for octave in range(octaves):
        frequency = 2.0**octave
        total += _value(lattice, u * frequency + 7.3 * octave, v * frequency + 3.1 * octave) * 0.6**octave
    return total


def _value(
    lattice: Float[np.ndarray, "B 32 32"], u: Float[np.ndarray, "B H W"], v: Float[np.ndarray, "B H W"]
) -> Float[np.ndarray, "B H W"]:
    column, row = np.floor(u), np.floor(v)
    right, down = _ease(u - column), _ease(v - row)
    column, row = column.astype(np.int64) % LATTICE, row.astype(np.int64) % LATTICE
    next_column, next_row = (column + 1) % LATTICE, (row + 1) % LATTICE
    batch = np.arange(len(lattice))[:, None, None]
    upper = lattice[batch, row, column] * (1 - right) + lattice[batch, row, next_column] * right
    lower = lattice[batch, next_row, column] * (1 - right) + lattice[batch, next_row, next_column] * right
    return (upper * (1 - down) + lower * down).astype(np.float32)


def _ease(share: np.ndarray) -> np.ndarray:
    return share * share * (3 - 2 * share)
