"""Each operation of the renderer: the compiled one equals the one in tensor operations, in values and gradients."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from torch import Tensor

from pipeline.geometry.camera import project
from pipeline.rendering.antialias import antialias
from pipeline.rendering.compiled import first_writable
from pipeline.rendering.interpolate import interpolate
from pipeline.rendering.lighting import Light, shade, vertex_normals
from pipeline.rendering.rasterize import Fragments, rasterize
from pipeline.rendering.texture import sample_sphere_texture
from tests import rendering_in_torch
from tests.gradients import assert_refuses_second_derivatives, gradients
from tests.scenes import CONFIG, Scene


@pytest.fixture
def scene() -> Scene:
    return Scene(batch=3, subdivisions=2, seed=5)


@pytest.fixture
def vertices_ndc(scene: Scene) -> Tensor:
    return project(scene.mesh.vertices, scene.pose, CONFIG.camera)


def test_a_face_that_fills_the_lower_left_half() -> None:
    vertices = torch.tensor([[[-1.0, -1.0, 2.0], [1.0, -1.0, 2.0], [-1.0, 1.0, 2.0]]])
    face_index = rasterize(vertices, torch.tensor([[0, 1, 2]]), 4).face_index[0]
    covered = torch.ones(4, 4).tril().bool()
    assert torch.equal(face_index >= 0, covered)


def test_nearer_face_hides_the_other_in_either_order() -> None:
    corners = torch.tensor([[-1.0, -1.0], [1.0, -1.0], [0.0, 1.0]])
    depth = torch.tensor([2.0, 2.0, 2.0, 1.5, 1.5, 1.5])[:, None]
    vertices = torch.cat((corners.repeat(2, 1), depth), dim=1)[None]
    faces = torch.tensor([[0, 1, 2], [3, 4, 5]])
    assert rasterize(vertices, faces, 8).face_index.unique().tolist() == [-1, 1]
    assert rasterize(vertices, faces.flip(0), 8).face_index.unique().tolist() == [-1, 0]


def test_vertices_that_are_not_numbers_draw_nothing() -> None:
    vertices = torch.tensor([[[-1.0, -1.0, 2.0], [1.0, -1.0, 2.0], [-1.0, 1.0, 2.0]]]).repeat(3, 1, 1)
    vertices[torch.arange(3), torch.arange(3), torch.tensor([0, 1, 0])] = torch.nan
    assert (rasterize(vertices, torch.tensor([[0, 1, 2]]), 4).face_index == -1).all()


def test_barycentric_coordinates_are_perspective_correct() -> None:
    # Halfway in the picture between depths 1 and 3, the point on the face lies at depth 1.5: a quarter of the way.
    vertices = torch.tensor([[[-1.0, 0.0, 1.0], [1.0, 0.01, 3.0], [1.0, -0.01, 3.0]]])
    fragments = rasterize(vertices, torch.tensor([[0, 1, 2]]), 257)
    assert fragments.barycentric[0, 128, 128].tolist() == pytest.approx([0.75, 0.125, 0.125], abs=1e-5)


@pytest.mark.parametrize("size", [1, 32, 65, 512])
def test_rasterizers_agree(scene: Scene, vertices_ndc: Tensor, size: int) -> None:
    compiled = rasterize(vertices_ndc, scene.mesh.faces, size)
    face_index = rendering_in_torch.nearest_faces(vertices_ndc, scene.mesh.faces, size)
    assert torch.equal(compiled.face_index, face_index)
    barycentric = rendering_in_torch.barycentric_coordinates(vertices_ndc.double(), scene.mesh.faces, face_index)
    torch.testing.assert_close(compiled.barycentric.double(), barycentric, atol=1e-6, rtol=0)


def test_gradients_of_barycentric_coordinates(scene: Scene, vertices_ndc: Tensor) -> None:
    faces = scene.mesh.faces
    face_index = rasterize(vertices_ndc, faces, 24).face_index

    def compiled(vertices: Tensor) -> Tensor:
        return rasterize(vertices, faces, 24).barycentric

    def in_torch(vertices: Tensor) -> Tensor:
        return rendering_in_torch.barycentric_coordinates(vertices, faces, face_index)

    expected = gradients(in_torch, vertices_ndc.double())
    torch.testing.assert_close(gradients(compiled, vertices_ndc), expected, atol=1e-4, rtol=1e-4)


def test_interpolations_agree(scene: Scene, vertices_ndc: Tensor) -> None:
    faces = scene.mesh.faces
    face_index, barycentric = (values[:, :16] for values in rasterize(vertices_ndc, faces, 24))
    attributes = torch.randn(3, len(scene.mesh.directions), 5)

    def apply(function: Callable[..., Tensor]) -> Callable[..., Tensor]:
        return lambda attributes, barycentric: function(attributes, faces, Fragments(face_index, barycentric))

    compiled = gradients(apply(interpolate), attributes, barycentric)
    in_torch = gradients(apply(rendering_in_torch.interpolate), attributes.double(), barycentric.double())
    covered = face_index >= 0
    torch.testing.assert_close(compiled[:2], in_torch[:2])
    torch.testing.assert_close(compiled[2][covered], in_torch[2][covered])


def test_texture_lookups_agree(scene: Scene) -> None:
    directions = torch.randn(3, 12, 16, 3, generator=torch.Generator().manual_seed(3))
    directions[:, :2] = 0
    compiled = gradients(sample_sphere_texture, scene.texture_maps, directions)
    in_torch = gradients(rendering_in_torch.sample_sphere_texture, scene.texture_maps.double(), directions.double())
    torch.testing.assert_close(compiled, in_torch, atol=1e-5, rtol=1e-4)


@pytest.mark.parametrize("size", [16, 64])
@pytest.mark.parametrize("roughness", [0.0, 0.1])
def test_antialiasings_agree(scene: Scene, size: int, roughness: float) -> None:
    rng = torch.Generator().manual_seed(size)
    faces = scene.mesh.faces
    vertices = scene.mesh.vertices + roughness * torch.randn(scene.mesh.vertices.shape, generator=rng)
    vertices_ndc = project(vertices, scene.pose, CONFIG.camera)
    vertices_ndc[0, 7, 2] = -1  # behind the camera
    fragments = rasterize(vertices_ndc, faces, size)
    colors = torch.rand(3, 4, size, size, generator=rng) * (fragments.face_index >= 0)[:, None]

    def apply(function: Callable[..., Tensor]) -> Callable[..., Tensor]:
        return lambda colors, vertices: function(colors, fragments, vertices, faces)

    compiled = gradients(apply(antialias), colors, vertices_ndc)
    in_torch = gradients(apply(rendering_in_torch.antialias), colors.double(), vertices_ndc.double())
    assert (compiled[0] - colors).abs().max() > 0.1
    torch.testing.assert_close(compiled[:2], in_torch[:2], atol=1e-5, rtol=0)
    torch.testing.assert_close(compiled[2], in_torch[2], atol=1e-4 * float(in_torch[2].abs().max()), rtol=0)


def test_second_derivatives_are_refused(scene: Scene, vertices_ndc: Tensor) -> None:
    faces = scene.mesh.faces
    fragments = rasterize(vertices_ndc, faces, 16)
    face_index, barycentric = fragments
    assert_refuses_second_derivatives(lambda vertices: rasterize(vertices, faces, 16).barycentric, vertices_ndc)
    assert_refuses_second_derivatives(
        lambda attributes, weights: interpolate(attributes, faces, Fragments(face_index, weights)),
        scene.mesh.vertices,
        barycentric,
    )
    assert_refuses_second_derivatives(sample_sphere_texture, scene.texture_maps, torch.randn(3, 4, 4, 3))
    assert_refuses_second_derivatives(
        lambda colors, vertices: antialias(colors, fragments, vertices, faces), torch.rand(3, 4, 16, 16), vertices_ndc
    )


def test_texture_axes() -> None:
    texture = torch.rand(1, 3, 8, 8)
    quarter = torch.pi / 8  # from a texel's border to its centre, columns being pi / 4 wide
    towards = torch.tensor([quarter, quarter + torch.pi / 2, quarter - torch.pi])
    directions = torch.stack((towards.sin(), torch.zeros(3), towards.cos()), dim=1)
    columns = sample_sphere_texture(texture, directions[None, None].expand(1, 3, 3, 3))[0, :, 0]
    equator = texture[0, :, 3:5].mean(dim=1)
    torch.testing.assert_close(columns, equator[:, [4, 6, 0]])
    up = sample_sphere_texture(texture, torch.tensor([1e-3, 1.0, 1e-3]).expand(1, 1, 1, 3))[0, :, 0, 0]
    assert (up >= texture[0, :, 0].amin(dim=1) - 1e-6).all()
    assert (up <= texture[0, :, 0].amax(dim=1) + 1e-6).all()


def test_texture_wraps_around_without_a_seam() -> None:
    texture = torch.rand(1, 3, 16, 16)
    behind = torch.tensor([[1e-6, 0.3, -1.0], [-1e-6, 0.3, -1.0]])
    left, right = sample_sphere_texture(texture, behind.expand(1, 2, 2, 3))[0, :, 0].unbind(1)
    torch.testing.assert_close(left, right, atol=1e-4, rtol=0)


def test_mirrored_map_along_mirrored_directions_is_the_same() -> None:
    texture, directions = torch.rand(1, 3, 16, 16), torch.randn(1, 9, 9, 3)
    mirrored = sample_sphere_texture(texture.flip(-1), directions * torch.tensor([-1.0, 1.0, 1.0]))
    torch.testing.assert_close(mirrored, sample_sphere_texture(texture, directions))


def test_normals_of_a_sphere_point_outwards() -> None:
    directions, faces = Scene(1, 3, 0).mesh.directions, Scene(1, 3, 0).mesh.faces
    cosine = (vertex_normals(directions[None], faces)[0] * directions).sum(dim=1)
    assert cosine.min() > 0.999


def test_light_from_above_shades_a_sphere() -> None:
    mesh = Scene(1, 3, 0).mesh
    light = Light(torch.tensor([[0.0, 1.0, 0.0]]), torch.tensor([0.25]), torch.tensor([0.5]))
    shading = shade(mesh.directions[None], mesh.faces, light)[0]
    expected = 0.25 + 0.5 * mesh.directions[:, 1].clamp(min=0)
    torch.testing.assert_close(shading, expected, atol=0.02, rtol=0)


def test_kernels_are_kept_where_something_can_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    closed, open_ = tmp_path / "file/kernels", tmp_path / "new/kernels"
    assert first_writable([closed, open_, tmp_path]) == open_
    passing = first_writable([closed, "~nobody-of-this-name/kernels"])
    assert passing.is_dir()
    assert not list(passing.iterdir())


@pytest.mark.parametrize("compiler", ["numba", "triton"])
def test_compilers_are_not_imported_before_the_first_picture(compiler: str) -> None:
    code = f"import sys, pipeline.training.full; sys.exit('{compiler}' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=Path(__file__).parents[2], check=False).returncode == 0
