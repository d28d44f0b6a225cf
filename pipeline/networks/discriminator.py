"""Discriminator of view prior learning."""

from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional


class ViewDiscriminator(nn.Module):
    """Tell renderings at estimated views from renderings at random views, given the view (Kato & Harada 2019).

    The view is an input so that the discriminator has to judge how the object looks, not which views are frequent.
    """

    def __init__(self, width: int, view_size: int) -> None:
        super().__init__()
        widths = (3, width, 2 * width, 4 * width)
        self.convolutions = nn.ModuleList(
            nn.utils.parametrizations.spectral_norm(nn.Conv2d(narrow, wide, 4, 2, 1))
            for narrow, wide in pairwise(widths)
        )
        self.view = nn.Linear(view_size, 4 * width)
        self.score = nn.Linear(4 * width, 1)

    def forward(self, images: Float[Tensor, "B 3 H W"], views: Float[Tensor, "B K"]) -> Float[Tensor, " B"]:
        """Return logits, positive for "rendered at an estimated view".

        Pictures are in [0, 1], `views` are pose coordinates. Gradients flow to both.
        """
        maps = 2 * images - 1
        for convolution in self.convolutions:
            maps = functional.leaky_relu(convolution(maps), 0.2)
        pooled = maps.mean(dim=(2, 3))
        joint = functional.leaky_relu(pooled + self.view(views), 0.2)
        return torch.squeeze(self.score(joint), 1)
