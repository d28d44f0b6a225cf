"""Pose regressors: an ensemble whose best member is trained, and the student that predicts (paper section 3.2.2)."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from pipeline.device import constant
from pipeline.networks.pose_coordinates import POSE_COORDINATES, PoseCoordinates

_QUADRATIC = 0.1
"""Chord of the axis, three degrees of azimuth, below which its error is about quadratic."""


class PoseRegression(NamedTuple):
    """What a head says of poses: the azimuth as an axis and an end of it.

    Opposite sides of an object look alike. A regressor of cosine and sine that cannot tell which of two opposite
    azimuths it sees answers with neither; the axis is the same for both, and the end may stay undecided.
    """

    end: Float[Tensor, "*B 2"]
    """Mean of cosine and sine of the azimuth, short where front or rear is unclear."""
    axis: Float[Tensor, "*B 2"]
    """Cosine and sine of twice the azimuth."""
    others: Float[Tensor, "*B 5"]
    """Pose coordinates but the azimuth's, within their ranges."""

    @property
    def coordinates(self) -> Float[Tensor, "*B 7"]:
        """Join the parts into pose coordinates: of the axis' two directions the one on the side of the end.

        Gradients flow to the axis and to the others, not to the choice of the end.
        """
        azimuth = torch.atan2(self.axis[..., 1], self.axis[..., 0]) / 2
        turn = torch.stack([azimuth.cos(), azimuth.sin()], dim=-1)
        far = (turn * self.end).sum(dim=-1, keepdim=True) < 0
        return torch.cat([torch.where(far, -turn, turn), self.others], dim=-1)

    def mirror(self, poses: PoseCoordinates) -> "PoseRegression":
        """Return what it says of mirror-symmetric objects in the pictures' left-right mirror images."""
        mirrored = poses.mirror(torch.cat([self.end, self.others], dim=-1))
        return PoseRegression(mirrored[..., :2], self.axis * constant((1.0, -1.0), self.axis), mirrored[..., 2:])


class PoseDecoder(nn.Module):
    """Regress poses with several heads of one hidden layer (Insafutdinov & Dosovitskiy 2018).

    A single regressor of an ambiguous view settles between the answers. In a step of full training only the ensemble's
    head that explains a photograph best is trained on it, so that heads come to stand for different answers (lessons
    train all of them); the student, a head of its own, learns to choose.
    """

    def __init__(self, code_size: int, hidden_size: int, ensemble: int) -> None:
        super().__init__()
        self.heads = nn.ModuleList(_head(code_size, hidden_size) for _ in range(ensemble))
        self.student = _head(code_size, hidden_size)

    def ensemble(self, code: Float[Tensor, "B K"]) -> PoseRegression:
        """Return what each head of the ensemble says, in rows of `B heads`."""
        return _parts(torch.stack([head(code) for head in self.heads], dim=1))

    def forward(self, code: Float[Tensor, "B K"]) -> PoseRegression:
        """Return what the student says."""
        return _parts(self.student(code))

    def known_error(self, code: Float[Tensor, "B K"], coordinates: Float[Tensor, "B 7"]) -> Float[Tensor, ""]:
        """Return the mean error of the ensemble's heads plus that of the student, where poses are known."""
        return regression_error(self.ensemble(code), coordinates[:, None]) + regression_error(self(code), coordinates)


def regression_error(regression: PoseRegression, coordinates: Float[Tensor, "*B 7"]) -> Float[Tensor, ""]:
    """Compare what heads say with pose coordinates: return the mean error of one, the azimuth's two as axis and as end.

    The axis' error is the chord between the directions, which has no minimum but the right one (absolute errors of
    cosine and sine have), quadratic near zero: a head that won is compared with itself up to rounding, along which
    the chord itself would pull it with full force. The end's is squared, so that its best answer is the
    mean of what may be.
    """
    turn, others = coordinates[..., :2], coordinates[..., 2:]
    cosine, sine = turn.unbind(-1)
    axis = torch.stack([cosine**2 - sine**2, 2 * cosine * sine], dim=-1)
    of_axis = ((regression.axis - axis).square().sum(dim=-1) + _QUADRATIC**2).sqrt().mean() - _QUADRATIC
    of_end = (regression.end - turn).square().mean()
    return (2 * of_axis + 2 * of_end + 5 * (regression.others - others).abs().mean()) / 7


def _head(code_size: int, hidden_size: int) -> nn.Sequential:
    return nn.Sequential(
        nn.ReLU(), nn.Linear(code_size, hidden_size), nn.ReLU(), nn.Linear(hidden_size, POSE_COORDINATES + 2)
    )


def _parts(regressed: Float[Tensor, "*B 9"]) -> PoseRegression:
    end, axis, others = regressed.split([2, 2, POSE_COORDINATES - 2], dim=-1)
    return PoseRegression(end, functional.normalize(axis, dim=-1, eps=1e-6), others.tanh())
