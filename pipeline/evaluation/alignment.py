"""The rotation about the vertical axis that takes the learned frame to the frame of the ground truth.

Nothing in the method says which side of a learned shape is its front. One angle per category, fitted on the training
split and fixed from then on, settles it. Elevation needs no such freedom: its distribution is given to the method.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.evaluation.pose import ACCURATE, geodesic_distance, pairwise_distance, pose_error, rotation
from pipeline.geometry.camera import Pose, rotation_from_angles

CANDIDATES = 360
KERNEL_WIDTH = math.radians(15)
CONSTANT_STEP = 5
_CHUNK = 100
"""Pictures whose guesses are held at once: a third of a megabyte each, for 1,000 draws."""


def turn_pose(pose: Pose, angle: float) -> Pose:
    """Express poses in a frame in which the object is turned by `angle` radians about +y."""
    return pose._replace(azimuth=pose.azimuth + angle)


def turn_vertices(vertices: Float[Tensor, "*batch V 3"], angle: float) -> Float[Tensor, "*batch V 3"]:
    """Turn vertices by `angle` radians about +y, from +z towards +x: the camera at azimuth 0 moves to `angle`."""
    x, y, z = vertices.unbind(-1)
    sine, cosine = math.sin(angle), math.cos(angle)
    return torch.stack([cosine * x + sine * z, y, cosine * z - sine * x], dim=-1)


def fit_alignment(truth: Pose, estimate: Pose) -> float:
    """Find the angle in radians for `turn_pose(estimate, angle)` that agrees best with the truth.

    Of 360 angles, the one around which estimates are densest: the sum of exp(-(error / 15 degrees)^2 / 2) is largest.
    Unlike the accuracy itself it is not drawn away from a clear peak by the edge of a second, wrong one.
    """
    angles = torch.arange(CANDIDATES, dtype=torch.float64) * (2 * math.pi / CANDIDATES)
    errors = torch.stack([pose_error(truth, turn_pose(estimate, angle.item())) for angle in angles])
    density = (errors / KERNEL_WIDTH).square().div(-2).exp().sum(1)
    return angles[density.argmax()].item()


def fit_constant(truth: Pose) -> Float[Tensor, "3 3"]:
    """Find the one rotation that is within 30 degrees of most true poses: what ignoring the pictures can reach.

    Azimuth and elevation are searched in steps of 5 degrees; roll is the median one. Of equals, the one of least mean
    error.
    """
    steps = torch.arange(0, 360, CONSTANT_STEP, dtype=torch.float64).deg2rad()
    heights = torch.arange(-90, 91, CONSTANT_STEP, dtype=torch.float64).deg2rad()
    azimuth, elevation = (grid.flatten() for grid in torch.meshgrid(steps, heights, indexing="ij"))
    candidates = rotation_from_angles(azimuth, elevation, truth.roll.double().median().expand_as(azimuth))
    errors = pairwise_distance(candidates, rotation(truth))
    hits = (errors <= ACCURATE).sum(1)
    return candidates[errors.mean(1).masked_fill(hits < hits.max(), math.inf).argmin()]


def chance_errors(truth: Pose, training: Pose, draws: int, rng: torch.Generator) -> Float[Tensor, "draws B"]:
    """Measure the errors of guesses: azimuth uniform over the circle, elevation and roll of a random training picture.

    The azimuths of one picture's draws are evenly spaced from a random start, which leaves less noise than independent
    ones. Knowing the true distribution of elevation and roll makes this chance a little better than blind.
    """
    count = len(truth.azimuth)
    start = torch.rand(count, generator=rng, dtype=torch.float64)
    turns = (torch.arange(draws, dtype=torch.float64)[:, None] / draws + start) * (2 * math.pi)
    donors = torch.randint(len(training.azimuth), (draws, count), generator=rng)
    elevation, roll = training.elevation.double()[donors], training.roll.double()[donors]
    parts = zip(*(part.split(_CHUNK, dim=-1) for part in (turns, elevation, roll)), strict=True)
    errors = []
    for true, angles in zip(rotation(truth).split(_CHUNK), parts, strict=True):
        guesses = rotation_from_angles(*(angle.flatten() for angle in angles))
        errors.append(geodesic_distance(true.expand(draws, *true.shape), guesses.reshape(draws, *true.shape)))
    return torch.cat(errors, dim=1)
