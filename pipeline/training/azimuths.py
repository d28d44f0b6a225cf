"""Make votes for the azimuths of photographs consistent with each other (ours).

Votes tell an object's axis well, but hardly its front from its rear. They are turned into probabilities in which
opposite azimuths are balanced. Then, in each of a few rounds:

1. A linear regression from features to the probabilities is fitted on some photographs, and judges the others.
2. Its judgements, balanced as the votes were, replace the probabilities.

A regression that has to explain so faint a signal as the ends takes what it finds: white cars would drive forwards and
dark ones away. Paint says nothing of azimuths, so features are measured in units of how much repainting changes them,
and opposite azimuths get photographs of the same mean colours. How many photographs share an axis stays as the votes
say (horses show their sides); were it free, azimuths would gather in clusters. How many of these show the front is free
within bounds: opposite azimuths have the same mean score, and neither gets less of their axis's probability than
`smaller_end`, or one end might take all photographs. Both means are those of an azimuth and of its mirror image
together.

Azimuths are bins of the circle: row i of `N azimuths` is a photograph's distribution over them.
"""

import math
from dataclasses import dataclass
from typing import Annotated

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from pipeline.networks.feature_extractor import FeatureExtractor
from pipeline.ranges import Count, Natural, NonNegative, Positive, Range, Several
from pipeline.training.paint import mean_colors, paintless_features

AZIMUTHS = 72
"""Bins; an even number, so that opposite azimuths are bins too."""
_HARMONICS = 4
"""Frequencies, a cosine and a sine each, in which azimuths are regressed; the highest repeats every 90 degrees."""
_BALANCING_STEPS = 60
"""A fixed number, without a test of convergence; each goes but half of a Newton-like step."""


@dataclass(frozen=True)
class ConsensusConfig:
    """Settings of the consensus."""

    rounds: Natural
    """Of regression; 0 keeps the votes."""
    smaller_end: Annotated[float, Range(0, 0.5)]
    """Least part of an axis's probability, over all photographs, that either end gets; 0 leaves it free. Where
    photographs say little of ends, more of them may still be likelier to show the same one."""
    components: Count
    """Principal components of the features that the regression sees."""
    repainting_floor: NonNegative
    """Added to the variances under repainting, as a part of their mean."""
    ridge: NonNegative
    """Penalty of the regression, as a part of a component's mean variance."""
    folds: Several
    """Parts of the photographs that are judged in turn by a regression fitted to the others."""
    sharpness: Positive
    """Factor on standardised scores that makes them logarithms of probabilities."""


@torch.no_grad()
def agree_on_azimuths(
    votes: Float[Tensor, "N azimuths"],
    images: Float[Tensor, "N 3 H W"],
    extractor: FeatureExtractor,
    config: ConsensusConfig,
    rng: torch.Generator,
) -> Float[Tensor, "N azimuths"]:
    """Return the probabilities of azimuths that follow from votes, given as logarithms, for mirror-symmetric objects.

    `images` show the photographs cut to the object, so that a position means the same part in all of them.
    """
    colors, scores = mean_colors(images), config.sharpness * standardize(votes)
    share = symmetric_share(scores)
    probabilities = balance(scores, colors, share, config.smaller_end)
    if config.rounds == 0:
        return probabilities
    features = paintless_features(images, extractor, config.components, config.repainting_floor, rng)
    for _ in range(config.rounds):
        scores = config.sharpness * standardize(judge(features, probabilities, config.ridge, config.folds, rng))
        probabilities = balance(scores, colors, share, config.smaller_end)
    return probabilities


def join_votes(votes: Float[Tensor, "generators N azimuths"]) -> Float[Tensor, "N azimuths"]:
    """Add the votes of several generators, which learned from the same photographs, in the frame of the first.

    Which end of a learned shape is its front is chance, and without symmetry how it stands at all. So generators are
    added in the order in which they agree with those before them, each turned as it then agrees best.
    """
    joined, *others = (standardize(scores) for scores in votes)
    while others:
        agreements = torch.stack([_agreements(joined, scores) for scores in others])
        index, turn = divmod(int(agreements.argmax()), AZIMUTHS)
        joined = joined + others.pop(index).roll(turn, dims=1)
    return joined


def bins(device: torch.device) -> Float[Tensor, " azimuths"]:
    """Return the azimuths of the bins in radians."""
    return torch.arange(AZIMUTHS, device=device) * (2 * math.pi / AZIMUTHS)


def mirrored(values: Float[Tensor, "... azimuths"]) -> Float[Tensor, "... azimuths"]:
    """Return what belongs to the mirror images: the values at the negated azimuths."""
    return values.flip(-1).roll(1, -1)


def standardize(scores: Float[Tensor, "N azimuths"]) -> Float[Tensor, "N azimuths"]:
    """Take off each photograph's mean and divide by the deviation of all."""
    scores = scores - scores.mean(dim=1, keepdim=True)
    return scores / scores.std()


