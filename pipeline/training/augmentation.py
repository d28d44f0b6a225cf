"""Vary batches of photographs, as bytes."""

import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor


def crop_and_mirror(images: UInt8[Tensor, "B 3 H W"], margin: int, rng: torch.Generator) -> UInt8[Tensor, "B 3 H W"]:
    """Shift each picture by up to `margin` pixels a side (its border reflected) and mirror half of them.

    One gather does it all: the reflected and mirrored coordinates are computed, never a padded picture. The result is
    laid out channels last.
    """
    batch, _, height, width = images.shape
    shift_y, shift_x = torch.randint(-margin, margin + 1, (2, batch, 1), generator=rng, device=rng.device)
    mirrored = torch.randint(2, (batch, 1), generator=rng, device=rng.device).bool()
    row = _reflect(torch.arange(height, device=rng.device) + shift_y, height)
    column = _reflect(torch.arange(width, device=rng.device) + shift_x, width)
    column = torch.where(mirrored, column.flip(1), column)
    picture = torch.arange(batch, device=rng.device)
    return images[picture[:, None, None], :, row[:, :, None], column[:, None, :]].permute(0, 3, 1, 2)


def turn(images: UInt8[Tensor, "B 3 H W"], quarters: Int[Tensor, " B"]) -> UInt8[Tensor, "B 3 H W"]:
    """Turn every square picture counter-clockwise by its number of right angles, 0 to 3."""
    turned = torch.stack([images.rot90(count, (2, 3)) for count in range(4)])
    return turned[quarters, torch.arange(len(images), device=images.device)]


def to_float(images: UInt8[Tensor, "B 3 H W"]) -> Float[Tensor, "B 3 H W"]:
    """Turn bytes into numbers in [0, 1], channels last."""
    return images.contiguous(memory_format=torch.channels_last).float() / 255


def _reflect(position: Int[Tensor, "..."], size: int) -> Int[Tensor, "..."]:
    there_and_back = max(2 * (size - 1), 1)
    position = position.remainder(there_and_back)
    return torch.minimum(position, there_and_back - position)
