"""First poses from renderings of the base shape."""

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from pipeline.seeding import generator
from pipeline.training import first_poses as first_poses_module
from pipeline.training.azimuths import ConsensusConfig, join_votes
from pipeline.training.boxes import cut_to_box
from pipeline.training.first_poses import (
    FirstPosesConfig,
    _compare,
    _rendered_poses,
    count_votes,
    first_poses,
)
from pipeline.training.reading import read_all_poses
from pipeline.training.warm_up import warm_up
from tests.tiny_full_model import (
    TRAINING,
    photographs,
    photographs_of,
    scramble_paint,
    tiny_extractor,
    tiny_model,
    tiny_scenes,
)

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
    rounded = 20 + torch.rand(1, 16).expand(7, 16)  # the mean of seven is not exact
    torch.testing.assert_close(count_votes(rounded, 0.3), torch.full((7, 16), 1 / 16), rtol=0.1, atol=0)


def test_an_azimuth_without_renderings_gets_no_votes() -> None:
    model, scenes, extractor = tiny_model(), tiny_scenes(), tiny_extractor()
    images, _ = photographs(8)
    sparse = replace(CONFIG, renderings=2, concentration=1000.0)
    poses = first_poses(model, scenes, extractor, images, sparse, TRAINING.warm_up.light, generator(0))
    assert poses.isfinite().all()


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
    torch.testing.assert_close(poses[:, 4:], read_all_poses(model, images)[:, 4:])
    assert poses[:, 3].abs().max() <= 0.35


def test_elevation_and_roll_are_those_of_renderings_near_the_azimuth(monkeypatch: pytest.MonkeyPatch) -> None:
    model, (images, _), scenes = tiny_model(), photographs(12), tiny_scenes()
    scenes = scenes._replace(generators=scenes.generators[:1])
    turns = torch.arange(72) * (2 * math.pi / 72)
    high_in_front = torch.stack([turns.cos(), turns.sin(), 0.8 * turns.cos(), 0.8 * turns.sin()], 1)
    monkeypatch.setattr(model.poses, "draw", lambda *_: torch.cat([high_in_front, torch.zeros(72, 3)], 1))
    consensus = replace(CONFIG.consensus, rounds=0)
    config = replace(CONFIG, renderings=72, pose_reach=1.0, concentration=80.0, consensus=consensus)
    found = first_poses(model, scenes, tiny_extractor(), images, config, TRAINING.warm_up.light, generator(1))
    torch.testing.assert_close(found[:, 2:4], 0.8 * found[:, :2], atol=0.15, rtol=0)


def test_boxes_of_renderings_err_as_those_of_photographs_do(monkeypatch: pytest.MonkeyPatch) -> None:
    model, scenes, (images, _) = tiny_model(), tiny_scenes(), photographs(12)
    cuts: list[Tensor] = []
    monkeypatch.setattr(first_poses_module, "cut_to_box", lambda *given: (cuts.append(given[2]), cut_to_box(*given))[1])
    consensus = replace(CONFIG.consensus, rounds=0)
    for box_jitter in (0.0, 0.3):
        config = replace(CONFIG, renderings=64, box_jitter=box_jitter, consensus=consensus)
        first_poses(model, scenes, tiny_extractor(), images, config, TRAINING.warm_up.light, generator(1))
    _, right, _, _, wrong, _ = cuts  # of the photographs, then of the renderings of both generators
    assert torch.equal(wrong[:, :4], right[:, :4])
    assert (wrong - right)[:, 4:].std().item() == pytest.approx(0.3, rel=0.15)


def test_what_an_extractor_sees_in_the_mirror_alone_counts_too(monkeypatch: pytest.MonkeyPatch) -> None:
    extractor, images = tiny_extractor(), photographs(12)[0] / 255
    look, seen = extractor.forward, torch.arange(32) >= 16
    monkeypatch.setattr(extractor, "forward", lambda pictures: look(pictures * seen))
    photographed, rendered = images.split(6)
    inverted_on_the_left = torch.where(seen, photographed, 1 - photographed)
    before, after = (_compare(cuts, [rendered], extractor)[0] for cuts in (photographed, inverted_on_the_left))
    assert (after - before).abs().mean() > 0.05 * before.std()


def test_colours_and_edges_have_no_vote(monkeypatch: pytest.MonkeyPatch) -> None:
    extractor, (photographed, rendered) = tiny_extractor(), (photographs(12)[0] / 255).split(6)
    before = _compare(photographed, [rendered], extractor)[0]
    scramble_paint(extractor, monkeypatch)
    torch.testing.assert_close(_compare(photographed, [rendered], extractor)[0], before)


def test_elevations_are_those_that_the_chosen_base_shapes_renderings_vote_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    model, (images, _), turns = tiny_model(), photographs(12), torch.arange(72) // 2 * (2 * math.pi / 36)
    high = torch.arange(72) % 2 == 0
    rows = torch.stack([turns.cos(), turns.sin(), torch.where(high, 0.5, -0.5)], 1)
    monkeypatch.setattr(model.poses, "draw", lambda *_: torch.cat([rows, torch.zeros(72, 4)], 1))
    votes = iter([(2 + turns.cos()) * high, (2 + turns.cos()) * ~high])
    monkeypatch.setattr(first_poses_module, "count_votes", lambda distances, _: next(votes).expand_as(distances))
    config = replace(CONFIG, renderings=72, consensus=replace(CONFIG.consensus, rounds=0))
    found = first_poses(model, tiny_scenes(), tiny_extractor(), images, config, TRAINING.warm_up.light, generator(1))
    torch.testing.assert_close(found[:, 2], torch.full((12,), 0.5))


def test_a_side_that_is_rendered_more_often_gets_no_more_votes(monkeypatch: pytest.MonkeyPatch) -> None:
    model, (images, _), joined = tiny_model(), photographs(12), list[Tensor]()
    turns = torch.cat([torch.zeros(400), torch.arange(72) * (2 * math.pi / 72)])
    rows = torch.cat([torch.stack([turns.cos(), turns.sin()], 1), torch.zeros(472, 5)], 1)
    monkeypatch.setattr(model.poses, "draw", lambda *_: rows)
    for_the_rear = (-turns.cos()).exp()
    monkeypatch.setattr(first_poses_module, "count_votes", lambda distances, _: for_the_rear.expand_as(distances))
    monkeypatch.setattr(first_poses_module, "join_votes", lambda votes: (joined.append(votes), join_votes(votes))[1])
    config = replace(CONFIG, renderings=472, consensus=replace(CONFIG.consensus, rounds=0))
    first_poses(model, tiny_scenes(), tiny_extractor(), images, config, TRAINING.warm_up.light, generator(1))
    assert joined[0].argmax(dim=2).unique().tolist() == [36]
