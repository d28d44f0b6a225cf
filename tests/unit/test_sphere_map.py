import math

import pytest
import torch
from torch import Tensor
from torch.nn import functional

from pipeline.geometry.halves import border_loop, cut_half
from pipeline.geometry.icosphere import icosphere
from pipeline.geometry.sphere_map import (
    SphereMapConfig,
    _adjacency,
    _unfold,
    area_distortion,
    map_to_sphere,
    solid_angles,
)
from tests.deformed_spheres import SHAPES, deformed_sphere

CONFIG = SphereMapConfig(iterations=60, correction=0.5)


def map_half(vertices: Tensor, faces: Tensor, config: SphereMapConfig) -> Tensor:
    loop = border_loop(faces)
    side = torch.ones(len(vertices), dtype=torch.int64).index_fill(0, loop, 0)
    return map_to_sphere(vertices, faces, loop, side, config)


def test_octant_is_an_eighth_of_the_sphere() -> None:
    angles = solid_angles(torch.eye(3), torch.tensor([[0, 1, 2], [0, 2, 1]]))
    torch.testing.assert_close(angles, torch.tensor([math.pi / 2, -math.pi / 2]))


def test_sphere_is_mapped_to_itself() -> None:
    directions, faces = icosphere(3)
    vertices, faces = cut_half(directions, faces, directions)
    mapped = map_half(vertices, faces, CONFIG).float()
    assert (mapped - vertices).norm(dim=1).max() < 0.12
    assert area_distortion(vertices, faces, mapped) < 1.03


@pytest.mark.parametrize("name", SHAPES)
def test_map_is_one_to_one_and_truer_than_a_plain_embedding(name: str) -> None:
    vertices, faces, directions = deformed_sphere(name)
    vertices, faces = cut_half(vertices.double(), faces, directions)
    mapped = map_half(vertices, faces, CONFIG)
    plain = map_half(vertices, faces, SphereMapConfig(iterations=1, correction=0.0))
    # No triangle is flipped and together they cover the hemisphere once: the map is one-to-one.
    angles = solid_angles(mapped, faces)
    assert (angles > 0).all()
    torch.testing.assert_close(angles.sum().item(), 2 * math.pi)
    torch.testing.assert_close(mapped.norm(dim=1), torch.ones(len(mapped), dtype=torch.float64))
    assert (mapped[border_loop(faces), 0] == 0).all()
    assert area_distortion(vertices, faces, mapped) < 0.9 * area_distortion(vertices, faces, plain)


def test_directions_point_where_the_surface_is() -> None:
    vertices, faces, directions = deformed_sphere("car")
    half_vertices, half_faces = cut_half(vertices.double(), faces, directions)
    mapped = map_half(half_vertices, half_faces, CONFIG)
    front, top = half_vertices[:, 2].argmax(), half_vertices[:, 1].argmax()
    assert mapped[front, 2] > 0.6
    assert mapped[top, 1] > 0.6


def test_folded_map_has_infinite_distortion() -> None:
    vertices, faces = icosphere(1)
    folded = vertices.clone()
    folded[0] = -folded[0]
    assert area_distortion(vertices, faces, folded) == math.inf


def test_a_border_that_is_unfolded_stays_on_its_great_circle() -> None:
    directions, faces = icosphere(2)
    vertices, faces = cut_half(directions.double(), faces, directions)
    loop = border_loop(faces)
    side = torch.ones(len(vertices), dtype=torch.int64).index_fill(0, loop, 0)
    folded = vertices.clone()
    folded[loop[0]] = functional.normalize(2 * vertices[loop[2]] - 0.5 * vertices[loop[0]], dim=0)
    mapped = _unfold(folded, faces, _adjacency(faces), side)
    assert not torch.equal(mapped, folded)
    assert (mapped[loop, 0].abs() < 1e-12).all()
