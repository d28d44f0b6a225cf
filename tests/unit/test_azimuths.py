"""Azimuths that votes agree on."""

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from pipeline.seeding import generator
from pipeline.training import azimuths as azimuths_module
from pipeline.training.azimuths import (
    AZIMUTHS,
    ConsensusConfig,
    agree_on_azimuths,
    balance,
    bins,
    join_votes,
    judge,
    mirrored,
    regress_held_out,
    standardize,
    symmetric_share,
)
from pipeline.training.paint import mean_colors, paintless_features, repaint
from tests.tiny_full_model import photographs, scramble_paint, tiny_extractor

CONFIG = ConsensusConfig(
    rounds=4, smaller_end=0.0, components=32, repainting_floor=0.3, ridge=0.01, folds=5, sharpness=3.0
)
COUNT = 400
NOISE = 0.1


def azimuths_of(count: int) -> Tensor:
    return 2 * math.pi * torch.rand(count, generator=generator(0))


def votes_for(azimuths: Tensor) -> Tensor:
    return 2 * torch.cos(azimuths[:, None] - bins(azimuths.device)) + torch.cos(
        2 * (azimuths[:, None] - bins(azimuths.device))
    )


def features_of(azimuths: Tensor, paint: Tensor) -> Tensor:
    """Encode the azimuth faintly and the paint strongly in 12 centred features of pictures and their mirror images."""
    mixing = torch.randn(5, 12, generator=generator(1))

    def encode(azimuths: Tensor) -> Tensor:
        clean = torch.stack([azimuths.cos(), azimuths.sin(), (2 * azimuths).cos(), (2 * azimuths).sin(), 3 * paint], 1)
        return clean @ mixing + NOISE * torch.randn(len(azimuths), 12, generator=generator(2))

    features = torch.stack([encode(azimuths), encode(-azimuths)])
    return features - features.mean(dim=(0, 1))


def after_rounds(votes: Tensor, features: Tensor, colors: Tensor, rounds: int, **changes: float) -> Tensor:
    """Let votes agree with photographs of these features and mean colours."""
    unread = torch.zeros(len(votes), 3, 4, 4)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(azimuths_module, "paintless_features", lambda *_: features)
        patch.setattr(azimuths_module, "mean_colors", lambda _: colors)
        config = replace(CONFIG, rounds=rounds, **changes)  # pyright: ignore[reportArgumentType]
        return agree_on_azimuths(votes, unread, tiny_extractor(), config, generator(6))


def share_right(probabilities: Tensor, azimuths: Tensor) -> float:
    found = bins(azimuths.device)[probabilities.argmax(dim=1)]
    return (torch.cos(found - azimuths) > math.cos(math.pi / 6)).float().mean().item()


def test_mirrored_takes_the_negated_azimuth() -> None:
    values = torch.cos(bins(torch.device("cpu")) - 0.7)
    torch.testing.assert_close(mirrored(values), torch.cos(bins(torch.device("cpu")) + 0.7))
    torch.testing.assert_close(mirrored(mirrored(values)), values)


def test_votes_of_generators_add_up_in_the_frame_of_the_first() -> None:
    azimuths = azimuths_of(COUNT)
    fronts = torch.rand(3, COUNT, generator=generator(4)) < 0.7
    voted = azimuths + torch.pi * ~fronts
    voted[1] += torch.pi  # this generator's shape faces the other way
    votes = torch.stack([votes_for(one) for one in voted])
    joined = join_votes(votes)
    of_each = [share_right(scores, azimuths) for scores in votes]
    assert of_each[1] < 0.4
    assert share_right(joined, azimuths) > max(of_each) + 0.05
    torch.testing.assert_close(join_votes(votes[:1]), standardize(votes[0]))
    turned = join_votes(torch.stack([votes[1].roll(9, dims=1), votes[0], votes[2]]))  # a frame at 45 degrees
    assert share_right(turned, azimuths + 1.25 * torch.pi) == pytest.approx(share_right(joined, azimuths), abs=0.02)


