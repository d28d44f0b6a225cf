import math

import pytest
import torch
from torch import Tensor

from pipeline.geometry.closed_mesh import enclosed_volume, is_closed
from pipeline.geometry.icosphere import icosphere

CORNERS = torch.tensor([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
SIDES = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
BOX = torch.tensor(
    [[first, *rest] for first, second, third, last in SIDES for rest in ((second, third), (third, last))]
)


def soup(vertices: Tensor, faces: Tensor) -> tuple[Tensor, Tensor]:
    """Give each face corners of its own, as files of textured meshes do along seams."""
    return vertices[faces].flatten(0, 1), torch.arange(3 * len(faces)).view(-1, 3)


def test_a_closed_mesh_may_have_seams_and_parts_that_touch() -> None:
    assert is_closed(CORNERS, BOX)
    assert is_closed(*soup(CORNERS, BOX))
    beside = torch.cat([CORNERS, CORNERS + torch.tensor([1.0, 0, 0])])
    assert is_closed(beside, torch.cat([BOX, BOX + 8]))


def test_zeros_of_both_signs_are_one_place() -> None:
    vertices, faces = soup(CORNERS, BOX)
    vertices[::2] = torch.where(vertices[::2] == 0, -vertices[::2], vertices[::2])
    assert vertices.signbit().any()
    assert is_closed(vertices, faces)


@pytest.mark.parametrize("faces", [BOX[1:], torch.cat([BOX[1:], BOX[:1].flip(1)]), torch.cat([BOX, BOX[:1]])])
def test_a_hole_a_turned_face_and_a_double_one_are_open(faces: Tensor) -> None:
    assert not is_closed(CORNERS, faces)


def test_volumes_have_the_sign_of_their_orientation() -> None:
    vertices, faces = icosphere(4)
    shapes = torch.stack([7 * vertices + 3, vertices * torch.tensor([1, 1, 0.5])])
    sphere = math.pi / 6
    assert enclosed_volume(shapes, faces).tolist() == pytest.approx([sphere, sphere / 2], rel=0.01)
    assert enclosed_volume(shapes[:1], faces.flip(1)).item() == pytest.approx(-sphere, rel=0.01)
    assert enclosed_volume(CORNERS[None], BOX).item() == pytest.approx(1)


def test_what_is_flat_has_no_volume() -> None:
    flat = CORNERS * torch.tensor([1.0, 1.0, 0.0])
    assert abs(enclosed_volume(flat[None], BOX).item()) < 1e-12
    assert enclosed_volume(torch.zeros(1, 8, 3), BOX).isnan()
