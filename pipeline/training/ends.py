"""Tell the ends of mirror-symmetric objects apart, from what full training has recorded (ours).

Records hold axes and boxes, but which end of its axis a photograph shows is nearly chance: renderings tell builds
apart, not ends (both ends of a van are steep, both of a saloon are low). What changes its sign in the mirror knows
nothing of build and paint:

1. Photographs are cut to their boxes, turned upright, and described by features that paint does not change.
2. Recorded axes are made consistent with each other: neighbouring azimuths differ by more than the two ends do.
3. Of the features only what changes its sign in the mirror is kept.
4. Side views are split in two by its leading component, once all that goes with the slant of the axis is taken off.
5. The split is carried to the other views, in one of two ways:

   - Both ends are shown equally often. Then slants say nothing of the way objects face, and the split spreads from the
     sides to ever more oblique views.
   - Mostly one end is shown, as people show the fronts of cars. It is the end that most views along the axis are
     recorded with; nearly all of these, rears too, name the blunter end, so this is right for objects whose front is
     blunter. What oblique views are recorded with follows the object's build, and to take all of them for the preferred
     end is right more often. The two halves of the side views face as most of them are recorded; oblique views cannot
     tell, because the nearer end looks taller there, which the taller end of a shape explains as well.

6. A last regression from all features to the azimuths that follow judges every photograph, views along the axis too:
   among photographs whose ends were told by the way they face, builds are the same at both.
"""

import math
from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor
from torch.nn import functional
from tqdm import tqdm

from pipeline.distributed import agree, is_first
from pipeline.networks.feature_extractor import FeatureExtractor
from pipeline.networks.pose_coordinates import PoseCoordinates
from pipeline.ranges import Count, NonNegative, Positive, Range, Several
from pipeline.training.azimuths import AZIMUTHS, judge, regress_held_out
from pipeline.training.boxes import cut_to_box
from pipeline.training.paint import paintless_features

_FEWEST = 50
"""Photographs of sides, and of ends where mostly one is shown, below which ends are not told."""
_SHARPNESS = 1.2
"""Of beliefs: a score of typical size is believed by tanh(1.2) = .83."""
_SLANT_HARMONICS = 4
"""Of how slants change features, over all slants."""
_FACING_HARMONICS = 3
"""Of how slants change what tells the way objects face, over all slants."""
_SIDE_HARMONICS = 2
"""Of how slants change features, over those of sides."""


@dataclass(frozen=True)
class EndsConfig:
    """When ends are told apart, and how."""

    shown: Literal["equally", "mostly_one"]
    """How often photographs show one end and the other."""
    after: tuple[Annotated[float, Range(0, 1, open_low=True)], ...]
    """When ends are told: after these parts of full training's iterations, each above 0; 1 is right before the last
    lessons. Where there are none, ends stay as they are recorded."""
    box_size: Positive
    """Longer side of the object's box over the side of a cut picture."""
    components: Count
    """Principal components of the features."""
    repainting_floor: NonNegative
    """Added to the variances under repainting, as a part of their mean."""
    consistency: NonNegative
    """How much what features say of an axis counts beside its record."""
    side_reach: Annotated[float, Range(0, 90)]
    """Slant up to which an object counts as seen from the side, in degrees, and as far from 90 as along its axis."""
    rounds: Several
    """In which ends shown equally often are told from the sides to the axis."""
    ridge: NonNegative
    """Penalty of the regressions, as a part of a coefficient's mean variance."""
    folds: Several
    """Parts of the photographs that are judged in turn by regressions fitted to the others."""
    photographs: Several
    """How many are compared with each other, from the first on."""


