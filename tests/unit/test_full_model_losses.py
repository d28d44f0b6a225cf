"""Total variation, view prior and regression to the record."""

import math

import torch

from pipeline.losses.total_variation import total_variation
from pipeline.losses.view_prior import reverse_gradient, view_prior_loss
from pipeline.networks.pose_decoder import PoseRegression
from pipeline.training.candidates import Estimate, Record
from pipeline.training.exploration import Best
from pipeline.training.full_losses import pose_regression


def test_total_variation_of_a_stripe_counts_both_of_its_edges() -> None:
    texture_maps = torch.zeros(1, 3, 8, 8)
    texture_maps[..., 0] = 0.5  # the first column: one edge to the second, one to the last across the seam
    torch.testing.assert_close(total_variation(texture_maps), torch.tensor(2 * 0.5 / 8))


def test_total_variation_does_not_join_the_poles() -> None:
    texture_maps = torch.zeros(1, 3, 8, 8)
    texture_maps[..., 4:, :] = 0.5
    torch.testing.assert_close(total_variation(texture_maps), torch.tensor(0.5 / 7))


def test_view_prior_loss_of_a_discriminator_that_cannot_tell() -> None:
    torch.testing.assert_close(view_prior_loss(torch.zeros(3), torch.zeros(5)), torch.tensor(math.log(2)))
    assert view_prior_loss(torch.full((3,), 9.0), torch.full((3,), -9.0)) < 1e-3


def test_gradient_is_reversed() -> None:
    values = torch.tensor([1.0, 2.0], requires_grad=True)
    assert torch.equal(reverse_gradient(values), values)
    (reverse_gradient(values) * torch.tensor([3.0, -1.0])).sum().backward()
    assert values.grad is not None
    assert torch.equal(values.grad, torch.tensor([-3.0, 1.0]))


def test_only_the_best_head_and_the_student_learn() -> None:
    heads = torch.zeros(2, 3, 9, requires_grad=True)
    student = torch.zeros(2, 9, requires_grad=True)
    shape = torch.zeros(2, 4)
    said = [PoseRegression(*values.split([2, 2, 5], dim=-1)) for values in (student, heads, torch.zeros(2, 9))]
    estimate = Estimate(said[0], said[1], said[2], shape, torch.zeros(2, 3, 4, 4), torch.zeros(2, 3, 4, 4))
    record = Record(torch.tensor([0.6, 0.8, 0.5, 0.5, 0.5, 0.5, 0.5]).expand(2, -1), torch.full((2, 4), -0.5))
    best = Best(record, head=torch.tensor([2, 0]))
    loss = pose_regression(estimate, best)
    # Of the axis a chord of 1 is missing, of the end .36 and .64 squared, of the others .5.
    axis = math.hypot(1.0, 0.1) - 0.1
    torch.testing.assert_close(loss.detach(), torch.tensor(2 * (2 * axis + 2 * 0.5 + 5 * 0.5) / 7))
    loss.backward()
    assert heads.grad is not None
    assert student.grad is not None
    assert torch.equal(heads.grad.abs().sum(dim=2) > 0, torch.tensor([[False, False, True], [True, False, False]]))
    assert torch.equal(student.grad[0].sign(), torch.tensor([-1.0, -1.0, 1.0, *[-1.0] * 6]))
