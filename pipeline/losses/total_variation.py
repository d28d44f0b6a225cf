"""Total variation of texture maps."""

from jaxtyping import Float
from torch import Tensor


def total_variation(texture_maps: Float[Tensor, "B 3 T T"]) -> Float[Tensor, ""]:
    """Return the mean absolute difference between neighbouring texels (paper section 3.2.3, term 3).

    The maps are equirectangular, so the last column is the first one's neighbour; rows do not wrap. Zero for a map of
    one colour. Gradients flow to the maps.
    """
    horizontal = (texture_maps - texture_maps.roll(1, dims=-1)).abs().mean()
    vertical = (texture_maps[..., 1:, :] - texture_maps[..., :-1, :]).abs().mean()
    return horizontal + vertical
