"""The renderer draws what the slow reference draws."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from pipeline.geometry.camera import Pose, project, rotation_from_angles
from pipeline.rendering.rasterize import rasterize
from pipeline.rendering.renderer import Rendering, render
from tests import rendering_in_loops
from tests.scenes import CONFIG, Scene

TOLERANCE = 1e-5


def assert_close(actual: Rendering, expected: Rendering, tolerance: float) -> None:
    for one, other in zip(actual, expected, strict=True):
        torch.testing.assert_close(one.double(), other.double(), atol=tolerance, rtol=0)


def picture(scene: Scene, index: int) -> Scene:
    """Return a scene of one of a scene's pictures."""
    chosen = slice(index, index + 1)
    single = Scene(1, 0, 0)
    single.mesh = scene.mesh._replace(vertices=scene.mesh.vertices[chosen])
    single.texture_maps, single.backgrounds = scene.texture_maps[chosen], scene.backgrounds[chosen]
    single.pose = Pose(*(part[chosen] for part in scene.pose))
    single.light = type(scene.light)(*(part[chosen] for part in scene.light))
    return single


def camera_direction(pose: Pose) -> Tensor:
    """Return unit vectors from the origin towards the camera."""
    return rotation_from_angles(pose.azimuth, pose.elevation, pose.roll)[:, 2]


@pytest.mark.parametrize(("size", "supersampling", "subdivisions"), [(32, 2, 3), (64, 1, 2), (12, 4, 2)])
def test_renderer_draws_what_the_reference_draws(size: int, supersampling: int, subdivisions: int) -> None:
    scene = Scene(2, subdivisions, seed=size)
    config = replace(CONFIG, size=size, supersampling=supersampling)
    scene.backgrounds = torch.rand(2, 3, size, size, generator=torch.Generator().manual_seed(0))
    inputs = (scene.mesh, scene.texture_maps, scene.pose, scene.backgrounds, scene.light, config)
    assert_close(render(*inputs), rendering_in_loops.render(*inputs), TOLERANCE)


def test_no_background_and_no_light() -> None:
    scene = Scene(1, 2, seed=3)
    inputs = (scene.mesh, scene.texture_maps, scene.pose, None, None, CONFIG)
    assert_close(render(*inputs), rendering_in_loops.render(*inputs), TOLERANCE)


def test_object_partly_outside_the_picture() -> None:
    scene = Scene(1, 2, seed=4)
    scene.pose = scene.pose._replace(center=torch.tensor([[0.8, -0.6]]), scale=torch.tensor([2.0]))
    inputs = (scene.mesh, scene.texture_maps, scene.pose, scene.backgrounds, scene.light, CONFIG)
    rendering = render(*inputs)
    assert rendering.silhouettes[0, -1].max() > 0.99
    assert_close(rendering, rendering_in_loops.render(*inputs), TOLERANCE)


def test_faces_behind_the_camera_and_faces_without_area() -> None:
    scene = Scene(1, 2, seed=5)
    vertices, faces = scene.mesh.vertices.clone(), scene.mesh.faces
    vertices[:, faces[::9, 0]] = vertices[:, faces[::9, 1]]
    vertices[:, 0] = 2 * CONFIG.camera.distance * camera_direction(scene.pose)
    scene.mesh = scene.mesh._replace(vertices=vertices)
    inputs = (scene.mesh, scene.texture_maps, scene.pose, scene.backgrounds, None, CONFIG)
    assert_close(render(*inputs), rendering_in_loops.render(*inputs), TOLERANCE)


def test_object_outside_the_picture_leaves_the_background() -> None:
    scene = Scene(1, 2, seed=6)
    scene.pose = scene.pose._replace(center=torch.tensor([[5.0, 0.0]]))
    rendering = scene.render()
    assert torch.equal(rendering.images, scene.backgrounds)
    assert rendering.silhouettes.count_nonzero() == 0


def test_pictures_of_a_batch_do_not_touch_each_other() -> None:
    scene = Scene(4, 3, seed=7)
    together = scene.render()
    for index in range(4):
        alone = picture(scene, index).render()
        assert torch.equal(alone.silhouettes[0], together.silhouettes[index])
        torch.testing.assert_close(alone.images[0], together.images[index], atol=1e-6, rtol=0)


def test_order_of_faces_does_not_matter() -> None:
    scene = Scene(2, 3, seed=8)
    expected = scene.render()
    order = torch.randperm(len(scene.mesh.faces), generator=torch.Generator().manual_seed(0))
    scene.mesh = scene.mesh._replace(faces=scene.mesh.faces[order].roll(1, dims=1))
    assert_close(scene.render(), expected, 1e-5)


@pytest.mark.parametrize("size", [32, 64, 128, 256, 512])
def test_every_size_shows_the_same_picture(size: int) -> None:
    scene = Scene(2, 3, seed=9)
    coarse = torch.nn.functional.avg_pool2d(scene.render(size, 1).silhouettes, size // 32)
    assert (coarse - scene.render(32, 8).silhouettes).abs().mean() < 0.01


def test_antialiasing_comes_close_to_the_covered_area() -> None:
    scene = Scene(4, 3, seed=12)
    vertices_ndc = project(scene.mesh.vertices, scene.pose, CONFIG.camera)
    samples, points = (
        (rasterize(vertices_ndc, scene.mesh.faces, size).face_index >= 0).float() for size in (16 * 32, 32)
    )
    area = torch.nn.functional.avg_pool2d(samples, 16)
    antialiased = scene.render(supersampling=1).silhouettes
    assert (antialiased - area).abs().mean() < 0.15 * (points - area).abs().mean()


def test_values_stay_between_zero_and_one_on_tangled_meshes() -> None:
    scene = Scene(8, 3, seed=10)
    noise = 0.1 * torch.randn(scene.mesh.vertices.shape, generator=torch.Generator().manual_seed(0))
    scene.mesh = scene.mesh._replace(vertices=scene.mesh.vertices + noise)
    rendering = scene.render(supersampling=1)
    assert rendering.silhouettes.min() >= 0
    assert rendering.silhouettes.max() <= 1 + 1e-6
    assert rendering.images.min() >= 0
    assert rendering.images.max() <= 1 + 1e-6


@pytest.mark.gpu
def test_devices_agree_in_pictures_and_gradients() -> None:
    results = []
    for device in ("cpu", "cuda"):
        scene = Scene(4, 3, seed=11)
        vertices = scene.mesh.vertices.to(device).requires_grad_()
        textures = scene.texture_maps.to(device).requires_grad_()
        mesh = type(scene.mesh)(vertices, scene.mesh.faces.to(device), scene.mesh.directions.to(device))
        pose = Pose(*(part.to(device) for part in scene.pose))
        light = type(scene.light)(*(part.to(device) for part in scene.light))
        rendering = render(mesh, textures, pose, scene.backgrounds.to(device), light, CONFIG)
        (rendering.images.square().sum() + rendering.silhouettes.square().sum()).backward()
        assert vertices.grad is not None
        assert textures.grad is not None
        results.append([tensor.detach().cpu() for tensor in (*rendering, vertices.grad, textures.grad)])
    for one, other in zip(*results, strict=True):
        assert torch.nn.functional.cosine_similarity(one.flatten(), other.flatten(), dim=0) > 0.9999
        torch.testing.assert_close(one, other, atol=1e-4 * float(one.abs().max()), rtol=0)
