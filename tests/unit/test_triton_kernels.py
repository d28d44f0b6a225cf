"""The kernels for CUDA devices do what the CPU's do: on a GPU where there is one, else in Triton's interpreter."""

import importlib
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from pipeline.errors import DeviceError
from pipeline.geometry.camera import project
from pipeline.rendering import (
    antialias_triton,
    crossings_triton,
    interpolate_triton,
    rasterize_triton,
    renderer,
    texture_triton,
)
from pipeline.rendering.antialias import antialias
from pipeline.rendering.interpolate import interpolate
from pipeline.rendering.rasterize import Fragments, rasterize
from pipeline.rendering.renderer import RendererConfig
from pipeline.rendering.texture import sample_sphere_texture
from tests.gradients import assert_refuses_second_derivatives, gradients
from tests.project.import_closure import ROOT
from tests.scenes import CONFIG, Scene
from tests.triton_kernels import (
    DEVICE,
    SMALL,
    draw_with_triton,
    enlarge_programs,
    resize_programs,
    reverse_pictures,
    stay_in_arguments,
)

KERNELS = {
    rasterize_triton: ["_set_up", "_draw", "_weigh_corners", "_weigh_corners_backward"],
    interpolate_triton: ["_interpolate", "_interpolate_backward"],
    texture_triton: ["_sample", "_sample_backward"],
    crossings_triton: ["_find_crossings"],
    antialias_triton: ["_blend", "_blend_backward", "_move_edges"],
}


@pytest.fixture(autouse=True)
def large_programs(monkeypatch: pytest.MonkeyPatch) -> None:
    enlarge_programs(monkeypatch)
    stay_in_arguments(monkeypatch)


def on_device(function: Callable[..., Tensor]) -> Callable[..., Tensor]:
    """Let a function take and return CPU tensors but work on the device."""
    return lambda *inputs: function(*(value.to(DEVICE) for value in inputs)).cpu()


def assert_close(actual: list[Tensor], expected: list[Tensor], tolerance: float) -> None:
    """Compare up to a part of the largest value."""
    for one, other in zip(actual, expected, strict=True):
        torch.testing.assert_close(one, other, atol=tolerance * float(other.abs().max()), rtol=0)


def tangled(scene: Scene) -> Tensor:
    """Return projected vertices of rough meshes, with a corner behind the camera and faces without area."""
    faces = scene.mesh.faces
    noise = 0.1 * torch.randn(scene.mesh.vertices.shape, generator=torch.Generator().manual_seed(0))
    vertices = scene.mesh.vertices + noise
    vertices[:, faces[::9, 0]] = vertices[:, faces[::9, 1]]
    vertices_ndc = project(vertices, scene.pose, CONFIG.camera)
    vertices_ndc[:, 0, 2] = -1
    return vertices_ndc


def draw(vertices_ndc: Tensor, faces: Tensor, size: int) -> Fragments:
    face_index, barycentric = rasterize_triton.rasterize(vertices_ndc.to(DEVICE), faces.to(DEVICE), size)
    return Fragments(face_index.cpu(), barycentric.cpu())


@pytest.mark.parametrize("size", [1, 17, 48])
def test_faces_are_those_of_the_cpu(size: int) -> None:
    scene = Scene(2, 2, seed=size)
    scene.pose = scene.pose._replace(center=torch.tensor([[0.5, -0.4], [0.0, 0.0]]))
    for vertices_ndc in (project(scene.mesh.vertices, scene.pose, CONFIG.camera), tangled(scene)):
        actual, expected = (function(vertices_ndc, scene.mesh.faces, size) for function in (draw, rasterize))
        assert torch.equal(actual.face_index, expected.face_index)
        torch.testing.assert_close(actual.barycentric, expected.barycentric, atol=1e-5, rtol=0)


def test_of_faces_in_one_place_the_first_is_seen() -> None:
    corners = torch.tensor([[[-0.9, -0.9, 2.0], [0.9, -0.9, 2.0], [0.0, 0.9, 2.5]]])
    faces = torch.tensor([[0, 1, 2], [0, 1, 2], [0, 1, 2]])
    assert draw(corners, faces, 9).face_index.unique().tolist() == [-1, 0]


