"""Multi-view consistency: whether an object, seen from commanded azimuths, stays one object and turns as commanded.

The same protocol serves every method that can draw its objects from any side (docs/decisions/baselines.md).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from pipeline.errors import DataError
from pipeline.evaluation.alignment import fit_alignment
from pipeline.evaluation.artifacts import Reconstructions, render_tuned
from pipeline.evaluation.pose import ACCURATE
from pipeline.evaluation.statistics import Figures, accuracy_figure, mean_figure
from pipeline.geometry.camera import level_pose
from pipeline.losses.image_distance import feature_distance
from pipeline.networks.feature_extractor import FeatureExtractor
from pipeline.networks.full_model import FullModel
from pipeline.ranges import Count, Elevation, Positive, Range, Several

GRID = 4
"""Positions a side that feature maps are pooled to: coarse enough for a linear regression, and cheap to keep."""


@dataclass(frozen=True)
class MultiviewConfig:
    """How objects are looked at, and how azimuths are read off their pictures."""

    objects: Several
    """How many are looked at, from the start of the test split."""
    step: Annotated[int, Range(1, 359)]
    """Degrees of azimuth between neighbouring views, from 0 to less than a full turn."""
    elevation: Elevation
    """Of all views, in degrees."""
    ridge: Positive
    """Regularization of the azimuth regressor, as a share of the mean squared norm of its features."""
    examples: Count
    """Objects in the picture of a baseline's views."""

    def azimuths(self) -> Float[Tensor, " K"]:
        """List the commanded azimuths in radians."""
        return torch.arange(0, 360, self.step).float().deg2rad()


def evaluate_views(
    found: Reconstructions, model: FullModel, extractor: FeatureExtractor, config: MultiviewConfig, batch_size: int
) -> Figures:
    """Measure a run's fine-tuned objects, with what its own pose network reads off their views as `own_network`."""
    views = render_views(found, model, config)
    figures = multiview_figures(views, extractor, config, batch_size)
    return figures | {"own_network": student_figures(views, model, config)}


def render_views(found: Reconstructions, model: FullModel, config: MultiviewConfig) -> Float[Tensor, "B K 3 H W"]:
    """Render fine-tuned objects where they are in their photographs, with their backgrounds, from all azimuths."""
    chosen, settings = slice(config.objects), model.config
    pose = found.tuned.pose.at(chosen)
    pose = pose._replace(elevation=torch.full_like(pose.elevation, math.radians(config.elevation)))
    poses = (pose._replace(azimuth=azimuth.expand_as(pose.azimuth)) for azimuth in config.azimuths())
    views = [render_tuned(found, chosen, turned, settings.framing, settings.renderer) for turned in poses]
    return torch.stack(views, dim=1)


def multiview_figures(
    views: Float[Tensor, "B K 3 H W"], extractor: FeatureExtractor, config: MultiviewConfig, batch_size: int
) -> Figures:
    """Measure any method's pictures of objects from the commanded azimuths.

    `acc_pi6` and `error_degrees`: azimuths that a ridge regression reads off the pictures, learned from half of the
    objects and tested on the others, both ways round. `identity_drift`: distance of neighbouring views of an object
    over the distance of different objects seen alike; 1 where an object is no more like itself than like another.
    Under `chance` azimuths are guessed and neighbouring views are of different objects; at steps of 50 degrees one
    constant azimuth is within 30 degrees of two views in eight. All figures are means over objects, n counts objects.
    Raises DataError for fewer than two objects, and for objects that are all the same.
    """
    if len(views) < 2:
        raise DataError("multi-view consistency compares objects, but there is only one; fine-tune two photographs")
    maps = _describe(views.flatten(0, 1), extractor, batch_size)
    azimuths = config.azimuths().expand(views.shape[:2])
    grids = torch.cat([layer.flatten(1) for layer in maps], dim=1).unflatten(0, azimuths.shape)
    figures = azimuth_figures(azimuths, read_azimuths(grids, azimuths, config.ridge))
    pooled = [layer.mean((2, 3), keepdim=True).unflatten(0, azimuths.shape) for layer in maps]
    figures["identity_drift"], guessed_drift = _identity_drift(pooled)
    guessed = {"acc_pi6": ACCURATE / math.pi, "n": len(views), "standard_error": 0.0}
    return figures | {"chance": {**guessed, "identity_drift": guessed_drift}}


