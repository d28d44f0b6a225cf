"""Ends that photographs show, told by what changes sign in the mirror."""

import math
from dataclasses import replace
from typing import Literal

import pytest
import torch
from torch import Tensor

from pipeline.seeding import generator
from pipeline.training import ends
from pipeline.training.boxes import cut_to_box
from pipeline.training.candidates import flipped
from pipeline.training.ends import OddViews, consistent_axes, facing, facing_with_preferred_end, tell_ends
from tests.tiny_full_model import ENDS, MODEL, photographs_of, tiny_extractor, tiny_model

CONFIG = replace(ENDS, components=32, side_reach=22.0, rounds=10, folds=5)
COUNT = 400


def slants(count: int) -> Tensor:
    return math.pi * (torch.rand(count, generator=generator(0)) - 0.5)


def odd_features(facing_left: Tensor, slant: Tensor, roll: Tensor, strength: float = 6) -> Tensor:
    """Encode facing, by parts that turn with the slant, and the slant itself and the roll, usually more strongly."""
    mixing = torch.randn(5, 64, generator=generator(1))
    shown = torch.stack([facing_left * slant.cos(), facing_left * slant.sin().square(), strength * slant, 5 * roll], 1)
    other = torch.randn(len(slant), 1, generator=generator(2))
    return torch.cat([shown, other], 1) @ mixing + 0.1 * torch.randn(len(slant), 64, generator=generator(3))


def share_right(belief: Tensor, truth: Tensor) -> float:
    return max((sign * belief * truth > 0).float().mean().item() for sign in (1, -1))


def test_facing_is_told_whatever_slant_and_roll() -> None:
    slant, (truth, side) = slants(COUNT), torch.randint(2, (2, COUNT), generator=generator(4)) * 2.0 - 1
    roll = 0.4 * side + 0.05 * torch.randn(COUNT, generator=generator(5))  # two clusters as well
    odd = odd_features(truth, slant, roll)
    aware, unaware = OddViews(odd, slant, roll[:, None]), OddViews(odd, slant, torch.zeros(COUNT, 1))
    mirrored = OddViews(*(-part for part in aware))
    assert share_right(facing(aware, CONFIG, generator(6)), truth) > 0.95
    assert share_right(facing(mirrored, CONFIG, generator(6)), truth) > 0.95
    assert share_right(facing(unaware, CONFIG, generator(6)), truth) < 0.8


def test_facing_is_told_where_slants_are_known_roughly() -> None:
    slant, truth = slants(COUNT), torch.randint(2, (COUNT,), generator=generator(4)) * 2.0 - 1
    odd = odd_features(truth, slant, torch.zeros(COUNT), strength=12)
    rough = (slant + 0.2 * torch.randn(COUNT, generator=generator(5))).clamp(-math.pi / 2, math.pi / 2)
    views = OddViews(odd, rough, torch.zeros(COUNT, 1))
    assert share_right(facing(views, CONFIG, generator(6)), truth) > 0.95


@pytest.mark.parametrize("preferred", [1, -1])
@pytest.mark.parametrize("strength", [0.5, 6])
def test_sides_are_split_and_face_as_most_are_recorded(preferred: int, strength: float) -> None:
    nearer_left, rng = slants(COUNT), generator(4)  # the left end is nearer at positive slants
    side, along = nearer_left.abs() <= math.radians(22), nearer_left.abs() >= math.radians(68)
    truth = nearer_left.sign()  # the preferred end is at the left where the left is nearer
    truth[side] = torch.randint(2, (int(side.sum()),), generator=rng) * 2.0 - 1
    # The end that is called front: mostly the preferred one at sides and along the axis, mostly the other one between.
    right = torch.rand(COUNT, generator=rng) < torch.where(side | along, 0.7, 0.2)
    recorded = truth * torch.where(right, 1, -1) * preferred
    roll = 0.2 * torch.randn(COUNT, generator=rng)
    odd = odd_features(truth, nearer_left, roll, strength)
    views = OddViews(recorded[:, None] * odd, -recorded * nearer_left, (recorded * roll)[:, None])
    belief = facing_with_preferred_end(views, CONFIG.side_reach)
    told = (belief * recorded * preferred).sign()
    assert (told == truth)[side].float().mean() > 0.95
    assert torch.equal(told[~side], truth[~side])


