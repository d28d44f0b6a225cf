"""Pose regressors: an ensemble whose best member is trained, and the student that predicts (paper section 3.2.2)."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from pipeline.networks.pose_coordinates import POSE_COORDINATES


class PoseDecoder(nn.Module):
    """Regress pose coordinates with several heads of one hidden layer (Insafutdinov & Dosovitskiy 2018).

    A single regressor of an ambiguous view settles between the answers. Of the ensemble only the head that explains a
    photograph best is trained on it, so that heads come to stand for different answers; the student, a head of its own,
    learns to choose.
    """

    def __init__(self, code_size: int, hidden_size: int, ensemble: int) -> None:
        super().__init__()
        self.heads = nn.ModuleList(_head(code_size, hidden_size) for _ in range(ensemble))
        self.student = _head(code_size, hidden_size)

    def ensemble(self, code: Float[Tensor, "B K"]) -> Float[Tensor, "B heads 7"]:
        """Return the coordinates each head of the ensemble predicts, within their ranges."""
        return torch.stack([_bounded(head(code)) for head in self.heads], dim=1)

    def forward(self, code: Float[Tensor, "B K"]) -> Float[Tensor, "B 7"]:
        """Return the coordinates the student predicts, within their ranges."""
        return _bounded(self.student(code))


def _head(code_size: int, hidden_size: int) -> nn.Sequential:
    return nn.Sequential(
        nn.ReLU(), nn.Linear(code_size, hidden_size), nn.ReLU(), nn.Linear(hidden_size, POSE_COORDINATES)
    )


def _bounded(coordinates: Float[Tensor, "B 7"]) -> Float[Tensor, "B 7"]:
    turn = nn.functional.normalize(coordinates[:, :2], dim=1, eps=1e-6)
    return torch.cat([turn, coordinates[:, 2:].tanh()], dim=1)