@torch.no_grad()
def tell_ends(
    photographs: UInt8[Tensor, "N 3 H W"],
    recorded: Float[Tensor, "N 7"],
    read: Float[Tensor, "N 7"],
    poses: PoseCoordinates,
    extractor: FeatureExtractor,
    config: EndsConfig,
    rng: torch.Generator,
) -> Float[Tensor, " N"]:
    """Return whether photographs show the ends that their recorded pose coordinates say: positive if so, else negative.

    How far from 0 has no meaning. Boxes, elevations and rolls are the means of the recorded ones and of those that
    networks read. 0 everywhere, with a word, where too few photographs show what ends are told by. Where both ends are
    shown equally often it is not known which way of facing is left: the coordinates of the majority are taken to be
    right.
    """
    coordinates = torch.cat([recorded[:, :2], (recorded[:, 2:] + read[:, 2:]) / 2], 1)
    images = cut_to_box(photographs / 255, poses, coordinates, config.box_size, poses.roll(coordinates))
    features = paintless_features(images, extractor, config.components, config.repainting_floor, rng)
    turn = consistent_axes(features, recorded[:, :2], config, rng)
    agree([turn])  # or one process might count fewer sides, draw nothing below, and draw other batches from here on
    views = odd_views(features, turn, coordinates, poses)
    if (missing := _missing_views(views, config)) is not None:
        if is_first():
            tqdm.write(f"ends stay as they are recorded: {missing}, telling them needs {_FEWEST}")
        return torch.zeros_like(views.slant)
    if config.shown == "equally":
        belief = facing(views, config, rng)
    else:
        belief = facing_with_preferred_end(views, config.side_reach)
    seen, opposite = opposite_bins(torch.atan2(turn[:, 1], turn[:, 0]))
    probabilities = ((1 + belief) * seen.T + (1 - belief) * opposite.T).T / 2
    scores = judge(features, probabilities, config.ridge, config.folds, rng)
    lead = (scores * (seen - opposite)).sum(dim=1)
    return -lead if config.shown == "equally" and lead.sign().sum() < 0 else lead


def consistent_axes(
    features: Float[Tensor, "2 N C"], turn: Float[Tensor, "N 2"], config: EndsConfig, rng: torch.Generator
) -> Float[Tensor, "N 2"]:
    """Return cosines and sines of azimuths whose axes similar photographs agree on; ends stay as they are.

    `features` are of the photographs and of their mirror images. To each axis is added what a regression says of it
    that was fitted to the others.
    """
    turn = functional.normalize(turn, dim=1)
    axis = torch.stack([turn[:, 0].square() - turn[:, 1].square(), 2 * turn.prod(dim=1)], 1)  # of twice the angle
    mirror = axis.new_tensor([1.0, -1.0])
    targets = torch.stack([axis, axis * mirror])
    mean = targets.mean(dim=(0, 1))
    here, there = regress_held_out(features, targets - mean, config.ridge, config.folds, rng) + mean
    said = (here + there * mirror) / 2
    cosine, sine = (axis + config.consistency * said).unbind(1)
    angle = torch.atan2(sine, cosine) / 2
    consistent = torch.stack([angle.cos(), angle.sin()], 1)
    return torch.where((consistent * turn).sum(dim=1, keepdim=True) < 0, -consistent, consistent)


class OddViews(NamedTuple):
    """What of photographs changes its sign in the mirror, seen as if all objects faced left."""

    odd: Float[Tensor, "N C"]
    """Of the features."""
    slant: Float[Tensor, " N"]
    """How far views are turned from a view of the side, in radians; positive where the recorded rear is nearer."""
    others: Float[Tensor, "N K"]
    """What else is known of a picture: slant times elevation, and roll."""

    def within(self, degrees: float) -> Bool[Tensor, " N"]:
        """Tell which views are turned from a side view by at most so many degrees, either way."""
        return self.slant.abs() <= math.radians(degrees)

    def along(self, degrees: float) -> Bool[Tensor, " N"]:
        """Tell which views are turned from a view along the axis by at most so many degrees, either way."""
        return self.slant.abs() >= math.pi / 2 - math.radians(degrees)


def odd_views(
    features: Float[Tensor, "2 N C"],
    turn: Float[Tensor, "N 2"],
    coordinates: Float[Tensor, "N 7"],
    poses: PoseCoordinates,
) -> OddViews:
    """Return what changes its sign in the mirror.

    `features` are of photographs and of their mirror images, `turn` holds cosines and sines of the photographs'
    azimuths, `coordinates` their poses.
    """
    sign = torch.where(turn[:, 1:] < 0, -1, 1)
    slant = -turn[:, 0].asin()
    others = torch.cat([slant[:, None] * coordinates[:, 2:3], sign * poses.roll(coordinates)[:, None]], 1)
    return OddViews(sign * (features[0] - features[1]), slant, others)