def test_balance_gives_axes_their_share_and_opposite_azimuths_the_same_colours() -> None:
    azimuths = azimuths_of(COUNT)
    colors = torch.randn(COUNT, 2, generator=generator(3))
    light_ones_drive_forwards = 2 * colors[:, :1] * torch.cos(bins(colors.device))
    scores = votes_for(azimuths) + light_ones_drive_forwards
    share = symmetric_share(votes_for(azimuths))
    probabilities = balance(scores, colors, share, CONFIG.smaller_end)
    torch.testing.assert_close(probabilities.sum(dim=1), torch.ones(COUNT))

    def of_axes(values: Tensor) -> Tensor:
        return values + values.roll(AZIMUTHS // 2)

    torch.testing.assert_close(of_axes(probabilities.mean(dim=0)), of_axes(share), atol=2e-3, rtol=0)
    forwards = torch.cos(bins(colors.device)) > 1e-4

    def difference(probabilities: Tensor) -> Tensor:
        sums = colors.T @ probabilities / COUNT
        return (sums[:, forwards].sum(dim=1) - sums[:, forwards.roll(AZIMUTHS // 2)].sum(dim=1)).abs().max()

    assert difference(scores.softmax(dim=1)) > 0.2
    assert difference(probabilities) < 0.02


def test_balance_forgets_that_votes_prefer_one_end() -> None:
    azimuths = azimuths_of(COUNT)
    colors, votes = torch.randn(COUNT, 1, generator=generator(3)), votes_for(azimuths)
    preferring = votes + 0.7 * torch.cos(bins(colors.device))
    share = symmetric_share(votes)
    torch.testing.assert_close(balance(preferring, colors, share, 0.0), balance(votes, colors, share, 0.0))


@pytest.mark.parametrize("smaller_end", [0.4, 0.5])
def test_neither_end_takes_all_photographs(smaller_end: float) -> None:
    from_the_front = torch.rand(COUNT, generator=generator(9)) < 0.8
    azimuths = math.pi * (torch.rand(COUNT, generator=generator(10)) - 0.5) + math.pi * ~from_the_front
    colors, scores = torch.randn(COUNT, 1, generator=generator(3)), votes_for(azimuths)
    share = symmetric_share(scores)

    def largest_end(least: float) -> float:
        probabilities = balance(scores, colors, share, least).mean(dim=0)
        return (probabilities / (probabilities + probabilities.roll(AZIMUTHS // 2))).amax().item()

    assert largest_end(smaller_end) == pytest.approx(1 - smaller_end, abs=0.03)
    assert largest_end(0.0) > 0.65


def test_most_photographs_may_show_the_front() -> None:
    from_the_front = torch.rand(COUNT, generator=generator(9)) < 0.8
    azimuths = math.pi * (torch.rand(COUNT, generator=generator(10)) - 0.5) + math.pi * ~from_the_front
    votes = votes_for(azimuths + math.pi * (torch.rand(COUNT, generator=generator(4)) < 0.35))
    features = features_of(azimuths, torch.zeros(COUNT))
    colors = torch.randn(COUNT, 1, generator=generator(5))
    assert share_right(after_rounds(votes, features, colors, 0), azimuths) < 0.7
    assert share_right(after_rounds(votes, features, colors, 2), azimuths) > 0.9


@pytest.mark.parametrize("rounds", [0, 1, 2])
def test_no_end_takes_more_than_its_part_of_the_photographs_before_or_after_rounds(rounds: int) -> None:
    from_the_front = torch.rand(COUNT, generator=generator(9)) < 0.9
    azimuths = math.pi * (torch.rand(COUNT, generator=generator(10)) - 0.5) + math.pi * ~from_the_front
    votes, features = votes_for(azimuths), features_of(azimuths, torch.zeros(COUNT))
    colors = torch.randn(COUNT, 1, generator=generator(5))
    free, balanced = (after_rounds(votes, features, colors, rounds, smaller_end=least) for least in (0.0, 0.5))
    front = bins(azimuths.device).cos() > 0
    assert free[:, front].sum(dim=1).mean() > 0.7
    assert balanced[:, front].sum(dim=1).mean() < 0.55


def test_sharper_scores_leave_less_doubt_after_a_round() -> None:
    azimuths = azimuths_of(COUNT)
    votes, features = votes_for(azimuths), features_of(azimuths, torch.zeros(COUNT))
    colors = torch.randn(COUNT, 1, generator=generator(5))
    dull, sharp = (after_rounds(votes, features, colors, 1, sharpness=sharpness) for sharpness in (1.0, 3.0))
    assert sharp.amax(dim=1).mean() > 1.5 * dull.amax(dim=1).mean()


def test_judging_repairs_votes_that_confuse_front_and_rear() -> None:
    azimuths = azimuths_of(COUNT)
    reversed_ones = torch.rand(COUNT, generator=generator(4)) < 0.35
    votes = votes_for(azimuths + math.pi * reversed_ones)
    features = features_of(azimuths, torch.zeros(COUNT))
    colors = torch.randn(COUNT, 1, generator=generator(5))
    assert share_right(after_rounds(votes, features, colors, 0), azimuths) < 0.7
    assert share_right(after_rounds(votes, features, colors, 2), azimuths) > 0.95
    assert share_right(after_rounds(votes, features, colors, 4), azimuths) > 0.95


@pytest.mark.parametrize("blind", [0, 1])
def test_what_only_one_of_two_mirror_images_shows_is_judged(blind: int) -> None:
    azimuths = azimuths_of(COUNT)
    features = features_of(azimuths, torch.zeros(COUNT))
    features[blind] = 0
    scores = judge(features, votes_for(azimuths).softmax(dim=1), CONFIG.ridge, CONFIG.folds, generator(6))
    assert share_right(scores, azimuths) > 0.9


def test_scores_are_compared_within_a_photograph() -> None:
    votes, liked = votes_for(azimuths_of(COUNT)), torch.randn(COUNT, 1, generator=generator(1))
    torch.testing.assert_close(standardize(votes + liked), standardize(votes))


def test_paint_does_not_decide_which_end_is_the_front() -> None:
    azimuths = azimuths_of(COUNT)
    paint = torch.randn(COUNT, generator=generator(7))
    reversed_ones = torch.rand(COUNT, generator=generator(4)) < torch.sigmoid(3 * paint - 0.6)
    votes = votes_for(azimuths + math.pi * reversed_ones)
    features = features_of(azimuths, paint)

    one_round_blind_to_paint = after_rounds(votes, features, torch.randn(COUNT, 1, generator=generator(5)), 1)
    one_round = after_rounds(votes, features, paint[:, None], 1)
    assert share_right(one_round, azimuths) > share_right(one_round_blind_to_paint, azimuths) + 0.02
    two_rounds_blind_to_paint = after_rounds(votes, features, torch.randn(COUNT, 1, generator=generator(5)), 2)
    assert share_right(after_rounds(votes, features, paint[:, None], 2), azimuths) > 0.95
    assert share_right(two_rounds_blind_to_paint, azimuths) < 0.9


def test_repainting_mixes_channels() -> None:
    red = torch.tensor([0.6, 0.4, 0.4])[:, None, None].expand(20, 3, 8, 8)
    _, green, blue = repaint(red, generator(1)).mean(dim=(2, 3)).unbind(1)
    assert (green - blue).abs().mean() > 0.01


def test_features_in_units_of_repainting_tell_azimuths_better_than_paint() -> None:
    images, _ = photographs(24)
    pictures, extractor = images.float() / 255, tiny_extractor()
    repainted = torch.cat([repaint(pictures, generator(1)), repaint(pictures, generator(2))])

    def share_of_paint(floor: float) -> float:
        features = paintless_features(repainted, extractor, 8, floor, generator(3))[0].unflatten(0, (2, 24))
        return ((features[0] - features[1]).square().mean() / features.var()).item()

    assert share_of_paint(0.01) < share_of_paint(1e4)


def test_colours_are_whitened_and_the_same_in_mirror_images() -> None:
    pictures = torch.rand(64, 3, 16, 16, generator=generator(1))
    colors = mean_colors(pictures)
    assert colors.shape == (64, 9)
    assert (colors.mean(dim=0).abs() < 0.2).all()
    assert (colors.T @ colors / len(colors) - torch.eye(9)).abs().max() < 0.1  # but for what is cut off at 3
    assert (mean_colors(pictures.flip(-1)).abs() - colors.abs()).abs().max() < 1e-2


@pytest.mark.parametrize("count", [2, 5, 9, 60])
def test_few_or_like_photographs_can_be_balanced(count: int) -> None:
    pictures = torch.rand(1 if count == 60 else count, 3, 16, 16, generator=generator(1)).expand(count, -1, -1, -1)
    scores = torch.randn(count, 72, generator=generator(2))
    probabilities = balance(scores, mean_colors(pictures), symmetric_share(scores), 0.0)
    torch.testing.assert_close(probabilities.sum(dim=1), torch.ones(count))


def test_votes_stay_where_there_are_no_rounds_and_repeat_for_a_seed() -> None:
    images, coordinates = photographs(12)
    votes = votes_for(torch.atan2(coordinates[:, 1], coordinates[:, 0]))
    pictures, extractor = images.float() / 255, tiny_extractor()

    def agree(rounds: int) -> Tensor:
        config = ConsensusConfig(rounds, 0.4, 4, 0.3, 0.3, 3, 3.0)
        return agree_on_azimuths(votes, pictures, extractor, config, generator(8))

    assert agree(0).shape == (12, AZIMUTHS)
    assert torch.equal(agree(2), agree(2))
    assert not torch.equal(agree(2), agree(0))


def test_no_photograph_is_said_by_a_regression_that_knows_it() -> None:
    features, targets = (torch.randn(2, 60, size, generator=generator(size)) for size in (60, 1))
    said = regress_held_out(features, targets, 1e-3, 5, generator(2))
    assert abs(torch.corrcoef(torch.stack([said.flatten(), targets.flatten()]))[0, 1]) < 0.3


def test_features_know_no_colours_and_edges(monkeypatch: pytest.MonkeyPatch) -> None:
    extractor, pictures = tiny_extractor(), photographs(12)[0] / 255
    before = paintless_features(pictures, extractor, 4, 0.3, generator(0))
    scramble_paint(extractor, monkeypatch)
    torch.testing.assert_close(paintless_features(pictures, extractor, 4, 0.3, generator(0)), before)
