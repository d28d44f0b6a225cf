"""Lists of lists as flat tensors."""

import torch
from jaxtyping import Int
from torch import Tensor


def expand(counts: Int[Tensor, " N"]) -> tuple[Int[Tensor, " M"], Int[Tensor, " M"]]:
    """Return owner and position of every member of lists with the given lengths, list after list."""
    owner = torch.arange(len(counts), device=counts.device).repeat_interleave(counts)
    first = counts.cumsum(0) - counts
    return owner, torch.arange(len(owner), device=counts.device) - first[owner]
