"""Pictures as training stages read them: one array per category and split, in memory or on disk."""

from collections.abc import Iterator, Sequence
from itertools import accumulate
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Int, UInt8
from torch import Tensor

from pipeline.errors import DataError


class MappedImages:
    """Pictures that stay in their files, as one collection: those asked for are read and brought to the device."""

    def __init__(self, parts: Sequence[UInt8[Tensor, "_ 3 H W"]], device: torch.device) -> None:
        """Join what `load_images` returned for one or more files."""
        self.parts, self.device = parts, device
        self.shape = torch.Size([sum(map(len, parts)), *parts[0].shape[1:]])
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
            images[owner == number] = part[index[owner == number] - first]
        return images.to(self.device)

    def split(self, size: int) -> Iterator[UInt8[Tensor, "B 3 H W"]]:
        """Read all pictures in their order, up to `size` at a time."""
        return (self[start : start + size] for start in range(0, len(self), size))


Images = UInt8[Tensor, "N 3 H W"] | MappedImages
"""Pictures on the device, or on disk where they do not fit there: both give the same bytes for the same rows."""


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


def placed_bytes(images: Images) -> int:
    """Return how much of the device's memory pictures take: none where they are on disk."""
    return images.nbytes if isinstance(images, Tensor) else 0


def place_images(parts: Sequence[UInt8[Tensor, "_ 3 H W"]], device: torch.device, memory: int) -> Images:
    """Join pictures on the device where they take at most `memory` bytes; leave them on disk where they take more."""
    if sum(part.nbytes for part in parts) > memory:
        return MappedImages(parts, device)
    return torch.cat(list(parts)).contiguous().to(device)
