"""The feature losses against the formulas of the paper, written as loops."""

import torch
from torch import Tensor

from pipeline.losses.chamfer import chamfer
from pipeline.losses.feature_matching import feature_matching
from pipeline.losses.image_distance import feature_distance, pairwise_feature_distance
from pipeline.seeding import generator
from tests.gradients import assert_refuses_second_derivatives


def random_features(stream: str, count: int, dtype: torch.dtype = torch.float64) -> list[Tensor]:
    rng = generator(0, stream)
    shapes = [(count, 3, 4, 5), (count, 6, 2, 2)]
    return [torch.randn(shape, generator=rng, dtype=dtype) for shape in shapes]


def naive_distance(first: list[Tensor], second: list[Tensor]) -> Tensor:
    """Eq. 2 for one picture each, position by position."""
    total = torch.zeros((), dtype=torch.float64)
    for a, b in zip(first, second, strict=True):
        _, height, width = a.shape
        for k in range(height):
            for m in range(width):
                total = total + ((b[:, k, m] - a[:, k, m]) ** 2).sum().sqrt() / (height * width)
    return total


def picture(features: list[Tensor], index: int) -> list[Tensor]:
    return [layer[index] for layer in features]


def naive_pairwise(first: list[Tensor], second: list[Tensor]) -> Tensor:
    rows = [
        torch.stack([naive_distance(picture(first, i), picture(second, j)) for j in range(len(second[0]))])
        for i in range(len(first[0]))
    ]
    return torch.stack(rows)


def test_feature_distance_is_equation_two_summed_over_layers() -> None:
    first, second = random_features("first", 3), random_features("second", 3)
    torch.testing.assert_close(feature_distance(first, second), naive_pairwise(first, second).diagonal())


def test_gradients_of_the_distance_reach_both_pictures() -> None:
    first, second = random_features("first", 3), random_features("second", 3)
    for layer in [*first, *second]:
        layer.requires_grad_()
    own = torch.autograd.grad(feature_distance(first, second).sum(), [*first, *second])
    naive = torch.autograd.grad(naive_pairwise(first, second).diagonal().sum(), [*first, *second])
    for one, other in zip(own, naive, strict=True):
        torch.testing.assert_close(one, other)


def test_distances_of_bfloat16_features_are_taken_in_float32() -> None:
    first, second = random_features("first", 3), random_features("second", 3)
    low = [layer.bfloat16() for layer in second]
    for kept in (first, [layer.bfloat16() for layer in first]):
        pairs = [layer.detach().requires_grad_() for layer in [*kept, *low]]
        rounded = [layer.detach().float().requires_grad_() for layer in pairs]
        distances = [feature_distance(layers[: len(low)], layers[len(low) :]) for layers in (pairs, rounded)]
        assert distances[0].dtype == torch.promote_types(kept[0].dtype, torch.float32)
        torch.testing.assert_close(distances[0].float(), distances[1])
        own, expected = (
            torch.autograd.grad(d.sum(), layers) for d, layers in zip(distances, (pairs, rounded), strict=True)
        )
        for gradient, layer, wanted in zip(own, pairs, expected, strict=True):
            assert gradient.dtype == layer.dtype
            torch.testing.assert_close(gradient.float(), wanted, rtol=2**-7, atol=1e-6)


def test_pairwise_distance_is_the_distance_of_every_pair() -> None:
    first, second = random_features("first", 4), random_features("second", 3)
    expected = naive_pairwise(first, second).float()
    torch.testing.assert_close(pairwise_feature_distance(first, second), expected, rtol=1e-4, atol=1e-4)


def test_chamfer_is_equation_four_in_value_and_gradient() -> None:
    real, generated = random_features("real", 5), random_features("generated", 5)
    for layer in generated:
        layer.requires_grad_()
    pairs = naive_pairwise(real, generated)
    expected = (pairs.min(dim=1).values.sum() + pairs.min(dim=0).values.sum()) / 5
    actual = chamfer(real, generated)
    torch.testing.assert_close(actual, expected)
    for own, naive in zip(
        torch.autograd.grad(actual, generated), torch.autograd.grad(expected, generated), strict=True
    ):
        torch.testing.assert_close(own, naive)


def test_feature_matching_is_equation_three() -> None:
    real, generated = random_features("real", 5, torch.float32), random_features("generated", 4, torch.float32)
    expected = naive_distance(
        [layer.double().mean(0) for layer in real], [layer.double().mean(0) for layer in generated]
    )
    torch.testing.assert_close(feature_matching(real, generated).double(), expected, rtol=1e-5, atol=1e-5)


def test_gradient_is_finite_where_features_are_equal() -> None:
    real = random_features("real", 3, torch.float32)
    generated = [layer.clone().requires_grad_() for layer in real]
    (chamfer(real, generated) + feature_matching(real, generated)).backward()
    for layer in generated:
        assert layer.grad is not None
        assert torch.isfinite(layer.grad).all()


def test_second_derivatives_of_the_distance_are_refused() -> None:
    first, second = (random_features(stream, 2)[0] for stream in ("first", "second"))
    assert_refuses_second_derivatives(lambda a, b: feature_distance([a], [b]), first, second)


def test_half_precision_photographs_compare_with_float_renderings() -> None:
    real, generated = random_features("real", 3, torch.float32), random_features("generated", 3, torch.float32)
    kept = [layer.half() for layer in real]
    torch.testing.assert_close(chamfer(kept, generated), chamfer(real, generated), rtol=1e-2, atol=1e-3)
    torch.testing.assert_close(
        feature_distance(kept, generated), feature_distance(real, generated), rtol=1e-2, atol=1e-3
    )


def test_memory_layout_changes_no_distance() -> None:
    real, generated = random_features("real", 4), random_features("generated", 4)
    channels_last = [layer.contiguous(memory_format=torch.channels_last) for layer in generated]
    torch.testing.assert_close(chamfer(real, channels_last), chamfer(real, generated))
