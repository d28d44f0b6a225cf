"""First poses from renderings of the base shape."""

import math
from dataclasses import replace

import torch

from pipeline.networks.pose_coordinates import PoseRange
from pipeline.seeding import generator
from pipeline.training.first_poses import FirstPosesConfig, count_votes, cut_to_box, estimate_boxes, first_poses
from pipeline.training.warm_up import draw_sample
from tests.tiny_full_model import TRAINING, photographs, tiny_extractor, tiny_model, tiny_scenes


def test_votes_follow_the_nearest_and_forgive_hubs() -> None:
    turns = torch.arange(16) * (2 * math.pi / 16)
    truth = torch.tensor([0.4, 2.0, 4.0])
    hub = torch.zeros(16).index_fill(0, torch.tensor([9]), -5.0)
    votes = count_votes(-torch.cos(truth[:, None] - turns) + hub, 0.3)
    torch.testing.assert_close(votes.sum(dim=1), torch.ones(3))
    directions = votes @ torch.stack([turns.cos(), turns.sin()], 1)
    expected = torch.stack([truth.cos(), truth.sin()], 1)
    assert torch.cosine_similarity(directions, expected).min() > math.cos(0.3)


def test_objects_are_cut_to_the_middle_at_one_size() -> None:
    model = tiny_model()
    images, coordinates = photographs(100)
    center, extent = model.poses.box(coordinates)
    inside = extent / 0.8 + center.abs().amax(dim=1) < 1
    assert inside.sum() >= 4
    cuts = cut_to_box(images[inside].float() / 255, model.poses, coordinates[inside], 0.8)
    objects = (cuts - 0.8).abs().amax(dim=1) > 0.1
    for covered in objects:
        rows, columns = covered.any(dim=1).nonzero()[:, 0], covered.any(dim=0).nonzero()[:, 0]
        height, width = rows.max() - rows.min() + 1, columns.max() - columns.min() + 1
        assert abs(max(height, width) - 0.8 * 32) <= 2.5
        assert abs(rows.max() + rows.min() - 31) <= 2.5
        assert abs(columns.max() + columns.min() - 31) <= 2.5
