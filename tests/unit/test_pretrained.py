"""Given networks compute what their authors' do, from files in their authors' names, or are refused in one sentence."""

import math
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file
from torch import Tensor
from torch.nn import functional

from pipeline.errors import ConfigError, DataError
from pipeline.files import read_json
from pipeline.losses.image_distance import feature_distance
from pipeline.networks.feature_extractor import FeatureExtractor, load_feature_extractor, save_feature_extractor
from pipeline.networks.pretrained import ARCHITECTURES, PretrainedNetwork, load_pretrained, read_pretrained
from pipeline.seeding import generator, initialised
from pipeline.tensor_files import save_tensors
from pipeline.training.exploration import require_maps
from pipeline.training.pretrained import adopt, mean_distances
from stages import train_features
from stages.command_line import run

ROOT = Path(__file__).parents[2]
CPU = torch.device("cpu")
Weights = dict[str, Tensor]


def draw(architecture: str) -> Weights:
    """Draw weights that keep the size of features from layer to layer, as trained ones do."""
    with initialised(0):
        layers = ARCHITECTURES[architecture].layers()
    return {name: 2.4 * weight for name, weight in layers.state_dict().items()}


def alexnet_weights() -> Weights:
    """Return weights under torchvision's names, with a layer that is not read."""
    layers = {f"features.{name}": weight for name, weight in draw("alexnet").items()}
    return layers | {"classifier.1.bias": torch.zeros(2)}


def squeezenet_weights() -> Weights:
    """Return weights under Caffe's names, with a layer that is not read."""
    return draw("squeezenet") | {"conv_final.bias": torch.zeros(2)}


def write(path: Path, weights: Weights) -> Path:
    if path.suffix == ".npz":
        np.savez(path, allow_pickle=False, **{name: weight.numpy() for name, weight in weights.items()})
    else:
        save_file(weights, path)
    return path


def random_images(count: int = 2, size: int = 64) -> Tensor:
    return torch.rand(count, 3, size, size, generator=generator(0, "images"))


def convolve(x: Tensor, weights: Weights, name: str, stride: int = 1, padding: int = 0) -> Tensor:
    return functional.conv2d(x, weights[f"{name}.weight"], weights[f"{name}.bias"], stride, padding).relu()


def pool(x: Tensor) -> Tensor:
    """Pool by Caffe's rule: as many 3x3 windows, two apart, as cover the map."""
    missing = 2 * math.ceil((x.shape[-1] - 3) / 2) + 3 - x.shape[-1]
    windows = functional.pad(x, (0, missing, 0, missing), value=-torch.inf).unfold(2, 3, 2).unfold(3, 3, 2)
    return windows.amax(dim=(4, 5))


def fire(x: Tensor, weights: Weights, name: str) -> Tensor:
    squeezed = convolve(x, weights, f"{name}.conv1x1_1")
    one, three = f"{name}.conv1x1_2", f"{name}.conv3x3_2"
    return torch.cat([convolve(squeezed, weights, one), convolve(squeezed, weights, three, padding=1)], 1)


def squeezenet_maps(images: Tensor, weights: Weights) -> list[Tensor]:
    blue_green_red = 255 * images[:, [2, 1, 0]] - torch.tensor([104.0, 117.0, 123.0])[:, None, None]
    conv1 = convolve(blue_green_red, weights, "conv1", stride=2)
    fire4 = fire(fire(fire(pool(conv1), weights, "fire2"), weights, "fire3"), weights, "fire4")
    fire6 = fire(fire(pool(fire4), weights, "fire5"), weights, "fire6")
    fire7 = fire(fire6, weights, "fire7")
    return [conv1, fire4, fire6, fire7, fire(fire7, weights, "fire8")]


def alexnet_maps(images: Tensor, weights: Weights) -> list[Tensor]:
    mean, std = torch.tensor([[0.485, 0.456, 0.406], [0.229, 0.224, 0.225]])[:, :, None, None]
    conv1 = convolve((images - mean) / std, weights, "features.0", 4, 2)
    conv2 = convolve(functional.max_pool2d(conv1, 3, 2), weights, "features.3", padding=2)
    conv3 = convolve(functional.max_pool2d(conv2, 3, 2), weights, "features.6", padding=1)
    conv4 = convolve(conv3, weights, "features.8", padding=1)
    return [conv1, conv2, conv3, conv4, convolve(conv4, weights, "features.10", padding=1)]


