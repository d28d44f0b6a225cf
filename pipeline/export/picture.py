"""Pictures as PNG: files for figures, and text that stands inside a page."""

import base64
from pathlib import Path

import cv2
import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.files import atomic_path


def tile(rows: Float[Tensor, "R K C H W"], gap: int, shade: float) -> Float[Tensor, "C height width"]:
    """Lay pictures out as rows and columns, `gap` pixels of one shade of grey between and around them."""
    count_rows, count_columns, channels, height, width = rows.shape
    sheet = torch.full(
        (channels, count_rows * (height + gap) + gap, count_columns * (width + gap) + gap), shade, dtype=rows.dtype
    )
    for row in range(count_rows):
        for column in range(count_columns):
            top, left = gap + row * (height + gap), gap + column * (width + gap)
            sheet[:, top : top + height, left : left + width] = rows[row, column]
    return sheet


def enlarge(pictures: Float[Tensor, "*batch H W"], factor: int) -> Float[Tensor, "*batch height width"]:
    """Repeat every pixel `factor` times in both directions, so that small pictures keep their pixels."""
    return pictures.repeat_interleave(factor, dim=-1).repeat_interleave(factor, dim=-2)


def strip(pictures: Float[Tensor, "K C H W"]) -> Float[Tensor, "C H width"]:
    """Put pictures side by side without gaps."""
    return torch.cat(list(pictures), dim=-1)


def encode_png(picture: Float[Tensor, "C H W"]) -> bytes:
    """Encode a picture of 3 (RGB) or 4 (RGB and opacity) channels in [0, 1]; the same picture gives the same bytes."""
    pixels = (picture.clamp(0, 1) * 255).round().byte().permute(1, 2, 0).contiguous().numpy()
    to_opencv = cv2.COLOR_RGBA2BGRA if picture.shape[0] == 4 else cv2.COLOR_RGB2BGR
    _, encoded = cv2.imencode(".png", cv2.cvtColor(pixels, to_opencv), [cv2.IMWRITE_PNG_COMPRESSION, 9])
    return encoded.tobytes()


def data_uri(picture: Float[Tensor, "C H W"]) -> str:
    """Encode a picture as the address of an `img` element, so that the page needs no file beside it."""
    return "data:image/png;base64," + base64.b64encode(encode_png(picture)).decode()


def write_png(path: Path, picture: Float[Tensor, "C H W"]) -> None:
    """Write a picture as PNG, atomically."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(encode_png(picture))
