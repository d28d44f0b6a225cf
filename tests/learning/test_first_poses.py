"""First poses from renderings of the base shape."""

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from pipeline.seeding import generator
from pipeline.training.azimuths import ConsensusConfig
from pipeline.training.first_poses import (
    FirstPosesConfig,
    _rendered_poses,
    count_votes,
    cut_to_box,
    first_poses,
    read_poses,
)
from pipeline.training.warm_up import warm_up
from tests.tiny_full_model import TRAINING, photographs, photographs_of, tiny_extractor, tiny_model, tiny_scenes

CONFIG = FirstPosesConfig(
    renderings=512,
    pose_reach=0.35,
    box_jitter=0.15,
    box_size=0.85,
    temperature=1.0,
    concentration=20.0,
    consensus=ConsensusConfig(3, 0.4, 64, 0.3, 0.3, 5, 3.0),
    photographs=300,
)


def test_votes_follow_the_nearest_and_forgive_hubs() -> None:
    turns = torch.arange(16) * (2 * math.pi / 16)
    truth = torch.tensor([0.4, 2.0, 4.0])
    hub = torch.zeros(16).index_fill(0, torch.tensor([9]), -5.0)
    votes = count_votes(-torch.cos(truth[:, None] - turns) + hub, 0.3)
    torch.testing.assert_close(votes.sum(dim=1), torch.ones(3))
    directions = votes @ torch.stack([turns.cos(), turns.sin()], 1)
    expected = torch.stack([truth.cos(), truth.sin()], 1)
    assert torch.cosine_similarity(directions, expected).min() > math.cos(0.3)


def test_photographs_that_are_all_alike_vote_for_nothing() -> None:
    votes = count_votes(torch.tensor([[3.0, 5.0, 4.0]]).expand(6, 3), 0.3)
    torch.testing.assert_close(votes, torch.full((6, 3), 1 / 3))


def test_objects_are_cut_to_the_middle_at_one_size() -> None:
    model = tiny_model()
    _, coordinates = photographs(8)
    coordinates[:, 6] = -1.0
    cuts = cut_to_box(photographs_of(coordinates).float() / 255, model.poses, coordinates, 0.9, torch.zeros(8))
    for covered in (cuts - 0.8).abs().amax(dim=1) > 0.1:
        rows, columns = covered.any(dim=1).nonzero()[:, 0], covered.any(dim=0).nonzero()[:, 0]
        height, width = rows.max() - rows.min() + 1, columns.max() - columns.min() + 1
        assert abs(max(height, width) - 0.9 * 32) <= 2.5
        assert abs(rows.max() + rows.min() - 31) <= 2.5
        assert abs(columns.max() + columns.min() - 31) <= 2.5


@pytest.mark.slow
def test_votes_find_the_axis_and_their_consensus_the_front() -> None:
    model, scenes, extractor = tiny_model(), tiny_scenes(), tiny_extractor()
    images, coordinates = photographs(300)
    warm_up_config = replace(TRAINING.warm_up, iterations=100, batch_size=16, learning_rate=3e-3)
    warm_up(model, scenes.generators[0], warm_up_config, generator(0))

    def cosines(rounds: int) -> Tensor:
        config = replace(CONFIG, consensus=replace(CONFIG.consensus, rounds=rounds))
        poses = first_poses(model, scenes, extractor, images, config, warm_up_config.light, generator(1))
        assert poses.shape == coordinates.shape
        return (poses[:, :2] * coordinates[:, :2]).sum(dim=1)

    votes, consensus = cosines(0), cosines(3)
    within_30_degrees = math.cos(math.pi / 6)
    assert (consensus.abs() > within_30_degrees).float().mean() > 0.75  # chance: 1/3
    assert (consensus > within_30_degrees).float().mean() > 0.45  # chance: 1/6
    assert (consensus > within_30_degrees).float().mean() > (votes > within_30_degrees).float().mean()


@pytest.mark.parametrize("reach", [1.0, 0.35])
def test_renderings_cover_the_elevations_and_as_much_of_the_rest_as_asked(reach: float) -> None:
    poses = _rendered_poses(tiny_model(), replace(CONFIG, pose_reach=reach), generator(0))
    assert 0.95 * reach < poses[:, 3:].abs().max() <= reach
    assert poses[:, 2].abs().max() > 0.95


def test_boxes_stay_as_the_networks_read_them() -> None:
    model, scenes, (images, _) = tiny_model(), tiny_scenes(), photographs(24)
    config = replace(CONFIG, renderings=64, consensus=replace(CONFIG.consensus, components=4))
    poses = first_poses(model, scenes, tiny_extractor(), images, config, TRAINING.warm_up.light, generator(1))
    torch.testing.assert_close(poses[:, 4:], read_poses(model, images)[:, 4:])
    assert poses[:, 3].abs().max() <= 0.35
