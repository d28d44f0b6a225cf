"""Train the network whose features pictures are compared in, or take over a given one (paper 4.1, 4.2)."""

from argparse import Namespace
from pathlib import Path

from pipeline.config import load, scalar
from pipeline.datasets.images import placed_bytes
from pipeline.distributed import is_first
from pipeline.files import write_json
from pipeline.launch import resolve_processes, share_work
from pipeline.networks.feature_extractor import save_feature_extractor
from pipeline.training.checkpoint import Checkpoint, reserved, restart_key
from pipeline.training.curves import Curve
from pipeline.training.features import (
    FeaturesConfig,
    count_parameters,
    list_categories,
    load_pictures,
    measure,
    train_features,
)
from pipeline.training.pretrained import adopt
from stages.command_line import parse, run
from stages.machine import Machine, load_machine


def main() -> None:
    """Train in as many processes as the parameters say."""
    paths = dict.fromkeys(["images", "test_images", "initial", "checkpoints", "out", "metrics", "curve"], Path)
    arguments = parse(__doc__, **paths, seed=int)
    config = load(arguments.params, FeaturesConfig, arguments.sections)
    machine = load_machine(arguments.params)
    processes = resolve_processes(scalar(arguments.params, "processes.train_features"), machine.device, parts=1)
    with reserved(arguments.checkpoints):
        share_work(processes, machine.device, train, config, arguments, machine)


def train(config: FeaturesConfig, arguments: Namespace, machine: Machine) -> None:
    """Train on every category of the data set; write the weights, the figures they reach and the curve."""
    device, precision, memory = machine
    categories = list_categories(arguments.images)
    pictures = load_pictures(arguments.images, categories, device, memory)
    metadata = {"categories": " ".join(categories), "method": config.method}
    if config.method == "pretrained":
        if is_first():
            given = adopt(arguments.initial, pictures.images, config.distance, arguments.seed)
            save_feature_extractor(arguments.out, given, config.color_weight, metadata)
            Curve().write(arguments.curve)
            write_json(arguments.metrics, {"maps": given.maps, "parameters": count_parameters(given)})
        return
    test = load_pictures(arguments.test_images, categories, device, memory - placed_bytes(pictures.images))
    inputs = [arguments.images, arguments.test_images]
    if config.method == "transfer":
        inputs.append(arguments.initial)
    checkpoint = Checkpoint(arguments.checkpoints, restart_key(config, inputs, arguments.seed, device, precision))
    seed = arguments.seed
    network, curve = train_features(config, pictures, test, arguments.initial, precision, seed, checkpoint)
    if not is_first():
        return
    save_feature_extractor(arguments.out, network, config.color_weight, metadata)
    curve.write(arguments.curve)
    write_json(arguments.metrics, measure(arguments.out, test, config, device))
    checkpoint.clear()


if __name__ == "__main__":
    run(main)
