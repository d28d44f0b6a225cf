"""Tell the ends of mirror-symmetric objects apart, from what full training has recorded (ours).

The records hold axes and boxes, but which end of its axis a photograph shows is nearly chance: renderings tell
builds apart, not ends (a van's ends are both steep, a saloon's both low). What changes sign in the mirror knows nothing
of build and paint. At the sides it varies most with the way objects face, once all that goes with the slant of their
axes is taken off, and this splits them in two. The rest depends on how they were photographed:

- Both ends equally often. Then slants say nothing of the way objects face, and the split spreads from the sides to ever
  more oblique views.
- Mostly one end, as people show the fronts of cars. Then the ends that records tell at oblique views are builds, and
  to take all of them for the preferred end is right more often. Which half of the sides faces which way say the records
  of sides: at oblique views the nearer end looks taller, and that is what the taller end of a shape explains as well.
  Which end is preferred say records of views along the axis; there nearly all of them, rears too, name the shape's
  blunter end, so this is right for objects whose front is blunter.

Near-by azimuths differ by more than the two ends do, so recorded axes are made consistent with each other first.
What all photographs show, those along the axis too, is judged by a last regression, of the azimuths that follow, on all
features: among photographs whose ends were told by which way they face, builds are the same at both.
"""

import math
from dataclasses import dataclass
from typing import Annotated, Literal

import torch
from jaxtyping import Float, UInt8
from torch import Tensor
from torch.nn import functional
from tqdm import tqdm

from pipeline.distributed import agree, is_first
from pipeline.errors import ConfigError
from pipeline.networks.feature_extractor import FeatureExtractor
from pipeline.networks.pose_coordinates import PoseCoordinates
from pipeline.ranges import Count, NonNegative, Positive, Range, Several
from pipeline.training.azimuths import AZIMUTHS, judge, regress_held_out
from pipeline.training.first_poses import cut_to_box
from pipeline.training.paint import paintless_features

_FEWEST = 50
"""Photographs of sides below which the way they face cannot be told."""
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
    """Parts of full training's iterations before every time, above 0; 1 is right before the last lessons."""
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

    def __post_init__(self) -> None:
        """Raise ConfigError where ends are never told."""
        if not self.after:
            raise ConfigError("ends.after is []; expected at least one part of training")


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

    Boxes, elevations and rolls are the means of the recorded ones and of those that networks read. 0 everywhere where
    too few photographs show sides. Where both ends are shown equally often it is not known which way of facing is left:
    the coordinates of the majority are taken to be right.
    """
    coordinates = torch.cat([recorded[:, :2], (recorded[:, 2:] + read[:, 2:]) / 2], 1)
    images = cut_to_box(photographs / 255, poses, coordinates, config.box_size, poses.roll(coordinates))
    features = paintless_features(images, extractor, config.components, config.repainting_floor, rng)
    turn = consistent_axes(features, recorded[:, :2], config, rng)
    agree([turn])  # or one process might count fewer sides, draw nothing below, and draw other batches from here on
    to_the_right = turn[:, 1:] < 0
    odd = torch.where(to_the_right, -1, 1) * (features[0] - features[1])
    slant = -turn[:, 0].asin()
    if (sides := int((slant.abs() <= math.radians(config.side_reach)).sum())) < _FEWEST:
        if is_first():
            tqdm.write(f"ends stay as they are recorded: {sides} photographs show sides, telling them needs {_FEWEST}")
        return torch.zeros_like(slant)
    roll = torch.where(to_the_right, -1, 1) * poses.roll(coordinates)[:, None]
    others = torch.cat([slant[:, None] * coordinates[:, 2:3], roll], 1)
    if config.shown == "equally":
        belief = facing(odd, slant, others, config, rng)
    else:
        belief = facing_with_preferred_end(odd, slant, others, config)
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


def facing(
    odd: Float[Tensor, "N C"],
    slant: Float[Tensor, " N"],
    others: Float[Tensor, "N K"],
    config: EndsConfig,
    rng: torch.Generator,
) -> Float[Tensor, " N"]:
    """Split objects by the way they face, from -1 to 1, up to a common sign.

    `odd` changes its sign in the mirror, as do the slant (radians; 0 is a side view) and all `others` that are known of
    a picture. What is left is split by its leading component at the sides, and from there by its mean over those
    already split, which changes smoothly with the slant, each time for photographs of the other folds.
    """
    rest = without_slant(odd, slant, others)
    turns = (2 * slant[:, None] * torch.arange(_FACING_HARMONICS, device=slant.device)).cos()
    shown = (rest[:, :, None] * turns[:, None]).flatten(1)
    first = math.radians(config.side_reach)
    seen, belief = slant.abs() <= first, torch.zeros_like(slant)
    belief[seen] = (_SHARPNESS * _leading_component(rest[seen])).tanh()
    fold = torch.randperm(len(slant), generator=rng, device=rng.device) % config.folds
    for reach in torch.linspace(first, math.pi / 2, config.rounds).tolist():
        within, scores = slant.abs() <= reach, torch.zeros_like(slant)
        for held_out in range(config.folds):
            fitted, judged = seen & (fold != held_out), within & (fold == held_out)
            mean = belief[fitted] @ shown[fitted]
            scores[judged] = shown[judged] @ mean / (shown[fitted] @ mean).abs().mean()
        belief, seen = (_SHARPNESS * scores).tanh(), within
    return belief


def without_slant(
    odd: Float[Tensor, "N C"], slant: Float[Tensor, " N"], others: Float[Tensor, "N K"]
) -> Float[Tensor, "N C"]:
    """Take off what slants (radians) and others explain, and mostly the directions in which slants change features.

    Slants are not known exactly: what is left of their effect may vary more than the way objects face. A direction
    counts as much as slants change it compared with how much features vary without them.
    """
    turns = _odd_harmonics(slant, _SLANT_HARMONICS)
    rest, effects = _taken_off(torch.cat([turns, others], 1), odd)
    changes = effects[:_SLANT_HARMONICS] * turns.std(dim=0)[:, None]
    variation = rest.square().mean() * torch.eye(len(changes), device=rest.device)
    return rest - rest @ changes.T @ torch.linalg.solve(changes @ changes.T + variation, changes)


def facing_with_preferred_end(
    odd: Float[Tensor, "N C"], slant: Float[Tensor, " N"], others: Float[Tensor, "N K"], config: EndsConfig
) -> Float[Tensor, " N"]:
    """Return whether objects face as recorded, from -1 to 1, if all oblique views show one end.

    Arguments are as in `facing`, the slant positive where the recorded rear is nearer. The end that oblique views show
    is the one that most views along the axis are recorded with, and of the two halves of the sides that their leading
    component splits, most face as recorded.
    """
    reach = math.radians(config.side_reach)
    side, along = slant.abs() <= reach, slant.abs() >= math.pi / 2 - reach
    belief = slant.sign() * slant[along].sign().sum().sign()
    known = torch.cat([_odd_harmonics(slant, _SIDE_HARMONICS), others], 1)
    rest, _ = _taken_off(known[side], odd[side])
    split = _leading_component(rest)
    belief[side] = (_SHARPNESS * split * split.sign().sum().sign()).tanh()
    return belief


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
