"""Thickness of objects, from vertices through to the other side."""

import torch
from torch import Tensor

from pipeline.geometry.icosphere import icosphere
from pipeline.geometry.thickness import FarSide, far_side, thickness
from pipeline.rendering.lighting import vertex_normals

SPHERE, FACES = icosphere(3)
FLAT = SPHERE * torch.tensor([1.0, 0.1, 1.0])


def far_side_of(vertices: Tensor, faces: Tensor = FACES) -> FarSide:
    return far_side(vertices, faces, vertex_normals(vertices[None], faces)[0])


def test_a_sphere_is_as_thick_as_its_diameter() -> None:
    far = far_side_of(SPHERE)
    torch.testing.assert_close(thickness(SPHERE, far), torch.full((len(SPHERE),), 2.0), atol=0.03, rtol=0)
    torch.testing.assert_close(far.weights.sum(dim=1), torch.ones(len(SPHERE)))
    assert far.weights.min() > -1e-3
    opposite = (SPHERE[far.corners] * far.weights[..., None]).sum(dim=1)
    torch.testing.assert_close(opposite, -SPHERE, atol=0.06, rtol=0)


def test_the_first_way_out_counts() -> None:
    # A second sphere below, which the ways from the first one's top meet later.
    both = torch.cat([SPHERE, SPHERE - torch.tensor([0.0, 3.0, 0.0])])
    far = far_side_of(both, torch.cat([FACES, FACES + len(SPHERE)]))
    torch.testing.assert_close(thickness(both, far), thickness(SPHERE, far_side_of(SPHERE)).repeat(2))


def test_sides_that_change_places_are_thinner_than_nothing() -> None:
    far, top = far_side_of(FLAT), FLAT[:, 1] > 0.08
    before = thickness(FLAT, far)
    through = torch.where(FLAT[:, 1:2] > 0, FLAT - torch.tensor([0.0, 0.3, 0.0]), FLAT)
    after = thickness(through, far)
    assert top.sum() > 50
    assert (before[top] > 0.1).all()
    assert (after[top] < -0.05).all()


def test_thickness_grows_by_what_a_vertex_moves_outwards() -> None:
    far, vertex = far_side_of(FLAT), int(FLAT[:, 1].argmax())
    vertices = FLAT.clone().requires_grad_()
    thickness(vertices, far)[vertex].backward()
    gradient = vertices.grad
    assert gradient is not None
    torch.testing.assert_close(gradient[vertex], -far.inwards[vertex])
    torch.testing.assert_close(gradient[far.corners[vertex]].sum(dim=0), far.inwards[vertex])
    others = torch.ones(len(FLAT), dtype=torch.bool).index_fill(0, torch.tensor([vertex, *far.corners[vertex]]), 0)
    assert not gradient[others].any()


def test_where_no_way_leads_out_there_is_no_thickness() -> None:
    inside_out = far_side_of(SPHERE, FACES.flip(1))
    assert torch.equal(thickness(SPHERE, inside_out), torch.zeros(len(SPHERE)))
    assert torch.equal(thickness(2 * SPHERE, inside_out), torch.zeros(len(SPHERE)))
