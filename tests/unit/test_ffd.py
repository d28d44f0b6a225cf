import torch
from torch import Tensor

from pipeline.geometry.ffd import CONTROL_POINTS, control_point_weights, deform


def random_vertices() -> Tensor:
    return torch.rand(50, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) - 0.5


def control_points() -> Tensor:
    line = torch.linspace(-0.5, 0.5, 4, dtype=torch.float64)
    return torch.cartesian_prod(line, line, line)


def test_zero_offsets_change_no_bit() -> None:
    vertices = random_vertices().float()
    deformed = deform(vertices, control_point_weights(vertices), torch.zeros(2, CONTROL_POINTS, 3))
    assert torch.equal(deformed, vertices.expand(2, -1, -1))


def test_weights_sum_to_one_and_reproduce_the_vertices() -> None:
    vertices = random_vertices()
    weights = control_point_weights(vertices)
    assert (weights >= 0).all()
    torch.testing.assert_close(weights.sum(dim=1), torch.ones(50, dtype=torch.float64))
    torch.testing.assert_close(weights @ control_points(), vertices)


def test_affine_offsets_deform_affinely() -> None:
    vertices = random_vertices()
    matrix = torch.tensor([[1.5, 0.2, 0], [0, 0.8, -0.1], [0.3, 0, 1.1]], dtype=torch.float64)
    offsets = control_points() @ matrix.T + 0.25 - control_points()
    deformed = deform(vertices, control_point_weights(vertices), offsets[None])
    torch.testing.assert_close(deformed[0], vertices @ matrix.T + 0.25)
