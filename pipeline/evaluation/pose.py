"""Errors of estimated viewpoints: geodesic rotation error, its modes, and the side seen."""

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor

from pipeline.geometry.camera import Pose, rotation_from_angles

ACCURATE = math.pi / 6
MODES = ("correct", "flipped", "mirrored", "front_back", "other")


def geodesic_distance(
    first: Float[Tensor, "*batch 3 3"], second: Float[Tensor, "*batch 3 3"]
) -> Float[Tensor, "*batch"]:
    """Measure the angle of the rotation between two rotations, ||log(first second^T)||_F / sqrt(2), in radians.

    Range [0, pi]. Sine and cosine are both used, so that angles near 0 and near pi keep their precision.
    """
    relative = first.double() @ second.double().transpose(-1, -2)
    axis = torch.stack(
        [
            relative[..., 2, 1] - relative[..., 1, 2],
            relative[..., 0, 2] - relative[..., 2, 0],
            relative[..., 1, 0] - relative[..., 0, 1],
        ],
        dim=-1,
    )
    trace = relative.diagonal(dim1=-2, dim2=-1).sum(-1)
    return torch.atan2(axis.norm(dim=-1), trace - 1)


def pairwise_distance(first: Float[Tensor, "A 3 3"], second: Float[Tensor, "B 3 3"]) -> Float[Tensor, "A B"]:
    """Measure the geodesic distance of every rotation to every other, in radians and precise to about 1e-7.

    The trace of a b^T is the inner product of a and b, so one matrix product does for all pairs.
    """
    trace = first.double().flatten(1) @ second.double().flatten(1).T
    return ((trace - 1) / 2).clamp(-1, 1).acos()


def rotation(pose: Pose) -> Float[Tensor, "B 3 3"]:
    """Return the rotation of each pose from world to camera, in float64."""
    return rotation_from_angles(pose.azimuth.double(), pose.elevation.double(), pose.roll.double())


def pose_error(truth: Pose, estimate: Pose) -> Float[Tensor, " B"]:
    """Measure the geodesic error of each estimated rotation in radians; position and scale do not count."""
    return geodesic_distance(rotation(truth), rotation(estimate))


def error_mode(truth: Pose, estimate: Pose) -> Int[Tensor, " B"]:
    """Name the mistake of each estimate, as an index into MODES.

    `correct`: within 30 degrees of the truth. Otherwise the estimate is within 30 degrees of, and nearest to, the truth
    turned by 180 degrees about the vertical axis (`flipped`), the truth of the mirrored picture, azimuth -> -azimuth
    and roll -> -roll (`mirrored`), or the truth with front and back exchanged, azimuth -> 180 degrees - azimuth
    (`front_back`); or it is `other`.
    """
    mistakes = [
        truth._replace(azimuth=truth.azimuth + math.pi),
        truth._replace(azimuth=-truth.azimuth, roll=-truth.roll),
        truth._replace(azimuth=math.pi - truth.azimuth),
    ]
    distance, nearest = torch.stack([pose_error(mistake, estimate) for mistake in mistakes]).min(0)
    mode = torch.where(distance <= ACCURATE, nearest + 1, MODES.index("other"))
    return torch.where(pose_error(truth, estimate) <= ACCURATE, MODES.index("correct"), mode)


def seen_side(azimuth: Float[Tensor, " B"]) -> Int[Tensor, " B"]:
    """Return the side of the object that faces the camera: 0 front, 1 the +x side, 2 back, 3 the -x side."""
    return (azimuth / (math.pi / 2)).round().long() % 4