def test_photographs_tell_which_recorded_ends_are_wrong() -> None:
    model = tiny_model()
    truth = model.poses.draw(COUNT, generator(2))
    wrong = torch.rand(COUNT, generator=generator(7)) < 0.35
    recorded = torch.where(wrong[:, None], flipped(truth, 1)[0], truth)
    images, extractor = photographs_of(truth), tiny_extractor()
    belief = tell_ends(images, recorded, recorded, model.poses, extractor, CONFIG, generator(8))
    assert ((belief < 0) == wrong).float().mean() > 0.95
    assert not tell_ends(images[:60], recorded[:60], recorded[:60], model.poses, extractor, CONFIG, generator(8)).any()


def test_photographs_that_mostly_show_one_end_tell_which_records_are_wrong() -> None:
    model, rng = tiny_model(), generator(2)
    truth = model.poses.draw(COUNT, rng)
    rears = (truth[:, 0] < 0) & (torch.rand(COUNT, generator=rng) < 0.8)
    truth[rears, :1] *= -1
    # Views between the side and the axis are mostly recorded the wrong way round, the others mostly right.
    between = (truth[:, 0].abs() > 0.4) & (truth[:, 0].abs() < 0.9)
    wrong = torch.rand(COUNT, generator=rng) < torch.where(between, 0.8, 0.25)
    recorded = torch.where(wrong[:, None], flipped(truth, 1)[0], truth)
    images, extractor = photographs_of(truth), tiny_extractor()
    config = replace(CONFIG, shown="mostly_one")
    belief = tell_ends(images, recorded, recorded, model.poses, extractor, config, generator(8))
    assert wrong.float().mean() > 0.3
    assert ((belief < 0) == wrong).float().mean() > 0.9


