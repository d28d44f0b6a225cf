"""Pictures as PNG: files for figures, and text that stands inside a page."""

import base64
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from pipeline.datasets.images import to_bytes
from pipeline.files import atomic_path

GAP = 4
"""Pixels between the pictures of a sheet and around them."""
NAME_HEIGHT = 24
"""Of the line above a row of a sheet, in pixels."""
_FONT, _FONT_SCALE = cv2.FONT_HERSHEY_SIMPLEX, 0.55


def sheet(rows: Mapping[str, Float[Tensor, "K 3 _ W"]]) -> Float[Tensor, "3 height width"]:
    """Lay rows of pictures on white, each below its name and without what all of its pictures leave white.

    Pictures have the same width and those of a row the same height.
    """
    names = [_write(name) for name in rows]
    laid = [strip(functional.pad(_trim(pictures), (GAP, 0, GAP, 0), value=1.0)) for pictures in rows.values()]
    parts = [part for pair in zip(names, laid, strict=True) for part in pair]
    width = max(part.shape[-1] for part in parts) + GAP
    parts = [functional.pad(part, (0, width - part.shape[-1]), value=1.0) for part in parts]
    return functional.pad(torch.cat(parts, dim=1), (0, 0, 0, GAP), value=1.0)


def _trim(pictures: Float[Tensor, "K 3 H W"]) -> Float[Tensor, "K 3 height W"]:
    """Cut off the rows of pixels that are white in all pictures, above and below the others."""
    filled = (pictures < 1).any(dim=3).any(dim=1).any(dim=0).nonzero()
    return pictures[:, :, filled.min() : filled.max() + 1] if len(filled) else pictures


def _write(text: str) -> Float[Tensor, "3 height width"]:
    """Write a line in black on white."""
    (width, _), _ = cv2.getTextSize(text, _FONT, _FONT_SCALE, 1)
    line = np.full((NAME_HEIGHT, GAP + width), 255, dtype=np.uint8)
    cv2.putText(line, text, (GAP, NAME_HEIGHT - 6), _FONT, _FONT_SCALE, 0, 1, cv2.LINE_AA)
    return torch.from_numpy(line).expand(3, -1, -1) / 255


def enlarge(pictures: Float[Tensor, "*batch H W"], factor: int) -> Float[Tensor, "*batch height width"]:
    """Repeat every pixel `factor` times in both directions, so that small pictures keep their pixels."""
    return pictures.repeat_interleave(factor, dim=-1).repeat_interleave(factor, dim=-2)


def strip(pictures: Float[Tensor, "K C H W"]) -> Float[Tensor, "C H width"]:
    """Put pictures side by side without gaps."""
    return torch.cat(list(pictures), dim=-1)


def encode_png(picture: Float[Tensor, "C H W"]) -> bytes:
    """Encode a picture of 3 (RGB) or 4 (RGB and opacity) channels in [0, 1]; the same picture gives the same bytes."""
    pixels = to_bytes(picture).permute(1, 2, 0).contiguous().numpy()
    to_opencv = cv2.COLOR_RGBA2BGRA if picture.shape[0] == 4 else cv2.COLOR_RGB2BGR
    _, encoded = cv2.imencode(".png", cv2.cvtColor(pixels, to_opencv), [cv2.IMWRITE_PNG_COMPRESSION, 9])
    return encoded.tobytes()


def data_uri(picture: Float[Tensor, "C H W"]) -> str:
    """Encode a picture as the address of an `img` element, so that the page needs no file beside it."""
    return png_uri(encode_png(picture))


def png_uri(png: bytes) -> str:
    """Return the address of a picture that is encoded already."""
    return "data:image/png;base64," + base64.b64encode(png).decode()


def write_png(path: Path, picture: Float[Tensor, "C H W"]) -> None:
    """Write a picture as PNG, atomically."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(encode_png(picture))
