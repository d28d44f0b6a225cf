"""Time the renderer on 64 pictures of a mesh of 1280 faces that covers about 38 % of each.

Goals on two cores: the rasteriser at 64 pixels in 3 ms, forward and backward of the whole at 32 pixels with two samples
along each side of a pixel in 60 ms.
"""

import pytest
import torch
from pytest_benchmark.fixture import BenchmarkFixture
from torch import Tensor

from pipeline.geometry.camera import CameraConfig, pose_from_tensor, project
from pipeline.geometry.icosphere import icosphere
from pipeline.rendering.lighting import Light
from pipeline.rendering.rasterize import rasterize
from pipeline.rendering.renderer import Mesh, RendererConfig, render
from pipeline.seeding import generator

BATCH = 64
CONFIG = RendererConfig(CameraConfig(distance=2.7, field_of_view=30.0), size=32, supersampling=2)


def ellipsoids() -> tuple[Mesh, Tensor]:
    """Return slightly rough ellipsoids and poses (B, 6) that see them from all around."""
    rng = generator(0)
    directions, faces = icosphere(3)
    noise = 0.005 * torch.randn(BATCH, len(directions), 3, generator=rng)
    azimuth, elevation = 6.28 * torch.rand(BATCH, generator=rng), 0.5 * torch.rand(BATCH, generator=rng)
    placement = torch.tensor([0.0, 0.0, 0.0, 1.43]).expand(BATCH, 4)
    poses = torch.cat((azimuth[:, None], elevation[:, None], placement), dim=1)
    return Mesh(directions * torch.tensor([0.3, 0.3, 0.5]) + noise, faces, directions), poses


@pytest.mark.parametrize("size", [32, 64, 128])
def test_rasterizer(benchmark: BenchmarkFixture, size: int) -> None:
    mesh, poses = ellipsoids()
    vertices_ndc = project(mesh.vertices, pose_from_tensor(poses), CONFIG.camera)
    fragments = benchmark.pedantic(rasterize, (vertices_ndc, mesh.faces, size), rounds=100, warmup_rounds=2)
    benchmark.extra_info["covered"] = round(float((fragments.face_index >= 0).float().mean()), 3)


@pytest.mark.parametrize("with_gradients", [False, True], ids=["forward", "forward_and_backward"])
def test_renderer(benchmark: BenchmarkFixture, with_gradients: bool) -> None:
    mesh, poses = ellipsoids()
    textures = torch.rand(BATCH, 3, 32, 32, generator=generator(1))
    backgrounds = torch.rand(BATCH, 3, CONFIG.size, CONFIG.size, generator=generator(2))
    light_direction = torch.nn.functional.normalize(torch.randn(BATCH, 3, generator=generator(3)), dim=1)
    leaves = [mesh.vertices, textures, poses, backgrounds, light_direction]
    for leaf in leaves:
        leaf.requires_grad_(with_gradients)
    weights = torch.randn(BATCH, 3, CONFIG.size, CONFIG.size, generator=generator(4))

    def step() -> None:
        light = Light(light_direction, torch.full((BATCH,), 0.5), torch.full((BATCH,), 0.5))
        rendering = render(mesh, textures, pose_from_tensor(poses), backgrounds, light, CONFIG)
        if with_gradients:
            torch.autograd.grad((weights * rendering.images).sum() + rendering.silhouettes.square().sum(), leaves)

    benchmark.pedantic(step, rounds=50, warmup_rounds=2)