@pytest.mark.parametrize(
    ("shown", "azimuth", "missing"), [("equally", 0.0, "sides"), ("mostly_one", math.pi / 2, "ends")]
)
def test_ends_stay_where_too_few_photographs_show_what_tells_them(
    shown: Literal["equally", "mostly_one"], azimuth: float, missing: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (model, extractor), recorded = (tiny_model(), tiny_extractor()), tiny_model().poses.draw(60, generator(2))
    recorded[:, 0], recorded[:, 1] = math.cos(azimuth), math.sin(azimuth)
    config = replace(CONFIG, shown=shown, consistency=0.0)
    belief = tell_ends(photographs_of(recorded), recorded, recorded, model.poses, extractor, config, generator(8))
    assert not belief.any()
    said = f"ends stay as they are recorded: 0 photographs show {missing}, telling them needs 50"
    assert said in capsys.readouterr().out


def test_objects_are_cut_upright() -> None:
    pose_range = replace(MODEL.pose_range, roll=(-40.0, 40.0))
    model = tiny_model(pose_range=pose_range)
    side = torch.tensor([[0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0]])
    rolled = side + torch.tensor([[0.0, 0.0, 0.0, 0.75, 0.0, 0.0, 0.0]])
    rolls = model.poses(rolled, model.base_vertices[None]).roll
    torch.testing.assert_close(model.poses.roll(rolled), rolls)
    torch.testing.assert_close(rolls, torch.tensor([math.radians(30)]))

    def proportion(coordinates: Tensor) -> float:
        images = photographs_of(coordinates, pose_range) / 255
        pictures = cut_to_box(images, model.poses, coordinates, 0.6, model.poses.roll(coordinates))
        covered = (pictures[0] - 0.8).abs().amax(dim=0) > 0.1
        return (covered.any(dim=1).sum() / covered.any(dim=0).sum()).item()

    assert proportion(rolled) == pytest.approx(proportion(side), abs=0.12)
    assert proportion(side) < 0.6


def test_axes_of_similar_photographs_become_consistent() -> None:
    truth, rng = tiny_model().poses.draw(COUNT, generator(2)), generator(9)
    azimuth = torch.atan2(truth[:, 1], truth[:, 0])
    wrong = azimuth + 0.2 * torch.randn(COUNT, generator=rng) + math.pi * torch.randint(2, (COUNT,), generator=rng)
    recorded = torch.stack([wrong.cos(), wrong.sin()], 1)
    angles = torch.stack([wave(2 * step * azimuth) for step in (1, 2) for wave in (torch.cos, torch.sin)], 1)
    mirrored = angles * torch.tensor([1.0, -1.0, 1.0, -1.0])
    features = torch.stack([angles, mirrored]) + 0.3 * torch.randn(2, COUNT, 4, generator=rng)
    consistent = consistent_axes(features, recorded, replace(CONFIG, ridge=0.1), rng)

    def errors(turn: Tensor) -> Tensor:
        return (2 * (torch.atan2(turn[:, 1], turn[:, 0]) - azimuth)).sin().abs()

    assert errors(consistent).mean() < 0.7 * errors(recorded).mean()
    assert ((consistent * recorded).sum(dim=1) > 0).all()


def test_axes_that_only_mirror_images_show_become_consistent() -> None:
    truth, rng = tiny_model().poses.draw(COUNT, generator(2)), generator(9)
    azimuth = torch.atan2(truth[:, 1], truth[:, 0])
    wrong = azimuth + 0.3 * torch.randn(COUNT, generator=rng)
    recorded = torch.stack([wrong.cos(), wrong.sin()], 1)
    shown = torch.stack([(2 * azimuth).cos(), -(2 * azimuth).sin()], 1)
    features = torch.stack([torch.zeros_like(shown), shown])
    consistent = consistent_axes(features, recorded, replace(CONFIG, ridge=0.1, consistency=10.0), rng)

    def error(turn: Tensor) -> float:
        return (2 * (torch.atan2(turn[:, 1], turn[:, 0]) - azimuth)).sin().abs().mean().item()

    assert error(consistent) < 0.7 * error(recorded)


def test_ends_are_told_from_pictures_that_are_turned_upright(monkeypatch: pytest.MonkeyPatch) -> None:
    pose_range = replace(MODEL.pose_range, roll=(-40.0, 40.0))
    model, extractor, cuts = tiny_model(pose_range=pose_range), tiny_extractor(), []
    rolled = torch.tensor([[0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0]]).repeat(5, 1)
    rolled[:, 3] = torch.linspace(-0.9, 0.9, 5)
    paintless = ends.paintless_features
    monkeypatch.setattr(ends, "paintless_features", lambda *given: (cuts.append(given[0]), paintless(*given))[1])
    images, config = photographs_of(rolled, pose_range), replace(CONFIG, box_size=0.6)
    tell_ends(images, rolled, rolled, model.poses, extractor, config, generator(8))
    askew = cut_to_box(images / 255, model.poses, rolled, 0.6, torch.zeros(5))
    upright, rolled_ones = ((pictures - pictures[2]).abs().mean() for pictures in (cuts[0], askew))
    assert upright < 0.7 * rolled_ones


def test_ends_are_told_better_where_axes_are_made_consistent(monkeypatch: pytest.MonkeyPatch) -> None:
    model, rng = tiny_model(), generator(7)
    truth = model.poses.draw(COUNT, generator(2))
    wrong = torch.rand(COUNT, generator=rng) < 0.35
    azimuth = torch.atan2(truth[:, 1], truth[:, 0])
    named = azimuth + math.pi * wrong + 0.4 * torch.randn(COUNT, generator=rng)
    recorded = torch.cat([named.cos()[:, None], named.sin()[:, None], truth[:, 2:]], 1)
    angles = torch.stack([wave(step * azimuth) for step in (1, 2, 3) for wave in (torch.cos, torch.sin)], 1)
    features = torch.stack([angles, angles * torch.tensor([1.0, -1.0]).repeat(3)])
    features = features + 0.1 * torch.randn(2, COUNT, 6, generator=rng)
    monkeypatch.setattr(ends, "paintless_features", lambda *_: features)

    def share_told(consistency: float) -> float:
        config, blank = replace(CONFIG, consistency=consistency, ridge=0.1), torch.zeros(COUNT, 3, 8, 8).byte()
        belief = tell_ends(blank, recorded, recorded, model.poses, tiny_extractor(), config, generator(8))
        return share_right(belief, 1 - 2.0 * wrong)

    assert share_told(2.0) > share_told(0.0) + 0.02


def test_networks_share_in_where_objects_stand() -> None:
    model = tiny_model()
    truth = model.poses.draw(COUNT, generator(2))
    wrong = torch.rand(COUNT, generator=generator(7)) < 0.35
    recorded = torch.where(wrong[:, None], flipped(truth, 1)[0], truth)
    shift = torch.zeros(COUNT, 7)
    shift[:, 4:] = 0.6 * torch.randn(COUNT, 3, generator=generator(1))
    images, extractor = photographs_of(truth), tiny_extractor()

    def told(read: Tensor) -> Tensor:
        return tell_ends(images, recorded + shift, read, model.poses, extractor, CONFIG, generator(8))

    torch.testing.assert_close(
        told(recorded - shift), tell_ends(images, recorded, recorded, model.poses, extractor, CONFIG, generator(8))
    )
    assert not torch.allclose(told(recorded), told(recorded - shift))


def test_noise_is_believed_little() -> None:
    noise = torch.randn(COUNT, 2000, generator=generator(1))
    belief = facing(OddViews(noise, slants(COUNT), torch.zeros(COUNT, 1)), CONFIG, generator(6))
    assert belief.abs().mean() < 0.5
