"""Match photographs with renderings of the base shape, for first poses before full training (ours).

The best pose of a photograph cannot be found by rendering while its texture is unknown. But base-shape learning leaves
a generator of such textures: a photograph resembles renderings from its own side more than others, whatever their
paint. Renderings that resemble every photograph say nothing, so each one's mean distance is taken off first.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import normalize

from pipeline.losses.image_distance import Features, pairwise_feature_distance
from pipeline.networks.full_model import FullModel
from pipeline.networks.scene_generator import SceneGenerator
from pipeline.networks.wide_resnet import FeatureExtractor, extract
from pipeline.training.warm_up import WarmUpConfig, draw_sample

_AZIMUTHS = 72
_CHUNK = 250


@dataclass(frozen=True)
class MatchingConfig:
    """Settings of the matching.

    Attributes:
        renderings: how many renderings each photograph is compared with, in batches of the warm-up's size.
        temperature: of the vote, in standard deviations of a photograph's distances; small ones let the nearest decide.
        concentration: of the kernel over azimuths (von Mises); 20 is about 13 degrees wide.
    """

    renderings: int
    temperature: float
    concentration: float


def match_poses(
    model: FullModel,
    scenes: SceneGenerator,
    extractor: FeatureExtractor,
    photographs: Features,
    config: MatchingConfig,
    warm_up: WarmUpConfig,
    rng: torch.Generator,
) -> Float[Tensor, "N 7"]:
    """Return the pose coordinates of photographs, given by their features, by a vote of renderings that resemble them.

    The azimuth has the most votes for its share of the renderings; the other coordinates are means over the renderings
    near that azimuth, weighted by their votes.
    """
    batches = [draw_sample(model, scenes, warm_up, rng) for _ in range(config.renderings // warm_up.batch_size)]
    poses = torch.cat([batch.pose for batch in batches])
    rendered = extract(extractor, torch.cat([batch.images for batch in batches]), warm_up.batch_size)
    distances = torch.cat(
        [
            pairwise_feature_distance(
                _directions([layer[i : i + _CHUNK] for layer in photographs]), _directions(rendered)
            )
            for i in range(0, len(photographs[0]), _CHUNK)
        ]
    )
    return vote(distances, poses, config)


def vote(distances: Float[Tensor, "N K"], poses: Float[Tensor, "K 7"], config: MatchingConfig) -> Float[Tensor, "N 7"]:
    """Return the poses that the renderings nearest to each photograph agree on."""
    distances = distances - distances.mean(dim=0)
    distances = (distances - distances.mean(dim=1, keepdim=True)) / distances.std(dim=1, keepdim=True)
    votes = (-distances / config.temperature).softmax(dim=1)
    turns = torch.arange(_AZIMUTHS, device=poses.device) * (2 * math.pi / _AZIMUTHS)
    turns = torch.stack([turns.cos(), turns.sin()], dim=1)
    kernel = ((poses[:, :2] @ turns.T - 1) * config.concentration).exp()
    winner = ((votes @ kernel) / kernel.sum(dim=0)).argmax(dim=1)
    near = votes * kernel.T[winner]
    others = (near @ poses[:, 2:]) / near.sum(dim=1, keepdim=True)
    return torch.cat([turns[winner], others], dim=1)


def _directions(features: Features) -> list[Float[Tensor, "B _ _ _"]]:
    """Scale the network's feature vectors to length 1 and leave the colours out: paint must not count."""
    _, *layers = features
    return [normalize(layer.float(), dim=1) for layer in layers]
