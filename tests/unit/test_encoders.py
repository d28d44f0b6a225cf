"""Encoders of the full model."""

import pytest
import torch

from pipeline.errors import ConfigError
from pipeline.networks.encoders import (
    CODE_NORM,
    LEAST_COLOR_VARIANCE,
    Encoder,
    EncoderBlock,
    EncoderConfig,
    FeatureEncoder,
)
from pipeline.seeding import generator, initialised

CONFIGS = [(EncoderConfig("wide_resnet", 8, 1), 32), (EncoderConfig("resnet18", 8, 2), 128)]


@pytest.mark.parametrize(("config", "size"), CONFIGS)
def test_code_does_not_depend_on_the_rest_of_the_batch(config: EncoderConfig, size: int) -> None:
    with initialised(0):
        encoder = Encoder(config, 5, torch.float32)
    images = torch.rand(3, 3, size, size, generator=generator(0))
    assert encoder(images).shape == (3, 5)
    torch.testing.assert_close(encoder(images)[1:2], encoder(images[1:2]))


def test_channels_that_cannot_be_normalised_in_groups_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"^width is 12; expected a multiple of 8"):
        EncoderConfig("wide_resnet", 12, 1)


def test_resnet18_of_width_64_has_the_published_weights() -> None:
    encoder = Encoder(EncoderConfig("resnet18", 64, 2), 10, torch.float32)
    convolutions = [m for m in encoder.modules() if isinstance(m, torch.nn.Conv2d)]
    # He et al. 2016: 17 convolutions, one of them 7x7, and three 1x1 projections, 11,166,912 weights.
    assert len(convolutions) == 20
    assert sum(m.weight.numel() for m in convolutions) == 11_166_912


def test_standardized_codes_have_mean_zero_and_one_deviation() -> None:
    with initialised(0):
        encoder = Encoder(EncoderConfig("wide_resnet", 8, 1), 5, torch.float32)
    images = torch.rand(6, 3, 32, 32, generator=generator(0))
    encoder.standardize(images)
    codes = encoder(images)
    torch.testing.assert_close(codes.mean(dim=0), torch.zeros(5), atol=1e-3, rtol=0)
    torch.testing.assert_close(codes.std(dim=0), torch.full((5,), CODE_NORM / 5**0.5), atol=1e-3, rtol=0)


def test_codes_of_features_have_mean_zero_and_one_deviation_and_say_where_things_are() -> None:
    with initialised(0):
        encoder = FeatureEncoder(3 + 5, 4)
    features = [torch.rand(9, 3, 32, 32, generator=generator(0)), 50 * torch.rand(9, 5, 8, 8, generator=generator(1))]
    encoder.standardize(features)
    codes = encoder(features)
    torch.testing.assert_close(codes.mean(dim=0), torch.zeros(4), atol=1e-3, rtol=0)
    torch.testing.assert_close(codes.std(dim=0), torch.full((4,), CODE_NORM / 4**0.5), atol=1e-3, rtol=0)
    assert (encoder([layer.flip(-1) for layer in features]) - codes).abs().amin() > 0


def test_whitened_colors_are_uncorrelated_and_of_one_size() -> None:
    encoder = Encoder(EncoderConfig("wide_resnet", 8, 1), 5, torch.float32)
    light = torch.rand(20, 1, 32, 32, generator=generator(0))
    hue = 0.1 * torch.rand(20, 3, 32, 32, generator=generator(1))
    images = 0.9 * light + hue
    encoder.whiten(images)
    met = []
    encoder.stem.register_forward_pre_hook(lambda _, arguments: met.append(arguments[0]))
    encoder(images)
    colors = met[0].transpose(0, 1).flatten(1)
    torch.testing.assert_close(colors.mean(dim=1), torch.zeros(3), atol=1e-3, rtol=0)
    torch.testing.assert_close(torch.cov(colors), torch.eye(3), atol=1e-2, rtol=0)


def test_whitening_does_not_magnify_what_photographs_lack() -> None:
    encoder = Encoder(EncoderConfig("wide_resnet", 8, 1), 5, torch.float32)
    encoder.whiten(torch.rand(4, 1, 32, 32, generator=generator(0)).expand(-1, 3, -1, -1))  # grey
    assert encoder.color_mixing.isfinite().all()
    assert encoder.color_mixing.abs().max() <= LEAST_COLOR_VARIANCE**-0.5


def test_code_tells_where_things_are() -> None:
    with initialised(0):
        encoder = Encoder(EncoderConfig("wide_resnet", 8, 1), 5, torch.float32)
    images = torch.zeros(1, 3, 32, 32)
    images[..., 2:8, 2:8] = 1
    assert not torch.allclose(encoder(images), encoder(images.flip(-1)), atol=1e-3)


def test_bfloat16_rounds_codes_and_gradients() -> None:
    images = torch.rand(4, 3, 32, 32, generator=generator(0))

    def code_and_gradient(precision: torch.dtype) -> list[torch.Tensor]:
        with initialised(0):
            encoder = Encoder(EncoderConfig("wide_resnet", 8, 1), 5, precision)
        code = encoder(images)
        code.square().sum().backward()
        gradient = next(encoder.parameters()).grad
        assert gradient is not None
        return [code.detach(), gradient]

    for exact, rounded in zip(code_and_gradient(torch.float32), code_and_gradient(torch.bfloat16), strict=True):
        assert rounded.dtype == torch.float32
        cosine = torch.cosine_similarity(rounded.flatten(), exact.flatten(), dim=0)
        assert 0.98 < cosine < 1 - 1e-7


def test_a_projected_shortcut_is_of_the_normalised_and_rectified_maps() -> None:
    with initialised(0):
        block = EncoderBlock(8, 16, 2)
    torch.nn.init.zeros_(block.convolution_2.weight)
    maps = torch.randn(2, 8, 6, 6, generator=generator(0))
    torch.testing.assert_close(block(maps), block.shortcut(block.normalize_1(maps).relu()))