def symmetric_share(scores: Float[Tensor, "N azimuths"]) -> Float[Tensor, " azimuths"]:
    """Return how many photographs the scores give each azimuth, averaged over opposite and mirrored ones."""
    share = scores.softmax(dim=1).mean(dim=0)
    share = share + _opposite(share)
    return (share + mirrored(share)) / 4


def balance(
    scores: Float[Tensor, "N azimuths"],
    colors: Float[Tensor, "N K"],
    share: Float[Tensor, " azimuths"],
    smaller_end: float,
) -> Float[Tensor, "N azimuths"]:
    """Turn scores into probabilities that give axes their shares, and opposite azimuths the same mean colours.

    Each azimuth's score gets an affine function of the colours, found by Newton-like steps, after what makes its mean
    differ from that of the opposite azimuth is taken off: half of the difference, as the opposite azimuth gives way by
    the other half. Both are averaged with those of the mirror image, and half a Newton step is taken; each halves once
    more. Neither of two opposite azimuths keeps less than the part `smaller_end` of their axis.
    """
    excess_of_mean = scores.mean(dim=0) - _opposite(scores.mean(dim=0))
    scores = scores - (excess_of_mean + mirrored(excess_of_mean)) / 4
    colors = torch.cat([colors.new_ones(len(colors), 1), colors], 1)
    covariance = colors.T @ colors / len(colors)
    correction = colors.new_zeros(colors.shape[1], scores.shape[1])
    for _ in range(_BALANCING_STEPS):
        probabilities = (scores + colors @ correction).softmax(dim=1)
        sums = colors.T @ probabilities / len(colors)
        step = torch.linalg.solve(covariance, _excess(sums, share, smaller_end)) / share
        correction = correction - (step + mirrored(step)) / 4
    return (scores + colors @ correction).softmax(dim=1)


def _excess(
    sums: Float[Tensor, "K azimuths"], share: Float[Tensor, " azimuths"], smaller_end: float
) -> Float[Tensor, "K azimuths"]:
    """Return what azimuths have too much of.

    In row 0 of photographs: beyond the share of their axis, and beyond an end's largest part of it. In the others of
    colours: beyond the mean of both ends.
    """
    taken = sums[0]
    axis = taken + _opposite(taken)
    end = taken / axis
    of_photographs = axis / 2 - share + 2 * share * (end - end.clamp(smaller_end, 1 - smaller_end))
    of_colors = (sums[1:] - _opposite(sums[1:])) / 2
    return torch.cat([of_photographs[None], of_colors])


def judge(
    features: Float[Tensor, "2 N components"],
    probabilities: Float[Tensor, "N azimuths"],
    ridge: float,
    folds: int,
    rng: torch.Generator,
) -> Float[Tensor, "N azimuths"]:
    """Return scores of azimuths by ridge regressions fitted to the other folds.

    Regressed are the first Fourier coefficients of the probabilities; a mirror image has those of the negated azimuth.
    """
    azimuths = bins(probabilities.device)[:, None] * torch.arange(1, _HARMONICS + 1, device=probabilities.device)
    waves = torch.cat([azimuths.cos(), azimuths.sin()], 1)
    targets = torch.stack([probabilities, mirrored(probabilities)]) @ waves
    here, there = regress_held_out(features, targets, ridge, folds, rng) @ waves.T
    return here + mirrored(there)


def regress_held_out(
    features: Float[Tensor, "2 N components"],
    targets: Float[Tensor, "2 N K"],
    ridge: float,
    folds: int,
    rng: torch.Generator,
) -> Float[Tensor, "2 N K"]:
    """Return what ridge regressions, fitted to the other folds, say of photographs and of their mirror images.

    They have no constant and are fitted to both images, which are in the same one of the random folds.
    """
    penalty = ridge * features.var() * torch.eye(features.shape[2], device=features.device)
    fold = torch.randperm(features.shape[1], generator=rng, device=rng.device) % folds
    said = torch.zeros_like(targets)
    for held_out in range(folds):
        seen, wanted = (values[:, fold != held_out].flatten(0, 1) for values in (features, targets))
        weights = torch.linalg.solve(seen.T @ seen / len(seen) + penalty, seen.T @ wanted / len(seen))
        said[:, fold == held_out] = features[:, fold == held_out] @ weights
    return said


def _agreements(first: Float[Tensor, "N azimuths"], second: Float[Tensor, "N azimuths"]) -> Float[Tensor, " azimuths"]:
    """Correlate scores, beyond what they say of all photographs, with others turned by every azimuth: from -1 to 1."""
    first, second = (functional.normalize((scores - scores.mean(dim=0)).flatten(), dim=0) for scores in (first, second))
    second = second.unflatten(0, (-1, AZIMUTHS))
    return torch.stack([first @ second.roll(turn, dims=1).flatten() for turn in range(AZIMUTHS)])


def _opposite(values: Float[Tensor, "... azimuths"]) -> Float[Tensor, "... azimuths"]:
    return values.roll(values.shape[-1] // 2, -1)
