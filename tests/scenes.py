"""Scenes for the renderer's tests: bumpy closed shapes under smooth textures, from any side."""

from dataclasses import replace
from math import pi

import torch
from torch import Tensor
from torch.nn.functional import interpolate, normalize

from pipeline.geometry.camera import CameraConfig, Pose
from pipeline.geometry.icosphere import icosphere
from pipeline.rendering.lighting import Light
from pipeline.rendering.renderer import Mesh, RendererConfig, Rendering, render

CONFIG = RendererConfig(CameraConfig(distance=2.7, field_of_view=30.0), size=32, supersampling=2)


class Scene:
    """Hold everything that a picture is rendered from."""

    def __init__(self, batch: int, subdivisions: int, seed: int) -> None:
        rng = torch.Generator().manual_seed(seed)
        directions, faces = icosphere(subdivisions)
        bump_centers = normalize(torch.randn(batch, 6, 3, generator=rng), dim=2)
        heights = 0.12 * torch.randn(batch, 6, generator=rng)
        radius = 0.5 + torch.einsum("bkv,bk->bv", (4 * (bump_centers @ directions.T - 1)).exp(), heights)
        self.mesh = Mesh(radius[..., None] * directions * torch.tensor([0.7, 0.6, 1.0]), faces, directions)
        self.texture_maps = smooth_textures(batch, 32, rng)
        self.pose = Pose(
            azimuth=2 * pi * torch.rand(batch, generator=rng),
            elevation=0.5 * torch.rand(batch, generator=rng),
            roll=0.2 * torch.randn(batch, generator=rng),
            center=0.05 * torch.randn(batch, 2, generator=rng),
            scale=1.1 + 0.05 * torch.randn(batch, generator=rng),
        )
        self.backgrounds = interpolate(torch.rand(batch, 3, 4, 4, generator=rng), (32, 32), mode="bilinear")
        light_direction = normalize(torch.randn(batch, 3, generator=rng) + torch.tensor([0.0, 1.0, 0.0]), dim=1)
        self.light = Light(light_direction, torch.full((batch,), 0.5), torch.full((batch,), 0.5))

    def render(self, size: int = 32, supersampling: int = 2) -> Rendering:
        backgrounds = interpolate(self.backgrounds, (size, size))
        config = replace(CONFIG, size=size, supersampling=supersampling)
        return render(self.mesh, self.texture_maps, self.pose, backgrounds, self.light, config)


def smooth_textures(batch: int, size: int, rng: torch.Generator) -> Tensor:
    """Return maps of functions that are smooth on the whole sphere, the poles included."""
    steps = (torch.arange(size) + 0.5) / size - 0.5
    elevation, azimuth = torch.meshgrid(-pi * steps, 2 * pi * steps, indexing="ij")
    directions = torch.stack(
        (azimuth.sin() * elevation.cos(), elevation.sin(), azimuth.cos() * elevation.cos()),
    )
    frequencies, phases = 3 * torch.randn(batch, 3, 3, generator=rng), 2 * pi * torch.rand(batch, 3, generator=rng)
    return 0.5 + 0.4 * (torch.einsum("bck,khw->bchw", frequencies, directions) + phases[..., None, None]).sin()
