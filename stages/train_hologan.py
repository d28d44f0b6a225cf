"""Train the baseline HoloGAN on the photographs of a run (Nguyen-Phuoc et al. 2019)."""

from argparse import Namespace
from pathlib import Path

import torch

from pipeline.config import load, scalar
from pipeline.datasets.images import load_images
from pipeline.device import resolve_device
from pipeline.files import write_json
from pipeline.networks.hologan import save_hologan
from pipeline.training.checkpoint import Checkpoint, reserved, restart_key
from pipeline.training.hologan import HoloGANTrainingConfig, train_hologan
from stages.command_line import parse, run


def main() -> None:
    """Train unless another call is using the same restart states."""
    arguments = parse(__doc__, images=Path, seed=int, checkpoints=Path, out=Path, metrics=Path, curve=Path)
    with reserved(arguments.checkpoints):
        train(arguments)


def train(arguments: Namespace) -> None:
    """Train, then write the generator and the curve of its losses; the last row is the metrics."""
    config = load(arguments.params, HoloGANTrainingConfig, arguments.sections)
    device = resolve_device(scalar(arguments.params, "device"))
    key = restart_key(config, [arguments.images], arguments.seed, device, torch.float32)
    checkpoint = Checkpoint(arguments.checkpoints, key)
    images = load_images(arguments.images).to(device)
    generator, curve = train_hologan(config, images, arguments.seed, checkpoint)
    curve.write(arguments.curve)
    write_json(arguments.metrics, curve.rows[-1])
    save_hologan(arguments.out, generator)
    checkpoint.clear()


if __name__ == "__main__":
    run(main)
