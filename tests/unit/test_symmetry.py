import pytest
import torch

from pipeline.errors import MeshError
from pipeline.geometry.icosphere import icosphere
from pipeline.geometry.symmetry import mirror_index, reflect, symmetrize


def test_mirror_index_of_icosphere_reflects_exactly() -> None:
    vertices, _ = icosphere(3)
    mirror = mirror_index(vertices)
    assert torch.equal(vertices[mirror], reflect(vertices))
    assert torch.equal(mirror[mirror], torch.arange(len(vertices)))


def test_symmetrized_offsets_are_symmetric_to_the_last_bit() -> None:
    vertices, _ = icosphere(2)
    mirror = mirror_index(vertices)
    offsets = symmetrize(torch.randn(2, len(vertices), 3, generator=torch.Generator().manual_seed(0)), mirror)
    assert torch.equal(offsets[:, mirror], reflect(offsets))
    assert (offsets[:, mirror == torch.arange(len(mirror)), 0] == 0).all()


def test_symmetric_offsets_are_unchanged() -> None:
    vertices, _ = icosphere(2)
    mirror = mirror_index(vertices)
    assert torch.equal(symmetrize(vertices, mirror), vertices)


def test_lopsided_mesh_is_refused() -> None:
    vertices, _ = icosphere(1)
    vertices[0] += 0.01
    with pytest.raises(MeshError, match="not mirror-symmetric"):
        mirror_index(vertices)


def test_vertices_in_one_place_share_a_mirror_image() -> None:
    vertices, _ = icosphere(1)
    with pytest.raises(MeshError, match="vertices in one place, so that two share a mirror image; merge them"):
        mirror_index(torch.cat([vertices, vertices[:1]]))