def test_faces_do_not_depend_on_the_size_of_programs(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(1, 0, seed=3)
    vertices_ndc = project(scene.mesh.vertices, scene.pose, CONFIG.camera)
    expected = draw(vertices_ndc, scene.mesh.faces, 12)
    resize_programs(monkeypatch, SMALL)
    actual = draw(vertices_ndc, scene.mesh.faces, 12)
    assert torch.equal(actual.face_index, expected.face_index)
    assert torch.equal(actual.barycentric, expected.barycentric)


def test_vertices_that_are_not_numbers_draw_nothing() -> None:
    vertices = torch.tensor([[[-1.0, -1.0, 2.0], [1.0, -1.0, 2.0], [-1.0, 1.0, 2.0]]]).repeat(3, 1, 1)
    vertices[torch.arange(3), torch.arange(3), torch.tensor([0, 1, 0])] = torch.nan
    assert (draw(vertices, torch.tensor([[0, 1, 2]]), 4).face_index == -1).all()


def test_gradients_of_barycentric_coordinates() -> None:
    scene = Scene(2, 2, seed=5)
    vertices_ndc, faces = project(scene.mesh.vertices, scene.pose, CONFIG.camera), scene.mesh.faces
    actual = gradients(lambda vertices: draw(vertices, faces, 24).barycentric, vertices_ndc)
    expected = gradients(lambda vertices: rasterize(vertices, faces, 24).barycentric, vertices_ndc)
    assert_close(actual, expected, 1e-5)


def test_interpolations_agree() -> None:
    scene = Scene(2, 2, seed=6)
    faces = scene.mesh.faces
    vertices_ndc = project(scene.mesh.vertices, scene.pose, CONFIG.camera)
    face_index, barycentric = (values[:, :16] for values in rasterize(vertices_ndc, faces, 24))
    attributes = torch.randn(2, len(scene.mesh.directions), 5, generator=torch.Generator().manual_seed(0))

    def with_triton(attributes: Tensor, barycentric: Tensor) -> Tensor:
        return interpolate_triton.interpolate(attributes, faces.to(DEVICE), face_index.to(DEVICE), barycentric)

    def on_cpu(attributes: Tensor, barycentric: Tensor) -> Tensor:
        return interpolate(attributes, faces, Fragments(face_index, barycentric))

    actual, expected = (gradients(f, attributes, barycentric) for f in (on_device(with_triton), on_cpu))
    assert_close(actual, expected, 1e-5)
    weights = barycentric.to(DEVICE).requires_grad_()
    (alone,) = torch.autograd.grad(with_triton(attributes.to(DEVICE), weights).sum(), weights)
    leaf = barycentric.clone().requires_grad_()
    assert_close([alone.cpu()], list(torch.autograd.grad(on_cpu(attributes, leaf).sum(), leaf)), 1e-5)


def test_texture_lookups_agree() -> None:
    directions = torch.randn(2, 12, 16, 3, generator=torch.Generator().manual_seed(3))
    directions[:, :2] = 0
    directions[0, 3, 3] = torch.tensor([0.0, 1.0, 0.0])
    maps = Scene(2, 0, seed=1).texture_maps
    actual = gradients(on_device(texture_triton.sample_sphere_texture), maps, directions)
    assert_close(actual, gradients(sample_sphere_texture, maps, directions), 1e-4)


@pytest.mark.parametrize("size", [8, 32])
def test_antialiasing_agrees(size: int) -> None:
    scene = Scene(2, 2, seed=size)
    faces, vertices_ndc = scene.mesh.faces, tangled(scene)
    fragments = rasterize(vertices_ndc, faces, size)
    colors = torch.rand(2, 4, size, size, generator=torch.Generator().manual_seed(0)) * (fragments[0] >= 0)[:, None]

    def with_triton(colors: Tensor, vertices: Tensor) -> Tensor:
        strided = (value.to(DEVICE).transpose(0, 1).contiguous().transpose(0, 1) for value in (*fragments, faces))
        face_index, barycentric, corners = strided
        return antialias_triton.antialias(colors, face_index, barycentric, vertices, corners)

    actual = gradients(on_device(with_triton), colors, vertices_ndc)
    expected = gradients(lambda colors, vertices: antialias(colors, fragments, vertices, faces), colors, vertices_ndc)
    assert (expected[0] - colors).abs().max() > 0.1
    assert_close(actual, expected, 1e-5)


def test_second_derivatives_are_refused() -> None:
    scene = Scene(1, 0, seed=3)
    faces, vertices_ndc = scene.mesh.faces, project(scene.mesh.vertices, scene.pose, CONFIG.camera)
    face_index, barycentric = rasterize(vertices_ndc, faces, 8)
    corners, seen = faces.to(DEVICE), face_index.to(DEVICE)
    colors, directions = torch.rand(1, 4, 8, 8), torch.randn(1, 4, 4, 3)

    def interpolation(attributes: Tensor, weights: Tensor) -> Tensor:
        return interpolate_triton.interpolate(attributes, corners, seen, weights)

    def antialiasing(colors: Tensor, vertices: Tensor) -> Tensor:
        return antialias_triton.antialias(colors, seen, barycentric.to(DEVICE), vertices, corners)

    assert_refuses_second_derivatives(lambda vertices: draw(vertices, faces, 8).barycentric, vertices_ndc)
    assert_refuses_second_derivatives(on_device(interpolation), scene.mesh.vertices, barycentric)
    assert_refuses_second_derivatives(on_device(texture_triton.sample_sphere_texture), scene.texture_maps, directions)
    assert_refuses_second_derivatives(on_device(antialiasing), colors, vertices_ndc)


def test_no_pictures_give_none() -> None:
    texture_maps, directions = torch.rand(0, 3, 4, 4, device=DEVICE), torch.rand(0, 5, 6, 3, device=DEVICE)
    assert texture_triton.sample_sphere_texture(texture_maps, directions).shape == (0, 3, 5, 6)
    faces, face_index = torch.tensor([[0, 1, 2]], device=DEVICE), torch.zeros(0, 5, 6, dtype=torch.int32, device=DEVICE)
    weights, attributes = torch.rand(0, 5, 6, 3, device=DEVICE), torch.rand(0, 3, 2, device=DEVICE)
    assert interpolate_triton.interpolate(attributes, faces, face_index, weights).shape == (0, 5, 6, 2)


def assert_picture_is_that_of_the_cpu(monkeypatch: pytest.MonkeyPatch, scene: Scene, config: RendererConfig) -> None:
    def image(vertices: Tensor, textures: Tensor, center: Tensor, backgrounds: Tensor, light: Tensor) -> Tensor:
        to = vertices.device
        mesh = renderer.Mesh(vertices, scene.mesh.faces.to(to), scene.mesh.directions.to(to))
        pose = type(scene.pose)(*(part.to(to) for part in scene.pose))._replace(center=center)
        lights = type(scene.light)(light, *(part.to(to) for part in scene.light[1:]))
        rendering = renderer.render(mesh, textures, pose, backgrounds, lights, config)
        return torch.cat((rendering.images, rendering.silhouettes[:, None]), dim=1)

    light = scene.light.direction
    backgrounds = scene.backgrounds[..., : config.size, : config.size]
    inputs = (scene.mesh.vertices, scene.texture_maps, scene.pose.center, backgrounds, light)
    expected = gradients(image, *inputs)
    draw_with_triton(monkeypatch)
    assert_close(gradients(on_device(image), *inputs), expected, 1e-4)


def test_pictures_and_their_gradients_are_those_of_the_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    assert_picture_is_that_of_the_cpu(monkeypatch, Scene(2, 2, seed=4), CONFIG)


def test_size_of_programs_and_order_of_pictures_do_not_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every kernel starts several programs for each picture, the last of them with too few items to fill it.

    One picture shows the outline; in the other the object covers nearly every sample, by its last face too.
    """
    scene = Scene(2, 0, seed=10)
    scene.pose = scene.pose._replace(scale=torch.tensor([1.6, 2.5]))
    resize_programs(monkeypatch, SMALL)
    if DEVICE.type == "cpu":
        reverse_pictures(monkeypatch)
    assert_picture_is_that_of_the_cpu(monkeypatch, scene, replace(CONFIG, size=5, supersampling=1))


def test_every_kernel_compiles_for_a_gpu() -> None:
    """Compile for compute capability 9.0, which takes no GPU; the interpreter would accept what a GPU does not."""
    environment = {name: value for name, value in os.environ.items() if name != "TRITON_INTERPRET"}
    command = [sys.executable, "-m", "tests.triton_kernels"]
    printed = subprocess.run(command, cwd=ROOT, env=environment, check=True, capture_output=True, text=True).stdout
    assert sorted(printed.split()) == sorted(name for names in KERNELS.values() for name in names)


def test_kernels_without_triton_say_what_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "triton", None)
    for name in ("triton_compiler", "rasterize_triton"):
        monkeypatch.delitem(sys.modules, f"pipeline.rendering.{name}")
    with pytest.raises(DeviceError, match="rendering on a GPU needs Triton"):
        importlib.import_module("pipeline.rendering.rasterize_triton")


@pytest.mark.gpu
def test_a_gpu_draws_the_faces_of_the_cpu_at_the_size_of_training() -> None:
    scene = Scene(64, 3, seed=1)
    vertices_ndc = project(scene.mesh.vertices, scene.pose, CONFIG.camera)
    actual, expected = (function(vertices_ndc, scene.mesh.faces, 128) for function in (draw, rasterize))
    assert torch.equal(actual.face_index, expected.face_index)
    torch.testing.assert_close(actual.barycentric, expected.barycentric, atol=1e-5, rtol=0)
