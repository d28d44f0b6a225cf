"""The pose section of a run's metrics, with what chance and a constant answer reach beside it."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.evaluation.alignment import chance_errors, fit_constant
from pipeline.evaluation.pose import ACCURATE, MODES, error_mode, geodesic_distance, pose_error, rotation, seen_side
from pipeline.evaluation.statistics import Columns, Figures, accuracy_figure, mean_figure, median_figure
from pipeline.geometry.camera import Pose


def angle_columns(pose: Pose) -> Columns:
    """List azimuth, elevation and roll in degrees in [-180, 180)."""
    return {name: _degrees(getattr(pose, name)) for name in ("azimuth", "elevation", "roll")}


def pose_columns(truth: Pose, estimate: Pose) -> Columns:
    """Compare aligned estimates with the truth, one row a picture: angles and errors in degrees, mode as an index."""
    return {
        **angle_columns(estimate),
        "rotation_error": torch.rad2deg(pose_error(truth, estimate)),
        "error_mode": error_mode(truth, estimate),
    }


def pose_figures(truth: Pose, estimate: Pose, rng: torch.Generator) -> Figures:
    """Summarize aligned estimates: accuracy, median error, the modes of failure, and the side seen.

    `seen_side` is the fraction of pictures whose nearest side (front, left, back, right) is right; `front_or_side` asks
    only whether the object is seen lengthwise or from a side, so that flipped and mirrored estimates count as right.
    """
    modes = error_mode(truth, estimate)
    true_side, side = seen_side(truth.azimuth), seen_side(estimate.azimuth)
    figures = error_figures(pose_error(truth, estimate), rng)
    for index, name in enumerate(MODES[1:], start=1):
        figures[name] = mean_figure(modes == index)
    figures["seen_side"] = mean_figure(side == true_side)
    figures["front_or_side"] = mean_figure(side % 2 == true_side % 2)
    return figures


def error_figures(errors: Float[Tensor, " B"], rng: torch.Generator) -> Figures:
    """Summarize geodesic errors in radians: fraction within 30 degrees (n, standard error beside it), and median."""
    return {
        **accuracy_figure(errors <= ACCURATE),
        "median_error_degrees": median_figure(torch.rad2deg(errors), rng),
    }


def baseline_figures(truth: Pose, training: Pose, draws: int, rng: torch.Generator) -> dict[str, Figures]:
    """Measure what needs no picture: `chance` guesses azimuth, `constant` always gives the training split's best pose.

    For chance, n counts pictures, the median is that of all draws of all pictures, and standard errors are those of the
    pictures' hit rates and median errors.
    """
    guesses = chance_errors(truth, training, draws, rng)
    errors = torch.rad2deg(guesses)
    median = median_figure(errors.quantile(0.5, dim=0), rng)
    median["value"] = errors.median().item()
    constant = geodesic_distance(rotation(truth), fit_constant(training).expand(len(truth.azimuth), 3, 3))
    return {
        "chance": {
            **accuracy_figure((guesses <= ACCURATE).double().mean(0)),
            "median_error_degrees": median,
        },
        "constant": error_figures(constant, rng),
    }


def _degrees(angle: Float[Tensor, " B"]) -> Float[Tensor, " B"]:
    return torch.rad2deg((angle + math.pi) % (2 * math.pi) - math.pi)
