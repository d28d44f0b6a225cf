import torch

from pipeline.geometry.normalize import fit_unit_cube


def test_longest_side_is_one_and_box_is_centred() -> None:
    vertices = torch.rand(3, 20, 3, generator=torch.Generator().manual_seed(0)) * torch.tensor([1.0, 5.0, 2.0]) + 7
    fitted = fit_unit_cube(vertices)
    lower, upper = fitted.amin(dim=1), fitted.amax(dim=1)
    torch.testing.assert_close((upper - lower).amax(dim=1), torch.ones(3))
    torch.testing.assert_close(lower, -upper, atol=1e-5, rtol=0)


def test_proportions_are_kept() -> None:
    vertices = torch.tensor([[[0.0, 0, 0], [4, 2, 1]]])
    torch.testing.assert_close(fit_unit_cube(vertices)[0, 1], torch.tensor([0.5, 0.25, 0.125]))


def test_gradient() -> None:
    vertices = torch.rand(1, 6, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1)).requires_grad_()
    assert torch.autograd.gradcheck(fit_unit_cube, vertices)
