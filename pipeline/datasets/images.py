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
