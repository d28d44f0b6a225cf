import math

import torch

from pipeline.evaluation.image import psnr, ssim
from pipeline.evaluation.image_metrics import image_columns, image_figures
from tests.tiny_full_model import tiny_extractor


def test_psnr_of_a_constant_error() -> None:
    first = torch.full((2, 3, 16, 16), 0.5)
    second = first + torch.tensor([0.1, 0.01])[:, None, None, None]
    torch.testing.assert_close(psnr(first, second), torch.tensor([20.0, 40.0]), atol=1e-3, rtol=0)


def test_identical_pictures_are_bounded() -> None:
    images = torch.rand(2, 3, 16, 16, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(psnr(images, images), torch.tensor([100.0, 100.0]))
    torch.testing.assert_close(ssim(images, images), torch.ones(2))


def test_ssim_of_flat_pictures_is_the_luminance_term() -> None:
    first, second = torch.full((1, 3, 16, 16), 0.2).double(), torch.full((1, 3, 16, 16), 0.6).double()
    expected = (2 * 0.2 * 0.6 + 1e-4) / (0.2**2 + 0.6**2 + 1e-4)
    torch.testing.assert_close(ssim(first, second), torch.tensor([expected], dtype=torch.float64))


def test_ssim_of_a_negative_is_minus_the_structure_term() -> None:
    stripes = torch.tensor([0.25, 0.75], dtype=torch.float64).repeat(16)[:, None].expand(1, 3, 32, 32)
    weights = torch.exp(-(torch.arange(-5, 6, dtype=torch.float64) ** 2) / (2 * 1.5**2))
    weights = weights / weights.sum()
    means = torch.stack([(weights * stripes[0, 0, :11, 0]).sum(), (weights * stripes[0, 0, 1:12, 0]).sum()])
    variances = 0.0625 - (means - 0.5) ** 2
    luminance = (2 * means * (1 - means) + 1e-4) / (means**2 + (1 - means) ** 2 + 1e-4)
    expected = (luminance * (9e-4 - 2 * variances) / (9e-4 + 2 * variances)).mean()
    torch.testing.assert_close(ssim(stripes, 1 - stripes)[0], expected)


def test_ssim_is_symmetric_and_falls_with_noise() -> None:
    rng = torch.Generator().manual_seed(1)
    images, noise = torch.rand(1, 3, 32, 32, generator=rng), torch.randn(1, 3, 32, 32, generator=rng)
    little, much = ssim(images, images + 0.02 * noise), ssim(images, images + 0.2 * noise)
    assert 1 > little > much
    torch.testing.assert_close(ssim(images + 0.2 * noise, images), much)


def test_photographs_pass_through_the_network_once() -> None:
    seen: list[torch.Tensor] = []
    extractor = tiny_extractor()
    extractor.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[0]))
    images = torch.rand(5, 3, 32, 32, generator=torch.Generator().manual_seed(0))
    drawn = {"predicted": images.flip(0), "tuned": images}
    columns = image_columns(images, drawn, extractor, 2)
    for part, expected in enumerate([images, *drawn.values()]):
        assert torch.equal(torch.cat(seen[part::3]), expected)
    assert len(seen) == 9
    assert columns["tuned"]["feature_distance"].tolist() == [0] * 5
    apart = columns["predicted"]["feature_distance"]
    assert apart[2] == 0  # the middle one of five
    assert (apart[[0, 1, 3, 4]] > 0).all()


def test_improved_is_the_share_of_lower_distances() -> None:
    predicted = {"feature_distance": torch.tensor([1.0, 2.0, 3.0, 4.0])}
    tuned = {"feature_distance": torch.tensor([0.5, 1.0, 3.0, 2.0])}
    improved = image_figures({"predicted": predicted, "tuned": tuned})["improved"]
    assert improved["value"] == 0.75
    assert improved["n"] == 4
    assert math.isclose(improved["standard_error"], 0.25)
