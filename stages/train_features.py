"""Train the network whose features pictures are compared in (paper 4.1)."""

import math
from pathlib import Path

import torch

from pipeline.config import load, scalar
from pipeline.device import resolve_device
from pipeline.files import write_json
from pipeline.networks.wide_resnet import load_wide_resnet, save_feature_extractor
from pipeline.training.checkpoint import Checkpoint, restart_key
from pipeline.training.features import (
    FeaturesConfig,
    Pictures,
    accuracy,
    list_categories,
    load_pictures,
    train_features,
    trials,
)
from stages.command_line import parse, run


def main() -> None:
    """Train on every category of the data set; write the weights, the accuracy they reach and the curve."""
    paths = dict.fromkeys(["images", "test_images", "initial", "checkpoints", "out", "metrics", "curve"], Path)
    arguments = parse(__doc__, **paths, seed=int)
    config = load(arguments.params, FeaturesConfig, arguments.sections)
    device = resolve_device(scalar(arguments.params, "device"))
    categories = list_categories(arguments.images)
    train = load_pictures(arguments.images, categories, device)
    test = load_pictures(arguments.test_images, categories, device)
    inputs = [arguments.images, arguments.test_images, arguments.initial]
    checkpoint = Checkpoint(arguments.checkpoints, restart_key(config, inputs, arguments.seed))
    network, curve = train_features(config, train, test, arguments.initial, arguments.seed, checkpoint)
    metadata = {"categories": " ".join(categories), "method": config.method}
    save_feature_extractor(arguments.out, network, config.color_weight, metadata)
    curve.write(arguments.curve)
    write_json(arguments.metrics, measure(arguments.out, test, config, device))
    checkpoint.clear()


def measure(path: Path, test: Pictures, config: FeaturesConfig, device: torch.device) -> dict[str, float]:
    """Measure the accuracy of the weights as they are stored."""
    network = load_wide_resnet(path, device)
    value, n = accuracy(network, test, config), trials(test, config)
    parameters = sum(parameter.numel() for parameter in network.parameters())
    error = math.sqrt(value * (1 - value) / n)
    return {"accuracy": value, "accuracy_standard_error": error, "n": n, "parameters": parameters}


if __name__ == "__main__":
    run(main)
