"""Texels that copy the background are told from those that do not."""

import numpy as np
import pytest
import torch
from torch import Tensor

from pipeline.losses.copied_background import copied_background
from pipeline.seeding import generator

COUNT = 64


def random_colors(stream: int) -> Tensor:
    return torch.rand(COUNT, 3, 1, 1, generator=generator(stream))


def painted(texture: Tensor) -> Tensor:
    return texture.expand(-1, -1, 8, 8).clone()


def test_objects_of_their_own_colours_copy_nothing() -> None:
    assert copied_background(painted(random_colors(0)), painted(random_colors(1))) < 1e-6


def test_what_whole_objects_share_with_their_backgrounds_is_no_copy() -> None:
    exposure = torch.rand(COUNT, 1, 1, 1, generator=generator(2))
    assert copied_background(painted(exposure * random_colors(0)), painted(exposure * random_colors(1))) < 1e-6


def test_it_is_the_squared_excess_of_correlations_with_four_bands() -> None:
    bands, own = torch.rand(COUNT, 3, 4, 1, generator=generator(5)), torch.rand(COUNT, 3, 8, 8, generator=generator(6))
    scene = bands.repeat_interleave(2, dim=2).expand(-1, -1, -1, 8)
    textures = own + torch.linspace(-1, 1, 8) * scene
    excesses = []
    for channel in range(3):
        for band in range(4):
            texels = np.cov(bands[:, channel, band, 0].numpy(), textures[:, channel].flatten(1).T.numpy(), bias=True)
            deviations = np.sqrt(texels.diagonal() + 1e-3)
            correlations = texels[0, 1:] / deviations[1:] / deviations[0]
            excesses.append(np.maximum(correlations - correlations.mean(), 0) ** 2)
    torch.testing.assert_close(copied_background(textures, scene).item(), float(np.mean(excesses)), rtol=1e-4, atol=0)


@pytest.mark.parametrize("rows", [slice(0, 2), slice(6, 8)])
def test_texels_that_copy_one_height_of_the_background_count_by_their_part(rows: slice) -> None:
    objects, backgrounds = random_colors(0), random_colors(1)
    textures, scene = painted(objects), painted(random_colors(3))
    scene[..., rows, :] = backgrounds
    textures[..., :2, :4] = backgrounds
    an_eighth = copied_background(textures, scene)
    textures[..., :2, :2] = objects
    a_sixteenth = copied_background(textures, scene)
    assert 0.01 < a_sixteenth < an_eighth < 0.1


def test_its_gradient_takes_the_background_out_of_texels_alone() -> None:
    objects, backgrounds = random_colors(0), random_colors(1)
    textures, scene = painted(objects), painted(backgrounds).requires_grad_()
    textures[..., :2, :] = 0.5 * objects + 0.5 * backgrounds
    textures.requires_grad_()
    copied_background(textures, scene).backward()
    assert scene.grad is None
    assert textures.grad is not None
    centered = (backgrounds - backgrounds.mean(0))[..., 0]
    assert ((textures.grad[..., :2, :] * centered[..., None]).sum(dim=(0, 1)) > 0).all()


def test_a_batch_of_one_picture_says_nothing() -> None:
    textures = torch.rand(1, 3, 8, 8, generator=generator(4))
    assert copied_background(textures, painted(random_colors(0))[:1]) == 0
