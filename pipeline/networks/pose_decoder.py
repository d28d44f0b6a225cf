"""Pose regressors: an ensemble whose best member is trained, and the student that predicts (paper section 3.2.2)."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from pipeline.geometry.camera import Pose

POSE_EMBEDDING_SIZE = 7


@dataclass(frozen=True)
class PoseRange:
    """Where poses of a category lie: bounds of what is predicted and of the uniform distribution that is explored."""

    elevation: tuple[float, float]
    """Degrees."""
    roll: tuple[float, float]
    """Degrees."""
    center: tuple[float, float]
    """Of the object's centre in the picture, along x and along y, in ndc."""
    scale: tuple[float, float]
    """Size in the picture relative to the camera's own."""


class PoseCoordinates(nn.Module):
    """Translate between poses and the seven coordinates networks regress.

    The coordinates are cosine and sine of the azimuth, which has no seam, then elevation, roll, centre and scale (its
    logarithm) mapped from their ranges to [-1, 1].
    """

    middle: Tensor
    reach: Tensor

    def __init__(self, pose_range: PoseRange) -> None:
        super().__init__()
        bounds = torch.tensor(
            [
                [math.radians(bound) for bound in pose_range.elevation],
                [math.radians(bound) for bound in pose_range.roll],
                pose_range.center,
                pose_range.center,
                [math.log(bound) for bound in pose_range.scale],
            ]
        )
        self.register_buffer("middle", bounds.mean(dim=1), persistent=False)
        self.register_buffer("reach", (bounds[:, 1] - bounds[:, 0]) / 2, persistent=False)

    def embed(self, pose: Pose) -> Float[Tensor, "B 7"]:
        """Return the coordinates of poses. Gradients flow to the poses."""
        others = torch.cat([torch.stack([pose.elevation, pose.roll], 1), pose.center, pose.scale.log()[:, None]], 1)
        turn = torch.stack([pose.azimuth.cos(), pose.azimuth.sin()], 1)
        return torch.cat([turn, (others - self.middle) / self.reach], 1)

    def pose(self, coordinates: Float[Tensor, "B 7"]) -> Pose:
        """Return the poses at coordinates; the first two need not have norm 1. Gradients flow to the coordinates."""
        elevation, roll, x, y, log_scale = (self.middle + self.reach * coordinates[:, 2:]).unbind(1)
        azimuth = torch.atan2(coordinates[:, 1], coordinates[:, 0])
        return Pose(azimuth, elevation, roll, torch.stack([x, y], 1), log_scale.exp())

    def draw(self, count: int, rng: torch.Generator) -> Pose:
        """Draw poses uniformly: azimuth over the circle, the others (scale by its logarithm) over their ranges."""
        uniform = 2 * torch.rand(count, POSE_EMBEDDING_SIZE - 1, generator=rng, device=rng.device) - 1
        turn = math.pi * uniform[:, :1]
        return self.pose(torch.cat([turn.cos(), turn.sin(), uniform[:, 1:]], 1))

    def clamp(self, coordinates: Float[Tensor, "B 7"]) -> Float[Tensor, "B 7"]:
        """Return the nearest coordinates within the ranges, with the azimuth's pair on the unit circle."""
        turn = torch.nn.functional.normalize(coordinates[:, :2], dim=1, eps=1e-6)
        return torch.cat([turn, coordinates[:, 2:].clamp(-1, 1)], 1)


class PoseDecoder(nn.Module):
    """Regress pose coordinates with several heads of one hidden layer (Insafutdinov & Dosovitskiy 2018).

    A single regressor of an ambiguous view settles between the answers. Of the ensemble only the head that explains a
    photograph best is trained on it, so that heads come to stand for different answers; the student, the last head,
    learns to choose.
    """

    def __init__(self, code_size: int, hidden_size: int, ensemble: int) -> None:
        super().__init__()
        self.heads = nn.ModuleList(_head(code_size, hidden_size) for _ in range(ensemble))
        self.student = _head(code_size, hidden_size)

    def ensemble(self, code: Float[Tensor, "B K"]) -> Float[Tensor, "B heads 7"]:
        """Return the coordinates each head of the ensemble predicts."""
        return torch.stack([_bounded(head(code)) for head in self.heads], dim=1)

    def forward(self, code: Float[Tensor, "B K"]) -> Float[Tensor, "B 7"]:
        """Return the coordinates the student predicts."""
        return _bounded(self.student(code))


def _head(code_size: int, hidden_size: int) -> nn.Sequential:
    return nn.Sequential(
        nn.ReLU(), nn.Linear(code_size, hidden_size), nn.ReLU(), nn.Linear(hidden_size, POSE_EMBEDDING_SIZE)
    )


def _bounded(coordinates: Float[Tensor, "B 7"]) -> Float[Tensor, "B 7"]:
    turn = torch.nn.functional.normalize(coordinates[:, :2], dim=1, eps=1e-6)
    return torch.cat([turn, coordinates[:, 2:].tanh()], dim=1)
