"""The network's size, the folding of its normalisations, and the file it travels in."""

from pathlib import Path

import pytest
import torch

from pipeline.errors import DataError
from pipeline.networks.feature_extractor import (
    FeatureExtractor,
    extract,
    load_feature_extractor,
    save_feature_extractor,
)
from pipeline.networks.wide_resnet import WideResNet, load_wide_resnet
from pipeline.seeding import generator, initialised
from pipeline.tensor_files import save_tensors

CPU = torch.device("cpu")


def trained_like(depth: int = 10, width: int = 1) -> WideResNet:
    """Build a network whose normalisations have statistics and weights of their own."""
    rng = generator(0, "statistics")
    with initialised(0, "network"):
        network = WideResNet(depth, width, 10)
    for module in network.modules():
        if isinstance(module, torch.nn.BatchNorm2d):
            for tensor in (module.running_var, module.weight.data):
                assert tensor is not None
                tensor.uniform_(0.5, 2.0, generator=rng)
            for tensor in (module.running_mean, module.bias.data):
                assert tensor is not None
                tensor.uniform_(-0.5, 0.5, generator=rng)
    return network.eval()


def random_images(count: int = 4) -> torch.Tensor:
    return torch.rand(count, 3, 32, 32, generator=generator(0, "images"))


def test_wrn_16_4_has_the_published_number_of_parameters() -> None:
    assert sum(parameter.numel() for parameter in WideResNet(16, 4, 10).parameters()) == 2_748_890


def test_depth_must_be_six_n_plus_four() -> None:
    with pytest.raises(ValueError, match="6 N \\+ 4"):
        WideResNet(18, 1, 10)


def test_features_are_the_group_outputs_before_sub_sampling() -> None:
    shapes = [tuple(layer.shape) for layer in FeatureExtractor(WideResNet(16, 4, 10), 2.0)(random_images(2))]
    assert shapes == [(2, 3, 32, 32), (2, 64, 32, 32), (2, 128, 16, 16), (2, 256, 8, 8)]


def test_features_are_those_of_colours_in_units_of_the_networks_mean_and_deviation() -> None:
    network, plain, images = trained_like(), trained_like(), random_images(2)
    network.mean.fill_(0.4)
    network.std.fill_(0.2)
    plain.mean.fill_(0.0)
    plain.std.fill_(1.0)
    torch.testing.assert_close(network.features(images), plain.features((images - 0.4) / 0.2))


def test_folding_changes_no_feature() -> None:
    network = trained_like(16, 2).double()  # in float32 rounding moves single features by 1e-4, on some processors
    images = random_images().double()
    colors, *folded_features = FeatureExtractor(network, 2.0)(images)
    assert torch.equal(colors, 2 * images)
    for folded, plain in zip(folded_features, network.features(images), strict=True):
        torch.testing.assert_close(folded, plain, rtol=1e-9, atol=1e-9)


def test_bfloat16_rounds_features_and_gradients() -> None:
    network, pictures = trained_like(16, 2), random_images()

    def maps_and_gradient(precision: torch.dtype) -> list[torch.Tensor]:
        images = pictures.clone().requires_grad_()
        colors, *maps = FeatureExtractor(network, 2.0).to(precision)(images)
        assert all(layer.dtype == precision for layer in maps)
        assert torch.equal(colors, 2 * pictures)
        torch.stack([layer.float().square().mean() for layer in maps]).sum().backward()
        assert images.grad is not None
        return [*(layer.detach().float() for layer in maps), images.grad]

    for exact, rounded in zip(maps_and_gradient(torch.float32), maps_and_gradient(torch.bfloat16), strict=True):
        cosine = torch.cosine_similarity(rounded.flatten(), exact.flatten(), dim=0)
        assert 0.99 < cosine < 1 - 1e-7


def test_folding_leaves_the_network_itself_alone() -> None:
    network = trained_like()
    before = network(random_images())
    FeatureExtractor(network, 2.0)
    assert torch.equal(network(random_images()), before)


def test_extractor_is_frozen_in_training_mode_too() -> None:
    extractor = FeatureExtractor(trained_like(), 2.0)
    before = extractor(random_images())
    extractor.train()
    after = extractor(random_images())
    assert all(torch.equal(a, b) for a, b in zip(before, after, strict=True))
    assert not any(parameter.requires_grad for parameter in extractor.parameters())


def test_gradients_reach_the_images() -> None:
    images = random_images().requires_grad_()
    features = FeatureExtractor(trained_like(), 2.0)(images)[1:]
    torch.stack([layer.square().mean() for layer in features]).sum().backward()
    assert images.grad is not None
    assert (images.grad.flatten(1).norm(dim=1) > 0).all()


def test_a_network_survives_its_file(tmp_path: Path) -> None:
    network = trained_like()
    path = tmp_path / "features.safetensors"
    save_feature_extractor(path, network, 2.0, {"method": "classification"})
    assert path.stat().st_size < 2.2 * sum(tensor.numel() for tensor in network.state_dict().values())
    images = random_images()
    torch.testing.assert_close(load_wide_resnet(path, CPU)(images), network(images), rtol=0.02, atol=0.02)
    for loaded, own in zip(
        load_feature_extractor(path, CPU, torch.float32)(images), FeatureExtractor(network, 2.0)(images), strict=True
    ):
        torch.testing.assert_close(loaded, own, rtol=0.02, atol=0.02)


def test_counters_are_no_numbers_of_half_precision(tmp_path: Path) -> None:
    network, path = trained_like(), tmp_path / "features.safetensors"
    counters = {
        name: buffer.fill_(70_001) for name, buffer in network.named_buffers() if not buffer.is_floating_point()
    }
    save_feature_extractor(path, network, 2.0, {})
    loaded = load_wide_resnet(path, CPU).state_dict()
    assert counters
    assert all(loaded[name].equal(counter) for name, counter in counters.items())


def test_a_file_of_something_else_is_a_data_error(tmp_path: Path) -> None:
    path = tmp_path / "mesh.safetensors"
    save_tensors(path, {"vertices": torch.zeros(3, 3)}, {})
    with pytest.raises(DataError, match=r"mesh\.safetensors holds no wide residual network"):
        load_feature_extractor(path, CPU, torch.float32)


def test_kept_features_are_those_of_the_pictures() -> None:
    extractor = FeatureExtractor(trained_like(), 2.0)
    images = (random_images(5) * 255).to(torch.uint8)
    for kept, own in zip(extract(extractor, images, 2), extractor(images.float() / 255), strict=True):
        assert kept.dtype == torch.float16
        assert kept.is_contiguous(memory_format=torch.channels_last)
        torch.testing.assert_close(kept.float(), own, rtol=2e-3, atol=2e-3)
