"""Photographs of any colour mode become RGB."""

import io

import numpy as np
from PIL import Image, ImageOps
from PIL.TiffImagePlugin import PHOTOMETRIC_INTERPRETATION, TiffImageFile

from pipeline.datasets.decoding import open_picture, reading, to_srgb
from pipeline.errors import DataError


def to_rgb(content: bytes, name: str) -> bytes:
    """Return the bytes of a photograph, or of the PNG it becomes where it is grey, transparent or otherwise not RGB.

    Raises DataError, naming the photograph, as `open_rgb` does.
    """
    with reading(name):
        picture = open_picture(content)
    if picture.mode == "RGB" and not picture.has_transparency_data:
        return content
    converted = io.BytesIO()
    open_rgb(content, name).save(converted, "PNG", icc_profile=None)
    return converted.getvalue()


def open_rgb(content: bytes, name: str) -> Image.Image:
    """Open a photograph upright, in RGB in the colours of sRGB, on white where it is transparent.

    Raises DataError, naming the photograph, where it cannot be read to its end, or its range of greys is not known.
    """
    with reading(name):
        stored = open_picture(content)
        picture = ImageOps.exif_transpose(stored)
        picture.load()
    profile = picture.info.get("icc_profile")
    white_is_zero = isinstance(stored, TiffImageFile) and stored.tag_v2.get(PHOTOMETRIC_INTERPRETATION) == 0
    picture = _eight_bits(picture, name, white_is_zero)
    if picture.has_transparency_data:
        picture = picture.convert("RGBA")
        picture = Image.alpha_composite(Image.new("RGBA", picture.size, "white"), picture)
    return to_srgb(picture, name, profile)


def _eight_bits(picture: Image.Image, name: str, white_is_zero: bool) -> Image.Image:
    """Bring grey values of 16 bits to 8, which PIL would cut off at 255, and a transparent one to white."""
    if picture.mode == "F":
        raise DataError(f"{name} has grey values that are fractions; expected 8 or 16 bits")  # their range is not known
    if not picture.mode.startswith("I"):
        return picture
    grey = np.asarray(picture).astype(np.int64)
    if grey.min() < 0 or grey.max() > 65535:
        raise DataError(f"{name} has grey values of 32 bits; expected 8 or 16 bits")
    grey = np.where(grey == picture.info.get("transparency"), 65535, 65535 - grey if white_is_zero else grey)
    return Image.fromarray((grey / 257).round().astype(np.uint8))
