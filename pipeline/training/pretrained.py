"""Take over a network that others trained (paper section 4.2: AlexNet on ImageNet)."""

from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.datasets.images import Images
from pipeline.errors import DataError
from pipeline.losses.image_distance import feature_distance
from pipeline.networks.feature_extractor import FeatureExtractor
from pipeline.networks.pretrained import PretrainedNetwork, read_pretrained
from pipeline.seeding import generator

_PICTURES = 512
"""Photographs, at most, whose distances, each from another one, are averaged: eight passes of `_BATCH`."""
_BATCH = 64


def adopt(path: Path, images: Images, distance: float, seed: int) -> PretrainedNetwork:
    """Read a network's weights and scale its maps, on the images' device.

    Two photographs drawn at random are then `distance` apart on average, of which each map has an equal share: networks
    differ by orders of magnitude in the size of their features, weights of losses need not. Raises DataError for a
    single photograph, and where the file holds no network that is known, or one whose maps tell no photographs apart.
    """
    if len(images) < 2:
        raise DataError("a given network is scaled by distances of photographs, but there is only one; add more")
    network = read_pretrained(path).to(images.device)
    scale = distance / network.maps / mean_distances(network, images, seed)
    for number, finite in enumerate(scale.half().isfinite().tolist()):  # as which it is stored
        if not finite:
            raise DataError(
                f"{path}: photographs do not differ, or by no number, in feature map {number} of {network.maps}; give "
                "weights that are trained and whole"
            )
    network.scale.copy_(scale)
    return network


@torch.no_grad()
def mean_distances(network: PretrainedNetwork, images: Images, seed: int) -> Float[Tensor, " maps"]:
    """Return how far pairs of photographs, drawn at random, are apart in each map (eq. 2)."""
    extractor = FeatureExtractor(network, color_weight=0.0)
    order = torch.randperm(len(images), generator=generator(seed, "features", "pairs"))[:_PICTURES]
    distances = []
    for index in order.to(images.device).tensor_split(-(-len(order) // _BATCH)):
        _, *maps = extractor(images[index].float() / 255)
        distances.append(torch.stack([feature_distance([layer], [layer.roll(1, dims=0)]) for layer in maps], dim=1))
    return torch.cat(distances).mean(dim=0)
