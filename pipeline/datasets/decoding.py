"""Turn the bytes of a picture into an array of the wanted size."""

import io
import math
import struct
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Literal

import numpy as np
from jaxtyping import UInt8
from PIL import Image, ImageCms, ImageOps, UnidentifiedImageError
from pillow_heif import register_heif_opener

from pipeline.errors import DataError

register_heif_opener()  # PIL reads what telephones of Apple write

Fit = Literal["crop", "pad"]
"""How a picture becomes square.

`crop` brings its short side to the wanted size and cuts the long side to the middle; `pad` brings its long side to that
size and continues the border pixels along the short one.
"""

_FORMATS = ("BMP", "GIF", "HEIF", "JPEG", "PNG", "TIFF", "WEBP")
"""Of what PIL reads, whatever a file is called: for others, such as PostScript, it starts other programs."""
_PROFILED = {"RGB ": "RGB", "GRAY": "L", "CMYK": "CMYK", "Lab ": "LAB"}
"""Modes of pictures whose colours a profile describes."""

Box = tuple[int, int, int, int]
"""Left, top, right and bottom in pixels; right and bottom are the first ones outside."""


def decode(content: bytes, name: str, size: int, fit: Fit) -> UInt8[np.ndarray, "size size 3"]:
    """Decode an RGB picture (JPEG, PNG, HEIC, ...), turned upright as its EXIF data says, in the colours of sRGB.

    Pictures are made smaller, never larger. Raises DataError, naming the picture, if it cannot be read to its end, is
    not RGB, or is too small.
    """
    picture = _upright(content, name)
    side = _fitted_side(picture, fit)
    if side < size:
        which, found = "short" if fit == "crop" else "long", f"{picture.width}x{picture.height}"
        raise DataError(f"{name} is {found} px; expected at least {size} px along the {which} side")
    return _fitted(picture, name, size, fit)


