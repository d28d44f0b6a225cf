"""What the pose networks read off many photographs."""

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.datasets.images import Images
from pipeline.networks.full_model import FullModel

_CHUNK = 250
"""Photographs that are read at once."""


def read_all_poses(model: FullModel, photographs: Images, first: int = 0) -> Float[Tensor, "_ 7"]:
    """Return what the model reads off photographs from number `first` on, as pose coordinates."""
    starts = range(first, len(photographs), _CHUNK)
    return torch.cat([model.read_poses(photographs[start : start + _CHUNK].float() / 255) for start in starts])
