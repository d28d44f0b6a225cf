"""Pictures as training stages read them: one array per category and split, in memory or on disk."""

from collections.abc import Iterator, Sequence
from itertools import accumulate
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor
from torch.nn import functional

from pipeline.errors import DataError

_BATCH = 1000


class MappedImages:
    """Pictures that stay in their files, as one collection: those asked for are read and brought to the device."""

    def __init__(self, parts: Sequence[UInt8[Tensor, "_ 3 _ _"]], size: int, device: torch.device) -> None:
        """Join what `load_images` returned for one or more files, reduced to `size` pixels as they are read."""
        self.parts, self.size, self.device = parts, size, device
        self.shape = torch.Size([sum(map(len, parts)), 3, size, size])
        self._ends = torch.tensor(list(accumulate(map(len, parts))))

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, rows: slice | Int[Tensor, " B"]) -> UInt8[Tensor, "B 3 H W"]:
        """Read some pictures, as indexing a tensor would return them."""
        index = torch.arange(*rows.indices(len(self))) if isinstance(rows, slice) else rows.cpu()
        owner = torch.bucketize(index, self._ends, right=True)
        images = torch.zeros((len(index), *self.shape[1:]), dtype=torch.uint8)
        for number in owner.unique().tolist():
            part, first = self.parts[number], int(self._ends[number]) - len(self.parts[number])
            images[owner == number] = _reduce(part[index[owner == number] - first], self.size)
        return images.to(self.device)

    def split(self, size: int) -> Iterator[UInt8[Tensor, "B 3 H W"]]:
        """Read all pictures in their order, up to `size` at a time."""
        return (self[start : start + size] for start in range(0, len(self), size))


Images = UInt8[Tensor, "N 3 H W"] | MappedImages
"""Pictures on the device, or on disk where they do not fit there: both give the same bytes for the same rows."""


def to_colors(images: UInt8[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Return colours in [0, 1], in memory of their own order."""
    return images.contiguous().float() / 255


def to_bytes(colors: Float[Tensor, "*shape"]) -> UInt8[Tensor, "*shape"]:
    """Round colours to whole numbers of 255ths; what is below 0 or above 1 becomes 0 or 255."""
    return (colors.clamp(0, 1) * 255).round().byte()


def load_images(path: Path) -> UInt8[Tensor, "N 3 H W"]:
    """Map the RGB pictures that `prepare_data` wrote into memory: what is used of them is read from disk.

    The tensor is not contiguous. Raises DataError where the file is missing or damaged.
    """
    if not path.is_file():
        raise DataError(f"{path} does not exist; run prepare_data for its dataset first, or check the category's name")
    try:
        pictures = np.load(path, mmap_mode="c", allow_pickle=False)
    except (EOFError, ValueError):
        raise DataError(f"{path} is damaged; copy it again, or run prepare_data for its dataset") from None
    return torch.from_numpy(pictures).permute(0, 3, 1, 2)


def load_images_of_size(path: Path, size: int) -> UInt8[Tensor, "N 3 size size"]:
    """Load pictures for renderings of `size` pixels to be compared with. Raises DataError where theirs differs."""
    images = load_images(path)
    if images.shape[-1] != size:
        raise DataError(
            f"{path} holds pictures of {images.shape[-1]} px, but renderer.size is {size}; prepare the photographs "
            f"under another name (DATASET=) at {size} px, or choose a SIZE= that compares {images.shape[-1]} px"
        )
    return images


def load_images_to_reduce(path: Path, size: int) -> UInt8[Tensor, "N 3 H W"]:
    """Load pictures that `place_images` can reduce to `size` pixels. Raises DataError where it cannot."""
    images = load_images(path)
    return images if images.shape[-1] % size == 0 else load_images_of_size(path, size)


def placed_bytes(images: Images) -> int:
    """Return how much of the device's memory pictures take: none where they are on disk."""
    return images.nbytes if isinstance(images, Tensor) else 0


def place_images(
    parts: Sequence[UInt8[Tensor, "_ 3 _ _"]], device: torch.device, memory: int, size: int | None = None
) -> Images:
    """Join pictures on the device where they take at most `memory` bytes; leave them on disk where they take more.

    `size` is that to which they are reduced, in pixels, for base shapes learn from smaller pictures than textures do.
    """
    mapped = MappedImages(parts, parts[0].shape[-1] if size is None else size, device)
    if len(mapped) * 3 * mapped.size**2 > memory:
        return mapped
    images = torch.empty(mapped.shape, dtype=torch.uint8, device=device)
    for start, batch in zip(range(0, len(mapped), _BATCH), mapped.split(_BATCH), strict=True):
        images[start : start + _BATCH] = batch
    return images


def _reduce(images: UInt8[Tensor, "N 3 _ _"], size: int) -> UInt8[Tensor, "N 3 {size} {size}"]:
    """Average pictures over squares of pixels."""
    factor = images.shape[-1] // size
    return images if factor == 1 else functional.avg_pool2d(images.float(), factor).round().byte()
