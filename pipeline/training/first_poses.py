"""First poses of photographs, before full training (ours).

The best pose of a photograph cannot be found by rendering while its texture is unknown. But base-shape learning leaves
generators of such textures, one a seed: a photograph resembles renderings from its own side more than others, whatever
their paint. Photographs and renderings are cut to the object's box, and renderings vote for their azimuths on the
photographs that resemble them. Renderings that resemble every photograph say nothing, so each one's mean distance is
taken off first. `azimuths` then joins the votes of all generators and makes them consistent.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, UInt8
from torch import Tensor
from torch.nn import functional
from tqdm import tqdm

from pipeline.distributed import divide, silent, world
from pipeline.losses.image_distance import Features, pairwise_feature_distance
from pipeline.networks.feature_extractor import FeatureExtractor, extract
from pipeline.networks.full_model import FullModel
from pipeline.networks.scene_generator import LearnedScenes, SceneGenerator
from pipeline.ranges import Concentration, Fraction, NonNegative, Positive, Several
from pipeline.rendering.renderer import Mesh, render
from pipeline.training.azimuths import ConsensusConfig, agree_on_azimuths, bins, join_votes
from pipeline.training.boxes import cut_to_box
from pipeline.training.reading import read_all_poses
from pipeline.training.viewpoints import LightConfig, sample_lights

_CHUNK = 250
_FINEST_MAP = 16
"""Positions a side at which pictures are compared; finer ones take memory and agree no better."""
_SMALLEST = torch.finfo(torch.float32).tiny
"""Keeps votes finite where no rendering is near an azimuth."""
_ALIKE = 1e-5
"""Part of the mean distance: where a photograph's distances deviate by less, it is rounding that does."""


@dataclass(frozen=True)
class FirstPosesConfig:
    """Settings of the first poses."""

    renderings: Several
    """How many of each generator's renderings a photograph is compared with."""
    pose_reach: Fraction
    """Part of the ranges of roll and box that they cover: few photographs are at the ends."""
    box_jitter: NonNegative
    """Standard deviation of errors put on their boxes, in pose coordinates: photographs' are estimates."""
    box_size: Positive
    """Longer side of the box over the side of a cut picture."""
    temperature: Positive
    """Of the vote, in standard deviations of a photograph's distances; small ones let the nearest decide."""
    concentration: Concentration
    """Of the votes' kernel over azimuths (von Mises); 20 is about 13 degrees wide."""
    consensus: ConsensusConfig
    photographs: Several
    """How many get first poses, from the first on: each is compared with every rendering at once."""


@torch.no_grad()
def first_poses(
    model: FullModel,
    scenes: LearnedScenes,
    extractor: FeatureExtractor,
    photographs: UInt8[Tensor, "N 3 H W"],
    config: FirstPosesConfig,
    light: LightConfig,
    rng: torch.Generator,
) -> Float[Tensor, "N 7"]:
    """Return pose coordinates of photographs of mirror-symmetric objects.

    Where the objects are is what the model's student, warmed up on renderings, says; elevation and roll are those of
    the chosen generator's renderings that vote for the azimuth.
    """
    estimated = read_all_poses(model, photographs)
    cuts = cut_to_box(
        photographs.float() / 255, model.poses, estimated, config.box_size, torch.zeros_like(estimated[:, 0])
    )
    poses = _rendered_poses(model, config, rng)
    kernel = _kernel(poses, config.concentration)
    rendered = [_cut_renderings(model, scenes, one, poses, config, light, rng) for one in scenes.generators]
    votes = [count_votes(one, config.temperature) for one in _compare(cuts, rendered, extractor)]
    renderings = kernel.sum(dim=0).clamp_min(_SMALLEST)
    by_azimuth = join_votes(torch.stack([((vote @ kernel) / renderings).clamp_min(_SMALLEST).log() for vote in votes]))
    winner = agree_on_azimuths(by_azimuth, cuts, extractor, config.consensus, rng).argmax(dim=1)
    near = votes[0] * kernel.T[winner]
    elevation_and_roll = (near @ poses[:, 2:4]) / near.sum(dim=1, keepdim=True).clamp_min(_SMALLEST)
    azimuth = bins(poses.device)[winner, None]
    return torch.cat([azimuth.cos(), azimuth.sin(), elevation_and_roll, estimated[:, 4:]], 1)