@pytest.mark.parametrize(
    ("weights", "reference", "file", "sizes"),
    [
        (squeezenet_weights(), squeezenet_maps, "squeezenet.npz", [29, 14, 7, 7, 7]),
        (alexnet_weights(), alexnet_maps, "alexnet.safetensors", [15, 7, 3, 3, 3]),
    ],
)
def test_maps_are_those_of_the_authors_network(
    tmp_path: Path, weights: Weights, reference: Callable[[Tensor, Weights], list[Tensor]], file: str, sizes: list[int]
) -> None:
    network = read_pretrained(write(tmp_path / file, weights))
    images = random_images()
    maps = network.features(images, 5)
    assert [layer.shape[-1] for layer in maps] == sizes
    for layer, expected in zip(maps, reference(images, weights), strict=True):
        torch.testing.assert_close(layer, expected, rtol=1e-4, atol=1e-4 * expected.max().item())
    assert len(FeatureExtractor(network, 2.0)(images, 3)) == 3


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("none.npz", None, r"none\.npz does not exist; give the path of a network's weights"),
        ("text.npz", b"weights", r"text\.npz cannot be read as \.npz or \.safetensors \(.+\); convert it"),
        ("alexnet.pth", b"weights", r"alexnet\.pth cannot be read as \.npz or \.safetensors \(.+\); convert it"),
    ],
)
def test_a_file_of_another_format_is_one_sentence(
    tmp_path: Path, name: str, content: bytes | None, message: str
) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(DataError, match=message):
        read_pretrained(tmp_path / name)


def test_pickled_weights_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "weights.npz", allow_pickle=True, **{"conv1.weight": np.array([{}], dtype=object)})
    with pytest.raises(DataError, match=r"weights\.npz cannot be read"):
        read_pretrained(tmp_path / "weights.npz")


def test_what_a_file_holds_besides_is_not_read(tmp_path: Path) -> None:
    weights = {name: weight.numpy() for name, weight in squeezenet_weights().items()}
    others = {"classes": np.array(["tench"]), "meta": np.array([{}], dtype=object), "version": np.array([1], ">i4")}
    np.savez(tmp_path / "weights.npz", allow_pickle=True, **weights, **others)
    assert read_pretrained(tmp_path / "weights.npz").description == {"architecture": "squeezenet"}


@pytest.mark.parametrize("place", [60, 100, 200])
def test_damaged_compression_is_one_sentence(tmp_path: Path, place: int) -> None:
    weights = {name: np.zeros(weight.shape, np.float32) for name, weight in squeezenet_weights().items()}
    np.savez_compressed(tmp_path / "weights.npz", allow_pickle=False, **weights)
    content = bytearray((tmp_path / "weights.npz").read_bytes())
    start = content.index(b"conv1.weight.npy") + place
    content[start : start + 20] = bytes(255 - byte for byte in content[start : start + 20])
    (tmp_path / "weights.npz").write_bytes(content)
    with pytest.raises(DataError, match=r"weights\.npz cannot be read as \.npz"):
        read_pretrained(tmp_path / "weights.npz")


def test_weights_of_another_network_are_one_sentence(tmp_path: Path) -> None:
    weights = alexnet_weights() | {"features.6.weight": torch.zeros(384, 192, 5, 5)}
    message = r"has no features\.6\.weight \(384, 192, 3, 3\) of alexnet and no conv1\.weight \(96, 3, 7, 7\) of squeez"
    with pytest.raises(DataError, match=message):
        read_pretrained(write(tmp_path / "weights.safetensors", weights))


def photographs(count: int) -> Tensor:
    return (255 * random_images(count)).to(torch.uint8)


def test_photographs_are_as_far_apart_as_wanted_in_every_map(tmp_path: Path) -> None:
    path = write(tmp_path / "squeezenet.npz", squeezenet_weights())
    network = adopt(path, photographs(70), 65.0, seed=0)
    torch.testing.assert_close(mean_distances(network, photographs(70), seed=0), torch.full((5,), 13.0))


