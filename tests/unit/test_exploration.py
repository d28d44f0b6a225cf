"""Candidates for the best pose and shape."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from pipeline.errors import ConfigError
from pipeline.losses.image_distance import Features, feature_distance
from pipeline.networks.feature_extractor import FeatureExtractor, extract
from pipeline.networks.full_model import FullModel, Reconstruction
from pipeline.seeding import generator
from pipeline.training.candidates import (
    Estimate,
    Record,
    ShapeSearchConfig,
    candidates,
    first_record,
    refining,
    within_reach,
)
from pipeline.training.exploration import comparable, explore, score
from tests.tiny_full_model import TRAINING, exact_regression, photographs, tiny_extractor, tiny_model

CONFIG = TRAINING.exploration


def estimate_of(model: FullModel, count: int) -> Estimate:
    with torch.no_grad():
        images = torch.rand(count, 3, 32, 32, generator=generator(5))
        code = model.pose_encoder(images)
        return Estimate(
            model.pose_decoder(code),
            model.pose_decoder.ensemble(code),
            model.pose_decoder(model.pose_encoder(images.flip(-1))),
            model.read_shapes(images, tiny_extractor()(images)),
            model.texture_decoder(model.texture_encoder(images)),
            model.background_decoder(model.background_encoder(images)),
        )


@torch.no_grad()
def pictures_of(model: FullModel, estimate: Estimate, record: Record) -> Tensor:
    vertices = model.shapes(record.shape)
    pose = model.poses(record.pose, vertices)
    return model.render(Reconstruction(vertices, estimate.texture_maps, pose, estimate.backgrounds))


def test_each_kind_of_candidate_is_there_once_for_every_photograph() -> None:
    model = tiny_model()
    estimate, record = estimate_of(model, 3), first_record(model, 3, generator(0))
    poses, shapes, _ = candidates(model, estimate, record, CONFIG, generator(1))
    assert poses.shape == (1 + 1 + 2 + 2 + 2 + 3 + 3 + 1 + 3, 3, 7)
    torch.testing.assert_close(poses[0], record.pose)
    torch.testing.assert_close(poses[1], estimate.student.coordinates)
    torch.testing.assert_close(poses[2:4], estimate.heads.coordinates.transpose(0, 1))
    assert torch.equal(shapes[:15], record.shape.expand(15, -1, -1))
    assert torch.equal(poses[15:], record.pose.expand(3, -1, -1))
    assert torch.equal(shapes[15], estimate.shape)


def test_the_estimated_shape_is_the_best_and_learns_where_none_is_searched_for() -> None:
    model, extractor = tiny_model(), tiny_extractor()
    images, _ = photographs(3)
    features = [layer.float() for layer in extract(extractor, images, 3)]
    record = first_record(model, 3, generator(0))
    config = replace(CONFIG, shapes=None)
    shape = torch.randn(3, model.shapes.parameter_count, generator=generator(2), requires_grad=True)
    estimate = estimate_of(model, 3)._replace(shape=shape)
    best = explore(model, extractor, features, estimate, record, config, generator(1))
    assert torch.equal(best.record.shape, shape)
    best.record.shape.sum().backward()
    assert shape.grad is not None
    assert torch.equal(shape.grad, torch.ones_like(shape))


def test_near_shapes_differ_as_random_ones_do() -> None:
    model = tiny_model()
    record = Record(model.poses.draw(3, generator(0)), model.shapes.draw(3, 1.0, generator(2)))
    config = replace(CONFIG, shapes=ShapeSearchConfig(random=0, perturbed=300, step=(0.2, 0.2), spread=0.5))
    shapes = candidates(model, estimate_of(model, 3), record, config, generator(1)).shapes
    near = (shapes[-300:] - record.shape).flatten(0, 1)
    random = model.shapes.draw(900, 0.2, generator(3))
    torch.testing.assert_close(near.mean(dim=0), torch.zeros(near.shape[1]), atol=0.04, rtol=0)
    torch.testing.assert_close(torch.cov(near.T), torch.cov(random.T), atol=0.015, rtol=0)


def test_turned_candidates_keep_all_but_the_azimuth_and_spread_over_the_circle() -> None:
    model = tiny_model()
    record = first_record(model, 2, generator(0))
    none = {"raised_poses": 0, "flipped_poses": 0, "random_poses": 0, "perturbed_poses": 0, "shapes": None}
    only_turned = replace(CONFIG, turned_poses=4, **none)
    poses = candidates(model, estimate_of(model, 2), record, only_turned, generator(1)).poses
    turned = poses[4:8]
    torch.testing.assert_close(turned[..., 2:], record.pose[:, 2:].expand(4, -1, -1))
    torch.testing.assert_close(turned[..., :2].sum(dim=0), torch.zeros(2, 2), atol=1e-5, rtol=0)


def test_raised_candidates_keep_all_but_the_elevation_and_spread_over_its_range() -> None:
    model = tiny_model()
    record = first_record(model, 50, generator(0))
    only_raised = replace(CONFIG, turned_poses=0, raised_poses=4, random_poses=0, perturbed_poses=0, shapes=None)
    poses = candidates(model, estimate_of(model, 50), record, refining(only_raised), generator(1)).poses
    raised = poses[4:]
    assert len(raised) == 4
    others = [0, 1, 3, 4, 5, 6]
    torch.testing.assert_close(raised[..., others], record.pose[:, others].expand(4, -1, -1))
    torch.testing.assert_close(raised[1:, :, 2] - raised[:-1, :, 2], torch.full((3, 50), 0.5))
    assert -1 <= raised[0, :, 2].min() < -0.9
    assert 0.9 < raised[3, :, 2].max() <= 1


def test_elevations_are_found_from_far_away() -> None:
    model, extractor = tiny_model(), tiny_extractor()
    estimate, true = estimate_of(model, 12), first_record(model, 12, generator(0))
    features = extractor(pictures_of(model, estimate, true))
    record = true._replace(pose=torch.cat([true.pose[:, :2], torch.zeros(12, 1), true.pose[:, 3:]], 1))
    config = replace(refining(CONFIG), raised_poses=8, perturbed_poses=0)
    best = explore(model, extractor, features, estimate, record, config, generator(1))
    before, after = ((poses[:, 2] - true.pose[:, 2]).abs() for poses in (record.pose, best.record.pose))
    assert after.mean() < 0.4 * before.mean()


def test_flipped_candidates_look_alike_from_outside() -> None:
    model = tiny_model()
    record = first_record(model, 2, generator(0))
    none = {"turned_poses": 0, "raised_poses": 0, "random_poses": 0, "perturbed_poses": 0, "shapes": None}
    only_flipped = replace(CONFIG, **none)
    poses = candidates(model, estimate_of(model, 2), record, only_flipped, generator(1)).poses
    azimuths = torch.atan2(poses[4:7, :, 1], poses[4:7, :, 0])
    recorded = torch.atan2(record.pose[:, 1], record.pose[:, 0])
    expected = torch.stack([recorded + torch.pi, -recorded, torch.pi - recorded])
    torch.testing.assert_close((azimuths - expected).cos(), torch.ones(3, 2))
    torch.testing.assert_close(poses[4:7, :, 2:], record.pose[:, 2:].expand(3, -1, -1))


def test_heads_beyond_reach_are_ranked_by_their_distances(monkeypatch: pytest.MonkeyPatch) -> None:
    model, extractor = tiny_model(), tiny_extractor()
    features = extractor(photographs(2)[0].float() / 255)
    estimate, record = estimate_of(model, 2), first_record(model, 2, generator(0))
    count = len(candidates(model, estimate, record, CONFIG, generator(1)).poses)
    falling = torch.linspace(1.001, 1, count)[:, None].expand(count, 2)
    monkeypatch.setattr("pipeline.training.exploration.score", lambda *_: falling)
    monkeypatch.setattr("pipeline.training.exploration.within_reach", lambda *_: torch.zeros(count, 2) > 0)
    head = explore(model, extractor, features, estimate, record, CONFIG, generator(1)).head
    assert head.tolist() == [estimate.heads.end.shape[1] - 1] * 2


def distances(
    model: FullModel, extractor: FeatureExtractor, features: Features, estimate: Estimate, record: Record
) -> Tensor:
    """Return how far one candidate is from each photograph."""
    return score(model, extractor, features, estimate, record.pose[None], record.shape[None], CONFIG.map_weights)[0]


def test_the_true_pose_wins_and_its_loss_is_zero() -> None:
    model, extractor = tiny_model(), tiny_extractor()
    estimate, record = estimate_of(model, 3), first_record(model, 3, generator(0))
    features = extractor(pictures_of(model, estimate, record))
    best = explore(model, extractor, features, estimate, record, CONFIG, generator(1))
    torch.testing.assert_close(best.record.pose, record.pose)
    assert distances(model, extractor, features, estimate, best.record).amax() < 1e-3


def test_comparison_sees_directions_of_features_and_weights_of_maps() -> None:
    pictures, weak = torch.rand(2, 3, 4, 4, generator=generator(0)), torch.rand(2, 8, 4, 4, generator=generator(1))
    first = comparable([pictures, weak, weak], (0.5, 2.0))
    second = comparable([pictures, 3 * weak, 1 - weak], (0.5, 2.0))
    assert len(first) == 2
    torch.testing.assert_close(first[0], 0.5 * pictures)
    torch.testing.assert_close(first[1].norm(dim=1), torch.full((2, 4, 4), 2.0))
    torch.testing.assert_close(feature_distance(first, second), torch.zeros(2), atol=1e-5, rtol=0)


def test_exploring_never_ends_above_the_record_and_finds_the_best_head() -> None:
    model, extractor = tiny_model(), tiny_extractor()
    images, _ = photographs(4)
    features = [layer.float() for layer in extract(extractor, images, 4)]
    estimate, record = estimate_of(model, 4), first_record(model, 4, generator(0))
    best = explore(model, extractor, features, estimate, record, CONFIG, generator(1))
    zeros = torch.zeros(1, 4, model.shapes.parameter_count)
    recorded, won = (distances(model, extractor, features, estimate, found) for found in (record, best.record))
    assert (won <= recorded + 1e-4).all()
    assert (won < recorded - 1e-3).any()
    of_heads = score(
        model,
        extractor,
        features,
        estimate,
        estimate.heads.coordinates.transpose(0, 1),
        zeros.expand(2, -1, -1),
        CONFIG.map_weights,
    )
    assert torch.equal(best.head, of_heads.argmin(dim=0))


def test_gradients_reach_the_head_whose_pose_won() -> None:
    model, extractor = tiny_model(), tiny_extractor()
    estimate, truth = estimate_of(model, 1), first_record(model, 1, generator(0))
    features = extractor(pictures_of(model, estimate, truth))
    heads = torch.stack([-truth.pose, truth.pose], dim=1).requires_grad_()
    record = truth._replace(pose=-truth.pose)
    best = explore(
        model, extractor, features, estimate._replace(heads=exact_regression(heads)), record, CONFIG, generator(1)
    )
    torch.testing.assert_close(best.record.pose, truth.pose)
    best.record.pose.sum().backward()
    assert heads.grad is not None
    assert (heads.grad.abs().sum(dim=2) > 0).tolist() == [[False, True]]


def test_a_refined_record_keeps_its_side_even_where_the_other_one_fits() -> None:
    model, extractor = tiny_model(), tiny_extractor()
    estimate, truth = estimate_of(model, 3), first_record(model, 3, generator(0))
    features = extractor(pictures_of(model, estimate, truth))
    opposite = torch.cat([-truth.pose[:, :2], truth.pose[:, 2:]], 1)
    estimate = estimate._replace(
        student=exact_regression(truth.pose), heads=exact_regression(torch.stack([truth.pose, opposite], dim=1))
    )
    record = truth._replace(pose=opposite)
    free = explore(model, extractor, features, estimate, record, CONFIG, generator(1))
    torch.testing.assert_close(free.record.pose, truth.pose)
    kept = explore(model, extractor, features, estimate, record, refining(CONFIG), generator(1))
    assert within_reach(kept.record.pose[None], opposite, 90).all()
    nearest, near = (distances(model, extractor, features, estimate, found.record) for found in (free, kept))
    assert (near > nearest).all()
    assert free.head.tolist() == [0, 0, 0]
    assert kept.head.tolist() == [1, 1, 1]
    elsewhere = torch.cat([truth.pose[:, :6], -truth.pose[:, 6:].sign()], 1)
    far = estimate._replace(heads=exact_regression(torch.stack([elsewhere, truth.pose], dim=1)))
    both_far = explore(model, extractor, features, far, record, refining(CONFIG), generator(1))
    assert within_reach(both_far.record.pose[None], opposite, 90).all()
    assert both_far.head.tolist() == [1, 1, 1]


def test_reach_is_an_angle_between_azimuths() -> None:
    angles = torch.deg2rad(torch.tensor([0.0, 29.0, -29.0, 31.0, 180.0]))
    turned = torch.cat([angles.cos()[:, None], angles.sin()[:, None], torch.rand(5, 5, generator=generator(0))], 1)
    recorded = turned[:1]
    near = within_reach(turned[:, None], recorded, 30)[:, 0]
    assert near.tolist() == [True, True, True, False, False]
    assert within_reach(turned[:, None], recorded, 180).all()


def test_settings_that_no_candidate_can_have_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"pose_step is \[0\.5, 0\.3\]; expected the smaller size first"):
        replace(CONFIG, pose_step=(0.5, 0.3))
    with pytest.raises(ConfigError, match=r"^step is \[0\.5, 0\.1\]; expected the smaller size first"):
        ShapeSearchConfig(random=1, perturbed=1, step=(0.5, 0.1), spread=0.5)


def test_steps_of_poses_are_of_all_sizes() -> None:
    model = tiny_model()
    poses = torch.zeros(3, 7).index_fill(1, torch.tensor([0]), 1.0)
    record = Record(poses, torch.zeros(3, model.shapes.parameter_count))
    none = dict.fromkeys(("turned_poses", "raised_poses", "flipped_poses", "random_poses"), 0)
    config = replace(CONFIG, perturbed_poses=400, shapes=None, pose_step=(0.01, 0.1), **none)
    drawn = candidates(model, estimate_of(model, 3), record, config, generator(1)).poses
    sizes = (drawn[4:] - record.pose)[..., 2:].flatten(0, 1).square().mean(1).sqrt()
    assert sizes.log().mean().exp().item() == pytest.approx(0.028, rel=0.15)
    assert sizes.quantile(0.02) < 0.012
    assert sizes.quantile(0.98) > 0.08


def test_random_shapes_spread_as_asked() -> None:
    model = tiny_model()
    assert CONFIG.shapes is not None
    config = replace(CONFIG, shapes=replace(CONFIG.shapes, random=100, perturbed=0, spread=0.5))
    shapes = candidates(model, estimate_of(model, 3), first_record(model, 3, generator(0)), config, generator(1)).shapes
    assert shapes[-100:].std().item() == pytest.approx(0.5, abs=0.03)
