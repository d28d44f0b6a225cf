"""First poses by matching photographs with renderings."""

import math
from dataclasses import replace

import torch

from pipeline.networks.wide_resnet import extract
from pipeline.seeding import generator
from pipeline.training.matching import MatchingConfig, match_poses, vote
from pipeline.training.warm_up import draw_sample
from tests.tiny_full_model import TRAINING, tiny_extractor, tiny_model, tiny_scenes

CONFIG = MatchingConfig(renderings=1024, temperature=0.3, concentration=20.0)


def test_renderings_are_matched_with_renderings_from_their_side() -> None:
    model, scenes, extractor = tiny_model(), tiny_scenes(), tiny_extractor()
    clean = replace(TRAINING.warm_up, batch_size=64, noise=0.0, shape_spread=0.0)
    sample = draw_sample(model, scenes, clean, generator(1))
    photographs = extract(extractor, sample.images, 4)
    poses = match_poses(model, scenes, extractor, photographs, CONFIG, clean, generator(2))
    assert poses.shape == sample.pose.shape
    within_45_degrees = (poses[:, :2] * sample.pose[:, :2]).sum(1) > math.cos(math.pi / 4)
    assert within_45_degrees.float().mean() > 0.35  # chance: 0.25


def test_the_vote_follows_the_nearest_and_forgives_hubs() -> None:
    turns = torch.arange(16) * (2 * math.pi / 16)
    poses = torch.cat([turns.cos()[:, None], turns.sin()[:, None], torch.linspace(-1, 1, 80).view(16, 5)], 1)
    truth = torch.tensor([0.4, 2.0, 4.0])
    hub = torch.zeros(16).index_fill(0, torch.tensor([9]), -5.0)
    distances = -torch.cos(truth[:, None] - turns) + hub
    azimuth = vote(distances, poses, CONFIG)[:, :2]
    expected = torch.stack([truth.cos(), truth.sin()], 1)
    assert (azimuth * expected).sum(1).min() > math.cos(0.3)
