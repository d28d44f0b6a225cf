"""Six pictures that the renderer must keep drawing; `python -m tests.golden.golden_pictures` draws them anew.

Look at them after that: the object's front is red, its left side (+x) green, its top blue.
"""

from math import radians
from pathlib import Path

import torch
from PIL import Image
from torch import Tensor

from pipeline.geometry.camera import CameraConfig, pose_from_tensor
from pipeline.rendering.lighting import Light
from pipeline.rendering.renderer import Mesh, RendererConfig, render
from tests.deformed_spheres import deformed_sphere

FOLDER = Path(__file__).parent
CAMERA = CameraConfig(distance=2.7, field_of_view=30.0)
VIEWS = {  # azimuth, elevation, roll in degrees; center x, center y; scale; supersampling; light; background
    "front": (0, 0, 0, 0, 0, 1.2, 2, False, False),
    "side": (90, 0, 0, 0, 0, 1.2, 2, False, False),
    "above_lit": (35, 30, 0, 0, 0, 1.2, 2, True, False),
    "rolled_on_stripes": (215, 10, 25, 0.2, -0.1, 1.0, 2, False, True),
    "cut_off": (300, 20, 0, 0.7, 0.5, 1.6, 4, True, True),
    "small_without_supersampling": (60, 15, -10, -0.3, 0.2, 0.4, 1, True, True),
}


def texture() -> Tensor:
    """Paint the front red, +x green and the top blue, with soft borders, on dark grey."""
    size = 64
    rows, columns = torch.meshgrid(torch.arange(size), torch.arange(size), indexing="ij")
    front, left = ((columns - center + 0.5).abs() for center in (size / 2, 3 * size / 4))
    channels = [(8 - front) / 2, (8 - left) / 2, (16.0 - rows) / 2]
    return 0.2 + 0.7 * torch.stack([channel.clamp(0, 1) for channel in channels])[None]


def draw(view: str) -> Tensor:
    """Draw one of the views: (H, W, 3) uint8."""
    azimuth, elevation, roll, x, y, scale, supersampling, lit, striped = VIEWS[view]
    vertices, faces, directions = deformed_sphere("car")
    angles = [radians(angle) for angle in (azimuth, elevation, roll)]
    pose = pose_from_tensor(torch.tensor([[*angles, x, y, scale]]))
    light = Light(torch.tensor([[0.6, 0.8, 0.0]]), torch.tensor([0.4]), torch.tensor([0.6])) if lit else None
    stripes = torch.linspace(0.3, 0.9, 64)[:, None].expand(1, 3, 64, 64) if striped else None
    config = RendererConfig(CAMERA, size=64, supersampling=supersampling)
    image = render(Mesh(vertices[None], faces, directions), texture(), pose, stripes, light, config).images[0]
    return (255 * image).round().to(torch.uint8).permute(1, 2, 0)


if __name__ == "__main__":
    for name in VIEWS:
        Image.fromarray(draw(name).numpy()).save(FOLDER / f"{name}.png")
