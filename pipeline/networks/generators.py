"""Generators: from a latent vector to a shape, a texture map or a background (paper 3.1.1, 3.1.2 and 3.1.4).

In base-shape learning the latent is noise; in full training it is the output of an encoder.
"""

from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from pipeline.errors import ConfigError
from pipeline.networks.batch_normalization import BatchNorm2d


class ShapeGenerator(nn.Module):
    """Map a latent vector to an offset of every vertex (paper 3.1.1).

    The last layer starts near zero, so that the first shapes are the initial ellipsoid.
    """

    def __init__(self, latent_size: int, hidden_size: int, vertex_count: int, offset_scale: float) -> None:
        super().__init__()
        self.offset_scale = offset_scale
        output = nn.Linear(hidden_size, vertex_count * 3)
        nn.init.normal_(output.weight, std=1e-3)
        nn.init.zeros_(output.bias)
        self.layers = nn.Sequential(
            nn.Linear(latent_size, hidden_size),
            nn.ReLU(),
            nn.Linear(hidden_size, hidden_size),
            nn.ReLU(),
            output,
        )

    def forward(self, latent: Float[Tensor, "B K"]) -> Float[Tensor, "B V 3"]:
        """Return vertex offsets in world units."""
        return self.offset_scale * self.layers(latent).unflatten(1, (-1, 3))


class SpherePad(nn.Module):
    """Add the neighbouring row or column on every side of equirectangular maps, which are a sphere without borders.

    The first and the last column are neighbours, and beyond a pole lies the row next to it, half way round.
    """

    def forward(self, maps: Float[Tensor, "B C T T"]) -> Float[Tensor, "B C T+2 T+2"]:
        """Return the padded maps."""
        half = maps.shape[-1] // 2
        above, below = maps[:, :, :1].roll(half, dims=-1), maps[:, :, -1:].roll(half, dims=-1)
        rows = torch.cat([above, maps, below], dim=2)
        return torch.cat([rows[..., -1:], rows, rows[..., :1]], dim=-1)


class ResidualUpsample(nn.Module):
    """Double the resolution of a feature map and refine it with a residual block."""

    def __init__(self, in_channels: int, out_channels: int, padding: nn.Module) -> None:
        super().__init__()
        self.upsample = nn.Upsample(scale_factor=2.0, mode="nearest")
        self.shortcut = nn.Conv2d(in_channels, out_channels, 1)
        self.residual = nn.Sequential(
            BatchNorm2d(in_channels),
            nn.ReLU(),
            self.upsample,
            padding,
            nn.Conv2d(in_channels, out_channels, 3),
            BatchNorm2d(out_channels),
            nn.ReLU(),
            padding,
            nn.Conv2d(out_channels, out_channels, 3),
        )

    def forward(self, features: Float[Tensor, "B C H W"]) -> Float[Tensor, "B K 2*H 2*W"]:
        """Return features at twice the resolution."""
        return self.upsample(self.shortcut(features)) + self.residual(features)