def decode_up_to(content: bytes, name: str, most: int, size: int, fit: Fit) -> UInt8[np.ndarray, "side side 3"]:
    """Decode the square that `decode` shows at `size` pixels a side, with up to `most` where the picture has them.

    The square of a small picture has as many pixels as it has, however few. Raises DataError as `decode` does, but not
    for a small one.
    """
    picture = _upright(content, name)
    profile, side = picture.info.get("icc_profile"), min(most, _fitted_side(picture, fit))
    if side <= size:
        return _fitted(picture, name, side, fit)
    picture = picture.reduce(max(1, _fitted_side(picture, fit) // (4 * side)))  # or a panorama's square takes gigabytes
    factor = size / _fitted_side(picture, fit)
    (left, right), (top, bottom) = (_window(length, factor, size) for length in picture.size)
    continued, window = _continued(picture, (left, top, right, bottom))
    square = continued.resize((side, side), Image.Resampling.LANCZOS, window, reducing_gap=3.0)
    return np.asarray(to_srgb(square, name, profile))


def _continued(
    picture: Image.Image, window: tuple[float, float, float, float]
) -> tuple[Image.Image, tuple[float, float, float, float]]:
    """Continue a picture by its border pixels to where a window (left, top, right, bottom) reaches.

    Return it and the window's place in it.
    """
    left, top, right, bottom = window
    before, above = max(0, math.ceil(-left)), max(0, math.ceil(-top))
    after, below = max(0, math.ceil(right - picture.width)), max(0, math.ceil(bottom - picture.height))
    continued = np.pad(np.asarray(picture), [(above, below), (before, after), (0, 0)], mode="edge")
    return Image.fromarray(continued), (before + left, above + top, before + right, above + bottom)


def cut_boxes(content: bytes, name: str, boxes: Sequence[Box], size: int) -> list[UInt8[np.ndarray, "size size 3"]]:
    """Cut boxes out of a picture and make them square as `pad` does; small ones are enlarged, grey becomes RGB.

    Boxes count from the picture's corner as it is stored, and end at its border. Raises DataError, naming the picture,
    if it cannot be read to its end or a box has no pixel of it.
    """
    with reading(name):
        picture = open_picture(content)
        picture.load()
    picture = to_srgb(picture, name, picture.info.get("icc_profile"))
    return [_cut(picture, name, box, size) for box in boxes]


def _cut(picture: Image.Image, name: str, box: Box, size: int) -> UInt8[np.ndarray, "size size 3"]:
    left, top, right, bottom = box
    inside = (max(left, 0), max(top, 0), min(right, picture.width), min(bottom, picture.height))
    if inside[0] >= inside[2] or inside[1] >= inside[3]:
        found = f"{picture.width}x{picture.height}"
        raise DataError(f"{name} is {found} px, but an object's box spans {box}; expected one inside of the picture")
    part = picture.crop(inside)
    return _square(np.asarray(_scaled(part, size / max(part.size))), size)


def open_picture(content: bytes) -> Image.Image:
    """Open a picture of one of the formats that photographs have, as `PIL.Image.open` does."""
    return Image.open(io.BytesIO(content), formats=_FORMATS)


def _upright(content: bytes, name: str) -> Image.Image:
    with reading(name):
        stored = open_picture(content)
        picture = ImageOps.exif_transpose(stored)
        picture.load()
    if picture.mode != "RGB" or picture.has_transparency_data:
        mode = picture.mode if picture.mode != "RGB" else "RGB with a transparent colour"
        how = "" if stored.format == "GIF" else " (`kato3d arrange` does)"
        raise DataError(f"{name} has the colour mode {mode}; expected RGB; convert it{how} or remove it")
    return picture


def _fitted_side(picture: Image.Image, fit: Fit) -> int:
    return min(picture.size) if fit == "crop" else max(picture.size)


def _fitted(picture: Image.Image, name: str, size: int, fit: Fit) -> UInt8[np.ndarray, "size size 3"]:
    smaller = _scaled(picture, size / _fitted_side(picture, fit))
    return _square(np.asarray(to_srgb(smaller, name, picture.info.get("icc_profile"))), size)


@contextmanager
def reading(name: str) -> Iterator[None]:
    """Turn what goes wrong when a picture is read inside the block into a DataError that names the picture.

    What PIL warns of, such as EXIF data that it can do without, is not told.
    """
    try:
        with warnings.catch_warnings(action="ignore"):
            yield
    except UnidentifiedImageError:  # its text names the buffer, not the picture
        raise DataError(f"{name} cannot be read as a picture (unknown format); replace or remove it") from None
    except Image.DecompressionBombError as error:
        sizes = str(error).partition(", could be")[0]
        raise DataError(f"{name} is too large to be read: {sizes}; make it smaller or remove it") from None
    except (  # the last two: EXIF data of the wrong types, which turning a picture upright writes anew
        EOFError,
        OSError,
        RuntimeError,
        SyntaxError,
        ValueError,
        struct.error,
        TypeError,
    ) as error:
        raise DataError(f"{name} cannot be read as a picture ({error}); replace or remove it") from None


def to_srgb(picture: Image.Image, name: str, profile: bytes | None) -> Image.Image:
    """Bring a picture to RGB, and its colours from those of its ICC profile to those of sRGB.

    Telephones photograph in wider colours than sRGB, which look dull when taken for those of sRGB, as all colours
    without a profile are. Raises DataError, naming the picture, for a profile that cannot be applied.
    """
    if profile is None:
        return picture.convert("RGB")
    try:
        of_picture = ImageCms.ImageCmsProfile(io.BytesIO(profile))
        mode = _PROFILED[of_picture.profile.xcolor_space]  # pyright: ignore[reportAttributeAccessIssue]
        if picture.mode == "RGB" != mode:
            return picture  # a profile of grey or of inks, left over from before, says nothing of these colours
        seen = ImageCms.profileToProfile(
            picture.convert(mode), of_picture, ImageCms.createProfile("sRGB"), outputMode="RGB"
        )
    except (ImageCms.PyCMSError, KeyError, OSError, TypeError, ValueError) as error:
        raise DataError(f"{name} has a colour profile that cannot be used ({error}); convert or remove it") from None
    assert seen is not None  # a new picture, as profileToProfile was not told to change the one given
    return seen


def _scaled(picture: Image.Image, factor: float) -> Image.Image:
    width, height = (_scaled_side(side, factor) for side in picture.size)
    return picture.resize((width, height), Image.Resampling.LANCZOS, reducing_gap=3.0)


def _scaled_side(length: int, factor: float) -> int:
    return max(1, round(length * factor))


def _start(length: int, size: int) -> int:
    """Return which pixel of a side is the square's first: below 0 where the side is shorter and continued."""
    return math.trunc((length - size) / 2)


def _window(length: int, factor: float, size: int) -> tuple[float, float]:
    """Return what the square shows of a side that was scaled, in pixels before scaling; it may reach beyond them."""
    scaled = _scaled_side(length, factor)
    start = _start(scaled, size)
    return start * length / scaled, (start + size) * length / scaled


def _square(pixels: UInt8[np.ndarray, "H W 3"], size: int) -> UInt8[np.ndarray, "size size 3"]:
    for axis in (0, 1):
        start, missing = _start(pixels.shape[axis], size), size - pixels.shape[axis]
        if missing < 0:
            pixels = pixels.take(range(start, start + size), axis)
        if missing > 0:
            padding = [(0, 0), (0, 0), (0, 0)]
            padding[axis] = (-start, missing + start)
            pixels = np.pad(pixels, padding, mode="edge")
    return pixels
