"""The network learns either task, and a killed training ends with the bytes of an uninterrupted one."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.nn import functional

from pipeline.errors import ConfigError, DataError, TrainingDiverged
from pipeline.files import read_json
from pipeline.networks.feature_extractor import save_feature_extractor
from pipeline.networks.wide_resnet import WideResNet, load_wide_resnet
from pipeline.seeding import generator, initialised
from pipeline.training import features
from pipeline.training.augmentation import to_float
from pipeline.training.checkpoint import Checkpoint
from pipeline.training.curves import Curve
from pipeline.training.features import (
    FeaturesConfig,
    FeatureTrainer,
    Pictures,
    list_categories,
    load_pictures,
    measure,
    one_cycle,
    told_right,
    train_features,
)
from stages import train_features as stage
from stages.command_line import run

NO_WEIGHTS = Path("none.safetensors")
CONFIG = FeaturesConfig(
    method="classification",
    depth=10,
    width=1,
    epochs=6,
    batch_size=16,
    learning_rate=0.1,
    warm_up=0.25,
    momentum=0.9,
    weight_decay=5e-4,
    label_smoothing=0.1,
    color_weight=2.0,
    distance=10.0,
    crop_margin=2,
    checkpoint_every=3,
)


def bars(count: int, seed: int) -> Pictures:
    """Draw noisy pictures that are bright below a random height, and (label 1) in a post that stands on it."""
    rng = generator(seed, "bars")
    values = torch.randint(0, 128, (count, 3, 16, 16), generator=rng, dtype=torch.uint8)
    labels = torch.arange(count) % 2
    for picture, label in enumerate(labels.tolist()):
        top = int(torch.randint(9, 13, (), generator=rng))
        values[picture, :, top:] += 100
        if label:
            values[picture, :, :top, 6:10] += 100
    return Pictures(values, labels)


@pytest.mark.parametrize("method", ["classification", "rotation"])
def test_a_small_network_learns_the_task(method: str, tmp_path: Path) -> None:
    config = replace(CONFIG, method=method)
    network, curve = train_features(
        config, bars(192, 0), bars(64, 1), NO_WEIGHTS, torch.float32, 0, Checkpoint(tmp_path, "key")
    )
    right = told_right(network, bars(64, 1), config, torch.float32)
    assert right.mean() > 0.9
    assert [row["iteration"] for row in curve.rows] == [12, 24, 36, 48, 60, 72]
    assert curve.rows[-1]["test_accuracy"] == pytest.approx(right.mean().item(), abs=1e-6)


@pytest.mark.parametrize("method", ["classification", "rotation"])
def test_errors_are_over_pictures_of_which_all_turns_are_asked(
    method: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = replace(CONFIG, method=method)

    monkeypatch.setattr(WideResNet, "forward", lambda _, images: torch.eye(4)[0].expand(len(images), -1))
    monkeypatch.setattr(features, "load_wide_resnet", lambda *_: WideResNet(10, 1, 4))
    figures = measure(tmp_path, bars(6, 0), config, torch.device("cpu"))
    assert figures["n"] == 6
    assert figures["accuracy"] == (0.25 if method == "rotation" else 0.5)
    assert figures["accuracy_standard_error"] == pytest.approx(0 if method == "rotation" else 0.5 / 6**0.5)


def test_a_killed_training_ends_with_the_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = replace(CONFIG, epochs=2)
    train, test = bars(80, 0), bars(16, 1)

    def finish(name: str) -> tuple[bytes, list[dict[str, float]]]:
        network, curve = train_features(
            config, train, test, NO_WEIGHTS, torch.float32, 0, Checkpoint(tmp_path / name, "key")
        )
        save_feature_extractor(tmp_path / f"{name}.safetensors", network, 2.0, {})
        return (tmp_path / f"{name}.safetensors").read_bytes(), curve.rows

    uninterrupted = finish("uninterrupted")
    step = FeatureTrainer.step

    def killed(trainer: FeatureTrainer, iteration: int) -> dict[str, Tensor]:
        if iteration == 7:
            raise KeyboardInterrupt
        return step(trainer, iteration)

    monkeypatch.setattr(FeatureTrainer, "step", killed)
    with pytest.raises(KeyboardInterrupt):
        finish("killed")
    monkeypatch.setattr(FeatureTrainer, "step", step)
    assert finish("killed") == uninterrupted


def test_a_diverged_training_is_an_error_and_keeps_the_state_before(tmp_path: Path) -> None:
    checkpoint = Checkpoint(tmp_path, "key")
    config = replace(CONFIG, learning_rate=1e30, checkpoint_every=1)
    with pytest.raises(TrainingDiverged, match=r"of feature training became .* at iteration 2; look at the inputs"):
        train_features(config, bars(64, 0), bars(16, 1), NO_WEIGHTS, torch.float32, 0, checkpoint)
    restored = checkpoint.load()
    assert restored is not None
    assert restored[1]["iteration"] == 1


def test_one_category_alone_cannot_be_classified(tmp_path: Path) -> None:
    cars = Pictures(bars(16, 0).images, torch.zeros(16, dtype=torch.int64))
    with pytest.raises(ConfigError, match="set it to rotation"):
        train_features(CONFIG, cars, cars, NO_WEIGHTS, torch.float32, 0, Checkpoint(tmp_path, "key"))


def test_a_colour_that_is_the_same_everywhere_is_named(tmp_path: Path) -> None:
    images, labels = bars(16, 0)
    assert isinstance(images, Tensor)
    images[:, 1] = 255
    pictures = Pictures(images, labels)
    with pytest.raises(DataError, match="the green of all training pictures"):
        train_features(CONFIG, pictures, pictures, NO_WEIGHTS, torch.float32, 0, Checkpoint(tmp_path, "key"))


def test_one_cycle_rises_to_its_peak_and_falls_to_zero() -> None:
    rates = [one_cycle(iteration, 1000, 0.25) for iteration in range(1000)]
    assert max(rates) == pytest.approx(1, abs=2e-3)
    assert rates.index(max(rates)) == pytest.approx(250, abs=1)
    assert rates[0] < 0.003
    assert rates[-1] < 0.001


def test_pictures_of_a_missing_category_are_a_data_error(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="holds no pictures"):
        list_categories(tmp_path)
    with pytest.raises(DataError, match="car"):
        load_pictures(tmp_path, ["car"], torch.device("cpu"), 2**30)


def test_transfer_keeps_the_features_and_learns_the_categories(tmp_path: Path) -> None:
    train, test = bars(192, 0), bars(64, 1)
    first, _ = train_features(CONFIG, train, test, NO_WEIGHTS, torch.float32, 0, Checkpoint(tmp_path / "first", "key"))
    weights = tmp_path / "weights.safetensors"
    save_feature_extractor(weights, first, 2.0, {})
    config = replace(CONFIG, method="transfer")
    second, curve = train_features(
        config, train, test, weights, torch.float32, 1, Checkpoint(tmp_path / "second", "key")
    )
    images = test.images[:].float() / 255
    stored = load_wide_resnet(weights, torch.device("cpu"))
    for given, kept in zip(stored.features(images), second.features(images), strict=True):
        torch.testing.assert_close(kept, given, rtol=1e-4, atol=1e-4)
    assert not torch.equal(second.classifier.weight, stored.classifier.weight)
    assert curve.rows[-1]["test_accuracy"] > 0.8


def test_weights_of_another_size_cannot_be_transferred(tmp_path: Path) -> None:
    weights = tmp_path / "weights.safetensors"
    save_feature_extractor(weights, WideResNet(10, 2, 2), 2.0, {})
    with pytest.raises(ConfigError, match="WRN-10-2; set both"):
        train_features(
            replace(CONFIG, method="transfer"),
            bars(16, 0),
            bars(16, 1),
            weights,
            torch.float32,
            0,
            Checkpoint(tmp_path, "key"),
        )


def feature_trainer() -> FeatureTrainer:
    return FeatureTrainer(CONFIG, bars(64, 0), NO_WEIGHTS, torch.float32, 0)


def test_only_weights_of_convolutions_and_layers_decay() -> None:
    groups = feature_trainer().optimizer.param_groups
    assert [(group["weight_decay"], group["momentum"]) for group in groups] == [(5e-4, 0.9), (0.0, 0.9)]
    assert {parameter.ndim for parameter in groups[1]["params"]} == {1}


def test_colours_are_standardized_and_labels_smoothed() -> None:
    trainer, other = feature_trainer(), feature_trainer()
    images = bars(64, 0).images
    assert isinstance(images, Tensor)
    pixels = to_float(images)
    torch.testing.assert_close(trainer.network.mean.flatten(), pixels.mean(dim=(0, 2, 3)))
    torch.testing.assert_close(trainer.network.std.flatten(), pixels.std(dim=(0, 2, 3)), atol=1e-3, rtol=0)
    images, labels = other.batch(0)
    said = other.network.train()(to_float(images))
    expected = functional.cross_entropy(said, labels, label_smoothing=CONFIG.label_smoothing)
    torch.testing.assert_close(trainer.step(0)["train_loss"], expected)


def test_every_epoch_has_an_order_of_its_own() -> None:
    trainer, orders = feature_trainer(), []
    for epoch in range(2):
        trainer.batch(epoch * trainer.iterations_per_epoch)
        orders.append(trainer.order.tolist())
    assert orders[0] != orders[1]
    assert [sorted(order) for order in orders] == [list(range(64))] * 2


def test_pictures_are_shifted_by_up_to_the_margin() -> None:
    images = torch.randint(0, 100, (64, 3, 16, 16), generator=generator(0), dtype=torch.uint8)
    images[:, :, 8] = 255
    config = replace(CONFIG, batch_size=64, crop_margin=2)
    trainer = FeatureTrainer(config, Pictures(images, torch.arange(64) % 2), NO_WEIGHTS, torch.float32, 0)
    rows = trainer.batch(0).images.float().mean(dim=(1, 3)).argmax(dim=1)
    assert rows.unique().tolist() == [6, 7, 8, 9, 10]


def test_momentum_is_nesterovs() -> None:
    trainer = FeatureTrainer(CONFIG, bars(64, 0), NO_WEIGHTS, torch.float32, 0)
    assert all(group["nesterov"] for group in trainer.optimizer.param_groups)


def test_seeds_of_feature_training_differ() -> None:
    first, second = (FeatureTrainer(CONFIG, bars(64, 0), NO_WEIGHTS, torch.float32, seed) for seed in (0, 1))
    assert not torch.equal(first.network.stem.weight, second.network.stem.weight)
    for trainer in (first, second):
        trainer.batch(0)
    assert not torch.equal(first.order, second.order)


def test_the_stage_measures_on_test_pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for split, count in (("train", 8), ("test", 6)):
        (tmp_path / split).mkdir()
        images, labels = bars(count, 0)
        for label, name in enumerate(("plain", "post")):
            np.save(tmp_path / split / f"{name}.npy", images[labels == label].permute(0, 2, 3, 1).numpy())
    with initialised(0):
        network = WideResNet(10, 1, 2)
    monkeypatch.setattr(stage, "train_features", lambda *_: (network, Curve()))
    out, metrics, curve = (tmp_path / name for name in ("features.safetensors", "metrics.json", "curve.csv"))
    words = ["train_features", "--params", Path(__file__).parents[2] / "params.yaml", "--sections", "train_features"]
    words += ["sizes.laptop.train_features", "--images", tmp_path / "train", "--test-images", tmp_path / "test"]
    words += ["--initial", tmp_path / "train", "--seed", 0, "--checkpoints", tmp_path / "states", "--out", out]
    monkeypatch.setattr(sys, "argv", [str(word) for word in [*words, "--metrics", metrics, "--curve", curve]])
    run(stage.main)
    assert read_json(metrics)["n"] == 6