class ImageGenerator(nn.Module):
    """Map a latent vector to a square image by a DCGAN-like network with residual connections (paper 3.1.2)."""

    def __init__(self, latent_size: int, hidden_channels: int, out_channels: int, size: int, on_sphere: bool) -> None:
        """Draw images of `size` pixels, on the sphere equirectangular maps.

        Raises ConfigError for a size that is no power of two from 4.
        """
        super().__init__()
        if size < 4 or size & (size - 1):
            raise ConfigError(f"textures and backgrounds cannot be {size} px wide; expected 4, 8, 16, 32, 64 or so on")
        blocks = (size // 4).bit_length() - 1
        widths = [hidden_channels * 2 ** max(blocks - 1 - i, 0) for i in range(blocks + 1)]
        padding = SpherePad() if on_sphere else nn.ZeroPad2d(1)
        self.start = nn.Linear(latent_size, widths[0] * 16)
        self.blocks = nn.Sequential(*(ResidualUpsample(*sizes, padding) for sizes in pairwise(widths)))
        self.output = nn.Sequential(BatchNorm2d(widths[-1]), nn.ReLU(), padding, nn.Conv2d(widths[-1], out_channels, 3))
        _initialise(self)

    def forward(self, latent: Float[Tensor, "B K"]) -> Float[Tensor, "B C T T"]:
        """Return unnormalised channel values."""
        return self.output(self.blocks(self.start(latent).unflatten(1, (-1, 4, 4))))


class TextureGenerator(nn.Module):
    """Map a latent vector to an RGB texture map in [0, 1] without a limit on its colours (paper 3.2)."""

    def __init__(self, latent_size: int, hidden_channels: int, size: int, mirror: bool) -> None:
        super().__init__()
        self.mirror = mirror
        self.image = ImageGenerator(latent_size, hidden_channels, 3, size, on_sphere=True)

    def forward(self, latent: Float[Tensor, "B K"]) -> Float[Tensor, "B 3 T T"]:
        """Return texture maps; with `mirror`, left and right of the object look the same."""
        return torch.sigmoid(_mirrored(self.image(latent), self.mirror))


class PaletteTextureGenerator(nn.Module):
    """Map a latent vector to a texture map mixed from a palette of a few colours (paper 3.1.2).

    A softmax over channels weighs the palette's colours at every texel. The palette comes from a second network.
    """

    def __init__(self, latent_size: int, hidden_channels: int, size: int, colors: int, mirror: bool) -> None:
        super().__init__()
        self.mirror = mirror
        self.weights = ImageGenerator(latent_size, hidden_channels, colors, size, on_sphere=True)
        self.palette = nn.Sequential(
            nn.Linear(latent_size, 128), nn.ReLU(), nn.Linear(128, 128), nn.ReLU(), nn.Linear(128, colors * 3)
        )
        _initialise(self.palette)

    def forward(self, latent: Float[Tensor, "B K"]) -> Float[Tensor, "B 3 T T"]:
        """Return texture maps in [0, 1]."""
        weights = torch.softmax(_mirrored(self.weights(latent), self.mirror), dim=1)
        palette = torch.sigmoid(self.palette(latent)).unflatten(1, (-1, 3))
        return torch.einsum("bchw,bcd->bdhw", weights, palette)


class LinearUpsample(nn.Module):
    """Stretch rows of values by linear interpolation.

    As pictures of one row a channel: PyTorch's kernel for rows keeps a few dozen threads of a GPU busy.
    """

    def __init__(self, size: int) -> None:
        super().__init__()
        self.size = size

    def forward(self, rows: Float[Tensor, "B C length"]) -> Float[Tensor, "B C size"]:
        """Return rows of `size` values."""
        size = (rows.shape[1], self.size)
        return functional.interpolate(rows[:, None], size, mode="bilinear").squeeze(1)


class StripesGenerator(nn.Module):
    """Map a latent vector to a background of horizontal stripes (paper 3.1.4)."""

    def __init__(self, latent_size: int, hidden_size: int, size: int) -> None:
        super().__init__()
        self.size = size
        self.start = nn.Linear(latent_size, hidden_size * 8)
        self.layers = nn.Sequential(
            nn.ReLU(),
            LinearUpsample(size // 2),
            nn.Conv1d(hidden_size, hidden_size, 3, padding=1, padding_mode="replicate"),
            nn.ReLU(),
            LinearUpsample(size),
            nn.Conv1d(hidden_size, 3, 3, padding=1, padding_mode="replicate"),
        )
        _initialise(self)

    def forward(self, latent: Float[Tensor, "B K"]) -> Float[Tensor, "B 3 H W"]:
        """Return images in [0, 1] that are constant along every row."""
        rows = torch.sigmoid(self.layers(self.start(latent).unflatten(1, (-1, 8))))
        return rows[..., None].expand(-1, -1, -1, self.size)


class ImageBackgroundGenerator(nn.Module):
    """Map a latent vector to an unconstrained background (the ablations of paper Fig. 5e and 7d)."""

    def __init__(self, latent_size: int, hidden_channels: int, size: int) -> None:
        super().__init__()
        self.image = ImageGenerator(latent_size, hidden_channels, 3, size, on_sphere=False)

    def forward(self, latent: Float[Tensor, "B K"]) -> Float[Tensor, "B 3 H W"]:
        """Return images in [0, 1]."""
        return torch.sigmoid(self.image(latent))


def _initialise(network: nn.Module) -> None:
    """Initialise for outputs of unit order; PyTorch's default makes a tenth of that, every picture the same grey."""
    for module in network.modules():
        if isinstance(module, nn.Linear | nn.Conv1d | nn.Conv2d):
            nn.init.kaiming_normal_(module.weight, nonlinearity="relu")


def _mirrored(maps: Float[Tensor, "B C T T"], mirror: bool) -> Float[Tensor, "B C T T"]:
    return (maps + maps.flip(-1)) / 2 if mirror else maps
