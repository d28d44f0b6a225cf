"""Turntables: animations that every browser and viewer plays."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image
from torch import Tensor

from pipeline.errors import ConfigError
from pipeline.files import atomic_path


def write_gif(path: Path, frames: Float[Tensor, "K 3 H W"], milliseconds: int) -> None:
    """Write an endless animation, atomically; a frame is shown for so many milliseconds."""
    with ThreadPoolExecutor() as pool:  # choosing 256 colours takes longer than rendering, and leaves Python's lock
        first, *others = pool.map(_of_256_colors, _pixels(frames))
    with atomic_path(path) as temporary:
        first.save(temporary, "GIF", save_all=True, append_images=others, duration=milliseconds, loop=0)


def write_mp4(path: Path, frames: Float[Tensor, "K 3 H W"], milliseconds: int) -> None:
    """Write a film in H.264, which browsers play, atomically. Errors as in `encoder`."""
    write_frames = encoder()
    pixels = np.ascontiguousarray(_pixels(frames))
    with atomic_path(path) as temporary:
        rate: Any = 1000 / milliseconds  # ffmpeg takes fractions, whatever the annotation says
        film = write_frames(str(temporary), pixels.shape[2:0:-1], fps=rate, macro_block_size=2)  # sides become even
        film.send(None)
        for frame in pixels:
            film.send(frame)
        film.close()


def encoder() -> Callable[..., Any]:
    """Import what writes films. Raises ConfigError where the extra `video`, which brings it, is not installed."""
    try:
        from imageio_ffmpeg import write_frames
    except ImportError:
        raise ConfigError(
            "films need the encoder of imageio-ffmpeg; install it with `.venv/bin/pip install -c constraints.txt -e "
            "'.[video]'`"
        ) from None
    return write_frames


def _of_256_colors(frame: UInt8[np.ndarray, "H W 3"]) -> Image.Image:
    return Image.fromarray(frame).convert("P", palette=Image.Palette.ADAPTIVE)


def _pixels(frames: Float[Tensor, "K 3 H W"]) -> UInt8[np.ndarray, "K H W 3"]:
    return (frames.clamp(0, 1) * 255).round().byte().permute(0, 2, 3, 1).numpy()
