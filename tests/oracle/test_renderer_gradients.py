"""Gradients of the renderer point where finite differences of a 16 times supersampled rendering point."""

import pytest
import torch
from torch import Tensor
from torch.nn.functional import cosine_similarity

from pipeline.geometry.camera import pose_from_tensor, pose_to_tensor
from pipeline.rendering.lighting import Light
from pipeline.rendering.renderer import Rendering
from tests.scenes import Scene

STEPS = {"vertices": 0.0005, "textures": 0.1, "poses": 0.01, "lights": 0.05}
"""Steps of the finite differences. Larger steps of vertices would change which edges are silhouettes."""
DIRECTIONS = {"vertices": 80, "textures": 16, "poses": 6, "lights": 5}
"""How many directions each kind of parameter is moved in."""

Parameters = dict[str, Tensor]


def parameters_of(scene: Scene) -> Parameters:
    light = scene.light
    return {
        "vertices": scene.mesh.vertices,
        "textures": scene.texture_maps,
        "poses": pose_to_tensor(scene.pose),
        "lights": torch.cat((light.direction, light.ambient[:, None], light.directional[:, None]), dim=1),
    }


def render(scene: Scene, parameters: Parameters, supersampling: int) -> Rendering:
    """Render a scene of one picture with a batch of other values for some of its parameters."""
    batch = max(map(len, parameters.values()))
    vertices, textures, poses, lights = (
        parameters[name].expand(batch, *parameters[name].shape[1:])
        for name in ("vertices", "textures", "poses", "lights")
    )
    changed = Scene(1, 0, 0)
    changed.mesh = scene.mesh._replace(vertices=vertices)
    changed.texture_maps, changed.pose = textures, pose_from_tensor(poses)
    changed.light = Light(lights[:, :3], lights[:, 3], lights[:, 4])
    changed.backgrounds = scene.backgrounds.expand(batch, -1, -1, -1)
    return changed.render(supersampling=supersampling)


def losses(target: Rendering, rendering: Rendering) -> Tensor:
    """Return the squared error of silhouettes and that of colours for each picture: (B, 2)."""
    silhouettes = (rendering.silhouettes - target.silhouettes).square().sum(dim=(1, 2))
    return torch.stack((silhouettes, (rendering.images - target.images).square().sum(dim=(1, 2, 3))), dim=1)


def directions_for(name: str, value: Tensor) -> Tensor:
    """Return directions to move a parameter in: single coordinates, or for textures random changes of the whole."""
    count, rng = DIRECTIONS[name], torch.Generator().manual_seed(7)
    if name == "textures":
        return torch.randn(count, *value.shape[1:], generator=rng).sign()
    coordinates = torch.randperm(value.numel(), generator=rng)[:count]
    return torch.nn.functional.one_hot(coordinates, value.numel()).to(value.dtype).view(count, *value.shape[1:])


def gradient_of(loss: Tensor, value: Tensor) -> Tensor:
    """Return the gradient of a loss, 0 where it does not depend on the value."""
    return torch.autograd.grad(loss, value, retain_graph=True, materialize_grads=True)[0]


@torch.no_grad()
def differences(scene: Scene, target: Rendering, name: str, directions: Tensor) -> Tensor:
    """Return central differences of the losses of pictures with 256 samples a pixel: (directions, 2)."""
    parameters, slopes = parameters_of(scene), []
    for part in directions.split(8):
        low, high = (
            losses(target, render(scene, {**parameters, name: parameters[name] + step * part}, supersampling=16))
            for step in (-STEPS[name], STEPS[name])
        )
        slopes.append((high - low) / (2 * STEPS[name]))
    return torch.cat(slopes)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 2])
@pytest.mark.parametrize("name", ["vertices", "poses", "textures", "lights"])
def test_gradients_point_where_the_losses_grow(name: str, seed: int) -> None:
    scene, other = Scene(1, 2, seed), Scene(1, 2, seed + 1000)
    moved = pose_to_tensor(scene.pose) + torch.tensor([0.3, 0.1, 0.1, 0.05, -0.05, 0.05])
    target = render(scene, {**parameters_of(other), "poses": moved}, supersampling=2)
    parameters = parameters_of(scene)
    value = parameters[name].clone().requires_grad_()
    grown = losses(target, render(scene, {**parameters, name: value}, supersampling=2))[0]
    directions = directions_for(name, value.detach())
    slopes = torch.stack([(directions * gradient_of(loss, value)).flatten(1).sum(dim=1) for loss in grown], dim=1)
    expected = differences(scene, target, name, directions)
    of_silhouettes, of_colors = cosine_similarity(slopes, expected, dim=0).tolist()
    assert of_colors > 0.95
    if name in ("vertices", "poses"):
        assert of_silhouettes > 0.95
    else:
        assert expected[:, 0].count_nonzero() == slopes[:, 0].count_nonzero() == 0