@torch.no_grad()
def student_figures(views: Float[Tensor, "B K 3 H W"], model: FullModel, config: MultiviewConfig) -> Figures:
    """Measure the azimuths that a run's own pose network reads off views, up to one angle that suits them best."""
    coordinates = torch.stack([model.read_poses(images) for images in views.unbind(1)], dim=1)
    read = torch.atan2(coordinates[..., 1], coordinates[..., 0])
    azimuths = config.azimuths().expand(views.shape[:2])
    commanded, said = (level_pose(turns.flatten(), torch.zeros_like(turns.flatten())) for turns in (azimuths, read))
    offset = fit_alignment(commanded, said)
    return azimuth_figures(azimuths, read + offset)


def read_azimuths(
    features: Float[Tensor, "B K C"], azimuths: Float[Tensor, "B K"], ridge: float
) -> Float[Tensor, "B K"]:
    """Read azimuths in radians off features: each half of the objects by a regression on the other half.

    A ridge regression of sine and cosine on standardized features, in its dual form and in closed form: nothing to
    train, so that no method can be favoured by tuning.
    """
    read = torch.zeros_like(azimuths)
    for half in (0, 1):
        known, asked = features[half::2].flatten(0, 1).double(), features[1 - half :: 2].flatten(0, 1).double()
        spread, middle = torch.std_mean(known, dim=0)
        known, asked = ((part - middle) / spread.clamp_min(1e-6) for part in (known, asked))
        turns = azimuths[half::2].flatten().double()
        targets = torch.stack([turns.sin(), turns.cos()], dim=1)
        center = targets.mean(0)  # steps that do not divide the circle leave one
        kernel = known @ known.T
        kernel.diagonal().add_(ridge * kernel.diagonal().mean())
        sine, cosine = (asked @ known.T @ torch.linalg.solve(kernel, targets - center) + center).unbind(1)
        read[1 - half :: 2] = torch.atan2(sine, cosine).view_as(read[1 - half :: 2]).to(read)
    return read


def azimuth_figures(azimuths: Float[Tensor, "B K"], read: Float[Tensor, "B K"]) -> Figures:
    """Summarize errors of azimuths: the fraction within 30 degrees, and the mean error in degrees (chance: 90)."""
    errors = (read - azimuths + math.pi).remainder(2 * math.pi).sub(math.pi).abs()
    return {
        **accuracy_figure((errors <= ACCURATE).double().mean(1)),
        "error_degrees": mean_figure(errors.rad2deg().mean(1)),
    }


def _identity_drift(pooled: Sequence[Float[Tensor, "B K _ 1 1"]]) -> tuple[Figures, Figures]:
    """Return the drift between neighbouring views of one object, and of one object and the next."""
    others = [layer.roll(1, dims=0) for layer in pooled]
    before, after = ([layer[:, part] for layer in pooled] for part in (slice(None, -1), slice(1, None)))
    between = _distances(pooled, others).mean()
    if between == 0:
        raise DataError("identity drift compares different objects, but from each side all of them look exactly alike")
    drift = _distances(before, after).mean(1) / between
    shuffled = _distances(before, [layer[:, 1:] for layer in others]).mean(1) / between
    return mean_figure(drift), mean_figure(shuffled)


def _distances(
    first: Sequence[Float[Tensor, "B K _ 1 1"]], second: Sequence[Float[Tensor, "B K _ 1 1"]]
) -> Float[Tensor, "B K"]:
    one, other = ([layer.flatten(0, 1) for layer in layers] for layers in (first, second))
    return feature_distance(one, other).view(first[0].shape[:2])


@torch.no_grad()
def _describe(
    images: Float[Tensor, "B 3 H W"], extractor: FeatureExtractor, batch_size: int
) -> list[Float[Tensor, "B _ 4 4"]]:
    """Return feature maps pooled to 4x4: coarse enough for a linear regression, and cheap to keep."""
    layers = zip(*(extractor(batch) for batch in images.split(batch_size)), strict=True)
    return [torch.cat([functional.adaptive_avg_pool2d(batch, GRID) for batch in layer]) for layer in layers]