@pytest.mark.parametrize("value", [0.0, math.nan])
def test_maps_that_tell_no_photographs_apart_are_named(tmp_path: Path, value: float) -> None:
    weights = squeezenet_weights()
    for name in ("fire8.conv1x1_2", "fire8.conv3x3_2"):
        weights[f"{name}.weight"] = torch.full_like(weights[f"{name}.weight"], value)
    path = write(tmp_path / "squeezenet.npz", weights)
    with pytest.raises(DataError, match=r"squeezenet\.npz: photographs do not differ, .* in feature map 4 of 5; give"):
        adopt(path, photographs(9), 65.0, seed=0)


def test_a_given_network_survives_its_file_and_is_told_by_it(tmp_path: Path) -> None:
    network = adopt(write(tmp_path / "alexnet.safetensors", alexnet_weights()), photographs(9), 65.0, seed=0)
    save_feature_extractor(tmp_path / "features.safetensors", network, 20.0, {"method": "pretrained"})
    images = random_images()
    loaded, own = (
        load_feature_extractor(tmp_path / "features.safetensors", CPU, torch.float32),
        FeatureExtractor(network, 20.0),
    )
    for stored, expected in zip(loaded(images), own(images), strict=True):
        torch.testing.assert_close(stored, expected, rtol=0.02, atol=0.02)
    save_tensors(tmp_path / "features.safetensors", {}, {"architecture": "vgg"})
    with pytest.raises(DataError, match="holds no pretrained network"):
        load_feature_extractor(tmp_path / "features.safetensors", CPU, torch.float32)


def test_the_distance_grows_with_the_shift_of_an_object(tmp_path: Path) -> None:
    network = adopt(write(tmp_path / "squeezenet.npz", squeezenet_weights()), photographs(9), 65.0, seed=0)
    pictures = torch.full((4, 3, 64, 64), 0.2)
    for picture, shift in zip(pictures, (0, 1, 4, 16), strict=True):
        picture[:, 16:48, 8 + shift : 40 + shift] = 0.8
    features = FeatureExtractor(network, 0.0)(pictures)
    distances = feature_distance([layer[:1].expand_as(layer) for layer in features], features)
    assert distances[0] == 0
    assert (distances.diff() > 0.2).all()


def test_more_weights_than_maps_are_one_sentence() -> None:
    extractor = FeatureExtractor(PretrainedNetwork("alexnet"), 20.0)
    require_maps((1.0,) * 6, extractor, "fine_tune.map_weights")
    with pytest.raises(ConfigError, match=r"fine_tune\.map_weights is \[1.*\], but the features are 6 maps"):
        require_maps((1.0,) * 7, extractor, "fine_tune.map_weights")
    with pytest.raises(ConfigError, match=r"fine_tune\.map_weights is \[\]"):
        require_maps((), extractor, "fine_tune.map_weights")
    with pytest.raises(ConfigError, match="not all of them 0"):
        require_maps((0.0, 0.0), extractor, "fine_tune.map_weights")


def test_the_stage_takes_a_network_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for split in ("train", "test"):
        (tmp_path / split).mkdir()
        np.save(tmp_path / split / "car.npy", photographs(5).permute(0, 2, 3, 1).numpy())
    weights = write(tmp_path / "squeezenet.npz", squeezenet_weights())
    out, metrics, curve = (tmp_path / name for name in ("features.safetensors", "metrics.json", "curve.csv"))
    sections = ["--sections", "train_features", "sizes.laptop-imagenet.train_features"]
    inputs = ["--images", tmp_path / "train", "--test-images", tmp_path / "test", "--initial", weights, "--seed", 0]
    outputs = ["--checkpoints", tmp_path, "--out", out, "--metrics", metrics, "--curve", curve]
    words = ["train_features", "--params", ROOT / "params.yaml", *sections, *inputs, *outputs]
    monkeypatch.setattr(sys, "argv", [str(word) for word in words])
    run(train_features.main)
    assert read_json(metrics) == {"maps": 5, "parameters": 538_240}
    assert curve.read_text() == "iteration\n"
    distances = mean_distances(load_pretrained(out), photographs(5), seed=0)
    torch.testing.assert_close(distances, torch.full((5,), 13.0), rtol=0.01, atol=0)
