"""Turntables: animations that every browser and viewer plays."""

import shutil
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image
from torch import Tensor

from pipeline.datasets.images import to_bytes
from pipeline.errors import ConfigError, DataError
from pipeline.files import atomic_path


def write_gif(path: Path, frames: Float[Tensor, "K 3 H W"], milliseconds: int) -> None:
    """Write an endless animation, atomically; a frame is shown for so many milliseconds."""
    with ThreadPoolExecutor() as pool:  # choosing 256 colours takes longer than rendering, and leaves Python's lock
        first, *others = pool.map(_of_256_colors, _pixels(frames))
    with atomic_path(path) as temporary:
        first.save(temporary, "GIF", save_all=True, append_images=others, duration=milliseconds, loop=0)


def write_mp4(path: Path, frames: Float[Tensor, "K 3 H W"], milliseconds: int) -> None:
    """Write a film in H.264, which browsers play, atomically.

    Raises DataError where it cannot be written, and ConfigError as `encoder` does.
    """
    pixels = _pixels(frames)
    height, width = pixels.shape[1:3]
    shown = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"1000/{milliseconds}", "-i", "-"]
    even = ["-vf", "scale=ceil(iw/2)*2:ceil(ih/2)*2"]
    film = ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "25", "-f", "mp4"]
    with atomic_path(path) as temporary:
        words = [encoder(), "-y", "-v", "error", *shown, *even, *film, f"file:{temporary}"]
        ended = subprocess.run(words, input=pixels.tobytes(), capture_output=True, check=False)
        if ended.returncode:
            reason = ended.stderr.decode(errors="replace").strip().rpartition("\n")[2]
            raise DataError(f"{path} cannot be written ({reason}); look at its folder and the space that is left")


def encoder() -> str:
    """Return the program that writes films.

    Raises ConfigError where the extra `video`, which brings it, is missing, or the program is.
    """
    try:
        from imageio_ffmpeg import get_ffmpeg_exe
    except ImportError:
        raise ConfigError(
            "films need the encoder of imageio-ffmpeg; install it with `.venv/bin/pip install -c constraints.txt -e "
            "'.[video]'`"
        ) from None
    try:
        program = get_ffmpeg_exe()
    except RuntimeError:
        program = ""
    if shutil.which(program) is None:
        raise ConfigError(
            "films need ffmpeg, which imageio-ffmpeg does not find; install it, or mend IMAGEIO_FFMPEG_EXE"
        )
    return program


def _of_256_colors(frame: UInt8[np.ndarray, "H W 3"]) -> Image.Image:
    return Image.fromarray(frame).convert("P", palette=Image.Palette.ADAPTIVE)


def _pixels(frames: Float[Tensor, "K 3 H W"]) -> UInt8[np.ndarray, "K H W 3"]:
    return to_bytes(frames).permute(0, 2, 3, 1).numpy()
