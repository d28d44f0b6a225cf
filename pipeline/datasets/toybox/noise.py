"""Random fields with the spectra of natural surfaces: foliage, clouds, asphalt, dirt."""

import numpy as np
from jaxtyping import Float

SIZE = 128


def textures(count: int, rng: np.random.Generator) -> Float[np.ndarray, "B 128 128"]:
    """Draw periodic fields of zero mean and unit variance whose amplitude falls with frequency to a random power."""
    white = rng.standard_normal((count, SIZE, SIZE), dtype=np.float32)
    frequency = np.hypot(np.fft.fftfreq(SIZE)[:, None], np.fft.rfftfreq(SIZE)) * SIZE
    frequency[0, 0] = np.inf
    slope = rng.uniform(0.7, 1.5, (count, 1, 1))
    field = np.fft.irfft2(np.fft.rfft2(white) * frequency**-slope, s=(SIZE, SIZE))
    return (field / field.std(axis=(1, 2), keepdims=True)).astype(np.float32)


def sample(
    texture: Float[np.ndarray, "B 128 128"], u: Float[np.ndarray, "B H W"], v: Float[np.ndarray, "B H W"]
) -> Float[np.ndarray, "B H W"]:
    """Look fields up at points (u, v), without interpolation; the period is 1."""
    column, row = ((np.floor(at * SIZE).astype(np.int32) % SIZE) for at in (u, v))
    return texture[np.arange(len(texture))[:, None, None], row, column]