def count_votes(distances: Float[Tensor, "N K"], temperature: float) -> Float[Tensor, "N K"]:
    """Return how much each rendering counts for each photograph; a photograph's votes add up to 1."""
    least = (_ALIKE * distances.abs().mean()).clamp_min(_SMALLEST)
    distances = distances - distances.mean(dim=0)
    deviations = distances - distances.mean(dim=1, keepdim=True)
    distances = deviations / distances.std(dim=1, keepdim=True).clamp_min(least)
    return (-distances / temperature).softmax(dim=1)


def _rendered_poses(model: FullModel, config: FirstPosesConfig, rng: torch.Generator) -> Float[Tensor, "K 7"]:
    poses = model.poses.draw(config.renderings, rng)
    poses[:, 3:] *= config.pose_reach
    return poses


def _cut_renderings(
    model: FullModel,
    scenes: LearnedScenes,
    generator: SceneGenerator,
    poses: Float[Tensor, "K 7"],
    config: FirstPosesConfig,
    light: LightConfig,
    rng: torch.Generator,
) -> Float[Tensor, "K 3 H W"]:
    """Render a generator's objects, cut to boxes that are as wrong as those of photographs."""
    batches = []
    for pose in poses.split(_CHUNK):
        scene = generator(generator.sample_noise(len(pose), rng))
        mesh = Mesh(scene.vertices, scenes.faces, scenes.directions)
        placed, lights = model.poses(pose, scene.vertices), sample_lights(light, len(pose), rng)
        renderer = model.config.renderer
        batches.append(render(mesh, scene.texture_maps, placed, scene.backgrounds, lights, renderer).images)
    error = config.box_jitter * torch.randn(len(poses), 3, generator=rng, device=rng.device)
    boxes = torch.cat([poses[:, :4], poses[:, 4:] + error], 1)
    return cut_to_box(torch.cat(batches), model.poses, boxes, config.box_size, torch.zeros_like(boxes[:, 0]))


def _compare(
    cuts: Float[Tensor, "N 3 H W"], rendered: list[Float[Tensor, "K 3 H W"]], extractor: FeatureExtractor
) -> tuple[Float[Tensor, "N K"], ...]:
    """Return the distances of photographs from each generator's renderings; processes divide the renderings."""
    described = _describe(cuts, extractor)
    parts = [part for images in rendered for part in images.chunk(world().size)]

    def distances(index: int) -> Float[Tensor, "N K"]:
        return _distances(described, _describe(parts[index], extractor)).cpu()

    joined = torch.cat([part.to(cuts.device) for part in divide(distances, len(parts))], dim=1)
    return joined.chunk(len(rendered), dim=1)


def _describe(images: Float[Tensor, "N 3 H W"], extractor: FeatureExtractor) -> Sequence[Features]:
    """Return directions of deep features, of pictures and of their mirror images.

    The feature vectors of all maps but the first have length 1: colours and edges are paint.
    """

    def directions(batch: Float[Tensor, "B 3 H W"]) -> Features:
        layers = [layer.float() for layer in extractor(batch)[2:]]
        coarse = [functional.adaptive_avg_pool2d(layer, min(layer.shape[-1], _FINEST_MAP)) for layer in layers]
        return [functional.normalize(layer, dim=1) for layer in coarse]

    return [extract(directions, shown, _CHUNK) for shown in (images, images.flip(-1))]


def _distances(photographs: Sequence[Features], rendered: Sequence[Features]) -> Float[Tensor, "N K"]:
    """Compare photographs with renderings, and their mirror images with each other."""
    count = len(photographs[0][0])
    total = torch.zeros(count, len(rendered[0][0]), device=photographs[0][0].device)
    for ours, theirs in tqdm(zip(photographs, rendered, strict=True), "votes", len(rendered), disable=silent()):
        for start in range(0, count, _CHUNK):
            rows = slice(start, start + _CHUNK)
            total[rows] += pairwise_feature_distance([layer[rows] for layer in ours], theirs)
    return total


def _kernel(poses: Float[Tensor, "K 7"], concentration: float) -> Float[Tensor, "K azimuths"]:
    turns = bins(poses.device)
    return ((poses[:, :2] @ torch.stack([turns.cos(), turns.sin()]) - 1) * concentration).exp()