def facing(views: OddViews, config: EndsConfig, rng: torch.Generator) -> Float[Tensor, " N"]:
    """Split objects by the way they face, from -1 to 1, up to a common sign.

    What is left of the odd features once slants are taken off is split by its leading component at the sides, and from
    there by its mean over those already split, which changes smoothly with the slant, each time for photographs of the
    other folds.
    """
    rest, slant = without_slant(views), views.slant
    turns = (2 * slant[:, None] * torch.arange(_FACING_HARMONICS, device=slant.device)).cos()
    shown = (rest[:, :, None] * turns[:, None]).flatten(1)
    seen, belief = views.within(config.side_reach), torch.zeros_like(slant)
    belief[seen] = (_SHARPNESS * _leading_component(rest[seen])).tanh()
    fold = torch.randperm(len(slant), generator=rng, device=rng.device) % config.folds
    for reach in torch.linspace(math.radians(config.side_reach), math.pi / 2, config.rounds).tolist():
        within, scores = slant.abs() <= reach, torch.zeros_like(slant)
        for held_out in range(config.folds):
            fitted, judged = seen & (fold != held_out), within & (fold == held_out)
            mean = belief[fitted] @ shown[fitted]
            scores[judged] = shown[judged] @ mean / (shown[fitted] @ mean).abs().mean()
        belief, seen = (_SHARPNESS * scores).tanh(), within
    return belief


def without_slant(views: OddViews) -> Float[Tensor, "N C"]:
    """Take off what slants and others explain, and mostly the directions in which slants change features.

    Slants are not known exactly: what is left of their effect may vary more than the way objects face. A direction
    counts as much as slants change it compared with how much features vary without them.
    """
    turns = _odd_harmonics(views.slant, _SLANT_HARMONICS)
    rest, effects = _taken_off(torch.cat([turns, views.others], 1), views.odd)
    changes = effects[:_SLANT_HARMONICS] * turns.std(dim=0)[:, None]
    variation = rest.square().mean() * torch.eye(len(changes), device=rest.device)
    return rest - rest @ changes.T @ torch.linalg.solve(changes @ changes.T + variation, changes)


def facing_with_preferred_end(views: OddViews, side_reach: float) -> Float[Tensor, " N"]:
    """Return whether objects face as recorded, from -1 to 1, if all oblique views show one end.

    It is the end that most views along the axis are recorded with, up to `side_reach` degrees from it. Views as near to
    the side are split by their leading component into halves that face as most of them are recorded.
    """
    slant, side = views.slant, views.within(side_reach)
    belief = slant.sign() * slant[views.along(side_reach)].sign().sum().sign()
    known = torch.cat([_odd_harmonics(slant, _SIDE_HARMONICS), views.others], 1)
    rest, _ = _taken_off(known[side], views.odd[side])
    split = _leading_component(rest)
    belief[side] = (_SHARPNESS * split * split.sign().sum().sign()).tanh()
    return belief


def _missing_views(views: OddViews, config: EndsConfig) -> str | None:
    """Say of which views there are too few to tell ends by; None where there are enough."""
    shown = {"sides": views.within(config.side_reach)}
    if config.shown == "mostly_one":
        shown["ends"] = views.along(config.side_reach)
    counts = {what: int(of_views.sum()) for what, of_views in shown.items()}
    few = (f"{count} photographs show {what}" for what, count in counts.items() if count < _FEWEST)
    return next(few, None)


def opposite_bins(azimuth: Float[Tensor, " N"]) -> tuple[Float[Tensor, "N azimuths"], Float[Tensor, "N azimuths"]]:
    """Return, as distributions over the bins of `azimuths`, the azimuths and the opposite ones."""
    index = (azimuth * (AZIMUTHS / (2 * math.pi))).round().long() % AZIMUTHS
    seen = functional.one_hot(index, AZIMUTHS).to(azimuth.dtype)
    return seen, seen.roll(AZIMUTHS // 2, dims=1)


def _odd_harmonics(slant: Float[Tensor, " N"], count: int) -> Float[Tensor, "N K"]:
    """Return sines of multiples of twice the slant: the axis is the same seen from either of its ends."""
    return (2 * slant[:, None] * torch.arange(1, count + 1, device=slant.device)).sin()


def _leading_component(values: Float[Tensor, "N C"]) -> Float[Tensor, " N"]:
    """Return the leading principal component, in standard deviations."""
    return torch.linalg.svd(values, full_matrices=False).U[:, 0] * math.sqrt(len(values))


def _taken_off(
    known: Float[Tensor, "N D"], values: Float[Tensor, "N K"]
) -> tuple[Float[Tensor, "N K"], Float[Tensor, "D K"]]:
    """Return what a regression on the known leaves of the values, and its coefficients; it has no constant."""
    variance = known.T @ known / len(known)
    penalty = 1e-6 * variance.diagonal().mean() * torch.eye(len(variance), device=known.device)
    effects = torch.linalg.solve(variance + penalty, known.T @ values / len(known))
    return values - known @ effects, effects
