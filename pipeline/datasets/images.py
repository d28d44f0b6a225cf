"""Pictures as training stages read them: one array per category and split."""

from pathlib import Path

import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor

from pipeline.errors import DataError


def load_images(path: Path) -> UInt8[Tensor, "N 3 H W"]:
    """Load the RGB pictures that `prepare_data` wrote. Raises DataError where there are none."""
    if not path.is_file():
        raise DataError(f"{path} does not exist; run prepare_data for its dataset first, or check the category's name")
    return torch.from_numpy(np.load(path)).permute(0, 3, 1, 2).contiguous()


def load_images_of_size(path: Path, size: int) -> UInt8[Tensor, "N 3 size size"]:
    """Load pictures for renderings of `size` pixels to be compared with. Raises DataError where theirs differs."""
    images = load_images(path)
    if images.shape[-1] != size:
        raise DataError(
            f"{path} holds pictures of {images.shape[-1]} px, but renderer.size is {size}; give its dataset a size of "
            f"{size} under its kind, or the run one of {images.shape[-1]}"
        )
    return images
