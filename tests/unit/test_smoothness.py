import math

import pytest
import torch
from torch import Tensor

from pipeline.geometry.icosphere import icosphere
from pipeline.losses.smoothness import SmoothnessConfig, smoothness

TETRAHEDRON = torch.tensor([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
REGULAR = torch.tensor([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], dtype=torch.float64)


def only(**weights: float) -> SmoothnessConfig:
    zero = dict.fromkeys(SmoothnessConfig.__dataclass_fields__, 0.0)
    return SmoothnessConfig(**(zero | weights))


def naive_terms(vertices: Tensor, faces: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return the sum and the sum of squares of the Laplacian's norms and of the angles, by loops."""
    neighbours = {i: set() for i in range(len(vertices))}
    normals = []
    for face in faces.tolist():
        for i in face:
            neighbours[i] |= set(face) - {i}
        a, b, c = vertices[face]
        normals.append(torch.nn.functional.normalize(torch.linalg.cross(b - a, c - a), dim=0))
    norms = torch.stack([(vertices[i] - vertices[list(near)].mean(dim=0)).norm() for i, near in neighbours.items()])
    pairs = [
        (i, j)
        for i, first in enumerate(faces.tolist())
        for j, second in enumerate(faces.tolist())
        if i < j and len(set(first) & set(second)) == 2
    ]
    angles = torch.stack([torch.acos((normals[i] @ normals[j]).clamp(-1, 1)) for i, j in pairs])
    return norms.sum(), norms.square().sum(), angles.sum(), angles.square().sum()


@pytest.fixture
def rough_sphere() -> tuple[Tensor, Tensor]:
    vertices, faces = icosphere(1)
    noise = torch.randn(2, len(vertices), 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    return vertices.double() / 2 + 0.05 * noise, faces


def test_each_term_equals_the_naive_loops(rough_sphere: tuple[Tensor, Tensor]) -> None:
    vertices, faces = rough_sphere
    for b in range(2):
        norm, norm_squared, angle, angle_squared = naive_terms(vertices[b], faces)
        terms = {
            "laplacian_squared_weight": norm_squared,
            "laplacian_hinge_weight": norm**2,
            "angle_squared_weight": angle_squared,
            "angle_hinge_weight": angle**2,
        }
        for name, expected in terms.items():
            torch.testing.assert_close(smoothness(vertices, faces, only(**{name: 1.0}))[b], expected, rtol=1e-6, atol=0)


def test_angles_of_regular_tetrahedron() -> None:
    expected = 6 * math.acos(-1 / 3) ** 2
    loss = smoothness(REGULAR[None], TETRAHEDRON.flip(1), only(angle_squared_weight=1.0))
    torch.testing.assert_close(loss.item(), expected)


def test_amounts_within_the_tolerance_cost_nothing(rough_sphere: tuple[Tensor, Tensor]) -> None:
    vertices, faces = rough_sphere
    config = only(laplacian_hinge_weight=1.0, laplacian_tolerance=1e3, angle_hinge_weight=1.0, angle_tolerance=1e3)
    assert smoothness(vertices, faces, config).tolist() == [0, 0]


def test_what_exceeds_the_tolerance_costs_its_square(rough_sphere: tuple[Tensor, Tensor]) -> None:
    vertices, faces = rough_sphere
    norm, _, angle, _ = naive_terms(vertices[0], faces)
    for kind, amount in (("laplacian", norm), ("angle", angle)):
        config = only(**{f"{kind}_hinge_weight": 1.0, f"{kind}_tolerance": amount.item() / 3})
        found = smoothness(vertices[:1], faces, config)[0]
        torch.testing.assert_close(found, (amount * 2 / 3) ** 2, rtol=1e-6, atol=0)


def test_gradient(rough_sphere: tuple[Tensor, Tensor]) -> None:
    vertices, faces = rough_sphere
    config = SmoothnessConfig(1.0, 1.0, 0.1, 1.0, 0.01, 0.1)
    assert torch.autograd.gradcheck(lambda v: smoothness(v, faces, config), vertices[:1].requires_grad_())


def test_gradient_is_finite_on_collapsed_polygons() -> None:
    vertices, faces = icosphere(1)
    flattened = vertices * torch.tensor([1.0, 0.0, 1.0])
    collapsed = torch.zeros_like(vertices)
    batch = torch.stack([flattened, collapsed]).requires_grad_()
    loss = smoothness(batch, faces, SmoothnessConfig(1.0, 1.0, 0.0, 1.0, 1.0, 0.0))
    loss.sum().backward()
    assert loss.isfinite().all()
    assert batch.grad is not None
    assert batch.grad.isfinite().all()
