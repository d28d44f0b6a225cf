"""From radiance to a small picture: exposure, contrast, colour cast, softness, grain and JPEG."""

import io

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image


def develop(radiance: Float[np.ndarray, "B H W 3"], rng: np.random.Generator) -> UInt8[np.ndarray, "B H W 3"]:
    """Develop photographs, each with its own faults."""
    count = len(radiance)

    def vary(low: float, high: float, channels: int = 1) -> np.ndarray:
        return rng.uniform(low, high, (count, 1, 1, channels))

    radiance = radiance * _falloff(radiance.shape[1], vary(-0.35, 0.35, 2), vary(0.0, 0.35))
    metered = (0.17 / radiance.mean(axis=(1, 2, 3), keepdims=True)) ** vary(0.2, 0.8)
    exposed = np.clip(radiance * metered * np.exp2(vary(-0.5, 0.8)) * vary(0.95, 1.05, 3), 0, 1) ** (1 / 2.2)
    gray = exposed.mean(axis=-1, keepdims=True)
    colors = gray + (exposed - gray) * vary(0.4, 1.2)
    colors = 0.5 + (colors - 0.5) * vary(1.0, 1.7) + vary(-0.06, 0.06)
    colors = _soften(colors, vary(-0.35, 0.1)) + rng.normal(0.0, 1.0, colors.shape) * vary(0.0, 0.02)
    pictures = (np.clip(colors, 0, 1) * 255).round().astype(np.uint8)
    qualities = rng.integers(60, 96, count)
    return np.stack([_compress(picture, int(quality)) for picture, quality in zip(pictures, qualities, strict=True)])


def _falloff(size: int, slope: np.ndarray, vignette: np.ndarray) -> np.ndarray:
    """Return the unevenness of the light over the picture: a slope across it, and darker corners."""
    steps = np.linspace(-1, 1, size)
    x, y = np.meshgrid(steps, steps)
    lit = 1 + slope[..., :1] * x[..., None] + slope[..., 1:] * y[..., None]
    return lit * (1 - vignette * (x**2 + y**2)[..., None] / 2)


def shrink(pictures: Float[np.ndarray, "B H W C"], factor: int) -> Float[np.ndarray, "B h w C"]:
    """Average squares of `factor` pixels a side."""
    total = pictures[:, ::factor, ::factor].copy()
    for row in range(factor):
        for column in range(factor):
            if row or column:
                total += pictures[:, row::factor, column::factor]
    return total / factor**2


def _soften(pictures: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Blend every pixel with its four neighbours, `weight` from each pair."""
    for axis in (1, 2):
        padding = [(1, 1) if axis == other else (0, 0) for other in range(4)]
        padded = np.pad(pictures, padding, mode="edge")
        count = pictures.shape[axis]
        before, after = (np.take(padded, np.arange(start, start + count), axis) for start in (0, 2))
        pictures = pictures * (1 - weight) + (before + after) * weight / 2
    return pictures


def _compress(picture: np.ndarray, quality: int) -> np.ndarray:
    stream = io.BytesIO()
    Image.fromarray(picture).save(stream, "JPEG", quality=quality)
    return np.asarray(Image.open(stream))
