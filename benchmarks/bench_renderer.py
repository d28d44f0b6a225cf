"""Time the renderer on 64 pictures of a mesh of 1280 faces that covers about 38 % of each.

Goals on two cores: the rasteriser at 64 pixels in 3 ms, forward and backward of the whole at 32 pixels with two samples
along each side of a pixel in 60 ms. On a GPU, of its own time (`gpu_seconds` in `extra_info`): the rasteriser at the
128 samples of 64 pixels in 0.1 ms, forward and backward of the whole at 64 pixels in 1.5 ms.
"""

from dataclasses import replace

import pytest
import torch
from pytest_benchmark.fixture import BenchmarkFixture
from torch import Tensor

from benchmarks.measuring import DEVICE, ON_GPU, complete, seconds_on_gpu
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
    vertices = directions * torch.tensor([0.3, 0.3, 0.5]) + noise
    return Mesh(*(part.to(DEVICE) for part in (vertices, faces, directions))), poses.to(DEVICE)


@pytest.mark.parametrize("size", [32, 64, 128])
def test_rasterizer(benchmark: BenchmarkFixture, size: int) -> None:
    mesh, poses = ellipsoids()
    vertices_ndc = project(mesh.vertices, pose_from_tensor(poses), CONFIG.camera)
    benchmark.pedantic(complete(lambda: rasterize(vertices_ndc, mesh.faces, size)), rounds=100, warmup_rounds=2)
    covered = rasterize(vertices_ndc, mesh.faces, size).face_index >= 0
    benchmark.extra_info["covered"] = round(float(covered.float().mean()), 3)
    if ON_GPU:
        benchmark.extra_info["gpu_seconds"] = seconds_on_gpu(lambda: rasterize(vertices_ndc, mesh.faces, size))


@pytest.mark.parametrize("with_gradients", [False, True], ids=["forward", "forward_and_backward"])
@pytest.mark.parametrize("size", [32, 64])
def test_renderer(benchmark: BenchmarkFixture, size: int, with_gradients: bool) -> None:
    mesh, poses = ellipsoids()
    config = replace(CONFIG, size=size)
    textures = torch.rand(BATCH, 3, 32, 32, generator=generator(1)).to(DEVICE)
    backgrounds = torch.rand(BATCH, 3, size, size, generator=generator(2)).to(DEVICE)
    light_direction = torch.nn.functional.normalize(torch.randn(BATCH, 3, generator=generator(3)), dim=1).to(DEVICE)
    leaves = [mesh.vertices, textures, poses, backgrounds, light_direction]
    for leaf in leaves:
        leaf.requires_grad_(with_gradients)
    weights = torch.randn(BATCH, 3, size, size, generator=generator(4)).to(DEVICE)
    half = torch.full((BATCH,), 0.5, device=DEVICE)

    def step() -> None:
        light = Light(light_direction, half, half)
        rendering = render(mesh, textures, pose_from_tensor(poses), backgrounds, light, config)
        if with_gradients:
            torch.autograd.grad((weights * rendering.images).sum() + rendering.silhouettes.square().sum(), leaves)

    benchmark.pedantic(complete(step), rounds=50, warmup_rounds=2)
    if ON_GPU:
        benchmark.extra_info["gpu_seconds"] = seconds_on_gpu(step)
