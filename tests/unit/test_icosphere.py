from math import pi

import pytest
import torch

from pipeline.geometry.icosphere import icosphere


@pytest.mark.parametrize("subdivisions", [0, 1, 2, 3])
def test_counts_and_unit_length(subdivisions: int) -> None:
    vertices, faces = icosphere(subdivisions)
    assert len(vertices) == 10 * 4**subdivisions + 2
    assert len(faces) == 20 * 4**subdivisions
    assert (vertices.dtype, faces.dtype) == (torch.float32, torch.int64)
    torch.testing.assert_close(vertices.norm(dim=1), torch.ones(len(vertices)))


def test_volume_and_area_approach_the_ball() -> None:
    vertices, faces = icosphere(4)
    first, second, third = vertices.double()[faces].unbind(1)
    normals = torch.linalg.cross(second - first, third - first)
    assert float(normals.norm(dim=1).sum() / 2) == pytest.approx(4 * pi, rel=0.005)
    # Positive where faces run counter-clockwise seen from outside.
    assert float((normals * first).sum() / 6) == pytest.approx(4 * pi / 3, rel=0.01)


def test_mirror_image_is_the_same_set_of_points_exactly() -> None:
    vertices, _ = icosphere(3)
    points = {tuple(point) for point in vertices.tolist()}
    assert points == {(0.0 - x, y, z) for x, y, z in points}
