import torch
from torch import Tensor

from pipeline.geometry.normalize import bounding_box, fit_unit_cube, spread_gradients


def test_longest_side_is_one_and_box_is_centred() -> None:
    vertices = torch.rand(3, 20, 3, generator=torch.Generator().manual_seed(0)) * torch.tensor([1.0, 5.0, 2.0]) + 7
    fitted = fit_unit_cube(vertices)
    lower, upper = fitted.amin(dim=1), fitted.amax(dim=1)
    torch.testing.assert_close((upper - lower).amax(dim=1), torch.ones(3))
    torch.testing.assert_close(lower, -upper, atol=1e-5, rtol=0)


def test_proportions_are_kept() -> None:
    vertices = torch.tensor([[[0.0, 0, 0], [4, 2, 1]]])
    torch.testing.assert_close(fit_unit_cube(vertices)[0, 1], torch.tensor([0.5, 0.25, 0.125]))


def test_gradients_are_the_derivatives_where_all_points_are_moved_or_stretched_alike() -> None:
    shape = torch.rand(1, 30, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1))

    def fitted(moved: Tensor, stretched: Tensor) -> Tensor:
        return fit_unit_cube(stretched.exp() * shape + moved)

    zeros = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(fitted, (zeros, zeros.clone().detach().requires_grad_()))
    _, stretched = torch.autograd.functional.jacobian(fitted, (zeros, zeros))
    assert stretched.sum(dim=-1).abs().max().item() < 1e-12  # or sizes, which no picture shows, would drift


def test_an_outermost_vertex_moves_the_others_no_more_than_its_rim_does() -> None:
    shape = torch.rand(1, 100, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1)).requires_grad_()
    (gradient,) = torch.autograd.grad(fit_unit_cube(shape)[0, 0, 1], shape)
    pull = gradient[0, 1:, 1].abs()
    assert pull.max().item() < 1.5 / 20  # the highest vertex alone would have a half
    assert (pull > 1e-9).sum().item() <= 20  # ten points above, ten below


def test_points_that_are_all_the_same_have_a_box_without_sides() -> None:
    points = torch.ones(1, 4, 2, requires_grad=True)
    center, sides = spread_gradients(bounding_box(points.detach()), points)
    assert center.tolist() == [[[1, 1]]]
    assert sides.tolist() == [[[0, 0]]]
    (gradient,) = torch.autograd.grad(sides.sum(), points)
    assert gradient.abs().max().item() == 0
