"""Search for the best pose and shape of each training photograph (paper sections 3.2.1 and 3.2.2)."""

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

from pipeline.errors import ConfigError
from pipeline.losses.image_distance import Features, feature_distance
from pipeline.networks.feature_extractor import FeatureExtractor
from pipeline.networks.full_model import FullModel, Reconstruction
from pipeline.training.candidates import Estimate, ExplorationConfig, Record, candidates, within_reach

_BEYOND_REACH = 1e4
"""Added to the distances of candidates that may not win: above any distance, so that they come last, in their order."""


class Best(NamedTuple):
    """The candidates nearest to the photographs; gradients flow to the networks whose own estimate won."""

    record: Record
    head: Int[Tensor, " B"]
    """The ensemble's best head."""


def explore(
    model: FullModel,
    extractor: FeatureExtractor,
    targets: Features,
    estimate: Estimate,
    record: Record,
    config: ExplorationConfig,
    rng: torch.Generator,
) -> Best:
    """Find the candidate nearest to each photograph; `targets` are their features."""
    poses, shapes, heads = candidates(model, estimate, record, config, rng)
    losses = score(model, extractor, targets, estimate, poses, shapes, config.map_weights)
    far = ~within_reach(poses, record.pose, config.azimuth_reach)
    ranked = losses.double() + _BEYOND_REACH * far  # in float32 the large number would round their order away
    winner = ranked.argmin(dim=0)
    photograph = torch.arange(len(winner), device=winner.device)
    head = ranked[heads].argmin(dim=0)
    return Best(Record(poses[winner, photograph], shapes[winner, photograph]), head)


@torch.no_grad()
def score(
    model: FullModel,
    extractor: FeatureExtractor,
    targets: Features,
    estimate: Estimate,
    poses: Float[Tensor, "candidates B 7"],
    shapes: Float[Tensor, "candidates B K"],
    map_weights: tuple[float, ...],
) -> Float[Tensor, "candidates B"]:
    """Return every candidate's distance from the targets; all are rendered in one batch.

    Textures and backgrounds are the estimated ones.
    """
    count = len(poses)
    vertices = model.shapes(shapes.flatten(0, 1))
    reconstructions = Reconstruction(
        vertices,
        estimate.texture_maps.repeat(count, 1, 1, 1),
        model.poses(poses.flatten(0, 1), vertices),
        estimate.backgrounds.repeat(count, 1, 1, 1),
    )
    features = extractor(model.render(reconstructions), len(map_weights))
    return distances(targets, features, count, map_weights)


def distances(
    targets: Features, features: Features, count: int, map_weights: tuple[float, ...]
) -> Float[Tensor, "candidates B"]:
    """Return the distances of `count` candidates' features, one batch after the other, from the targets'."""
    targets, features = comparable(targets, map_weights), comparable(features, map_weights)
    of_candidates = zip(*(layer.chunk(count) for layer in features), strict=True)
    return torch.stack([feature_distance(targets, list(candidate)) for candidate in of_candidates])


def comparable(features: Features, map_weights: tuple[float, ...]) -> list[Float[Tensor, "B _ _ _"]]:
    """Prepare features for the comparison of candidates: the weighted pictures, then weighted maps of unit vectors.

    Poses show in what a feature is and where, not in how strong it is, and little in the deepest map: a network that
    names things learns to ignore them. Maps beyond the last weight are left out.
    """
    pictures, *maps = features[: len(map_weights)]
    directions = [functional.normalize(layer, dim=1) for layer in maps]
    return [weight * layer for weight, layer in zip(map_weights, [pictures, *directions], strict=True)]


def require_maps(map_weights: tuple[float, ...], extractor: FeatureExtractor, key: str) -> None:
    """Raise ConfigError, naming the parameter, where no map is weighted or more than the extractor has."""
    if not any(map_weights) or len(map_weights) > extractor.maps:
        raise ConfigError(
            f"{key} is {list(map_weights)}, but the features are {extractor.maps} maps, the pictures themselves "
            "included; give one weight a map, from the first on, and not all of them 0"
        )
