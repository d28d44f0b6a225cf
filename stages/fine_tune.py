"""Fit background, pose and shape to each test photograph (paper 3.2.4)."""

from argparse import Namespace
from pathlib import Path

from torch import Tensor

from pipeline.config import load
from pipeline.datasets.images import load_images, place_images
from pipeline.files import write_json
from pipeline.networks.feature_extractor import load_feature_extractor
from pipeline.networks.full_model import load_full_model
from pipeline.tensor_files import save_tensors
from pipeline.training.checkpoint import Checkpoint, reserved, restart_key
from pipeline.training.fine_tune import FineTuneConfig, fine_tune
from stages.command_line import parse, run
from stages.machine import load_machine


def main() -> None:
    """Fine-tune unless another call is using the same restart states."""
    arguments = parse(__doc__, images=Path, features=Path, model=Path, checkpoints=Path, out=Path, metrics=Path)
    with reserved(arguments.checkpoints):
        tune(arguments)


def tune(arguments: Namespace) -> None:
    """Reconstruct the test photographs, fine-tune each reconstruction, and write both with their losses."""
    config = load(arguments.params, FineTuneConfig, arguments.sections)
    device, precision, memory = load_machine(arguments.params)
    inputs = [arguments.images, arguments.features, arguments.model]
    checkpoint = Checkpoint(arguments.checkpoints, restart_key(config, inputs, None, device, precision))
    results = fine_tune(
        config,
        place_images([load_images(arguments.images)], device, memory),
        load_full_model(arguments.model, device),
        load_feature_extractor(arguments.features, device, precision),
        checkpoint,
    )
    write_json(arguments.metrics, summary(results))
    save_tensors(arguments.out, results, {})
    checkpoint.clear()


def summary(results: dict[str, Tensor]) -> dict[str, float]:
    """Return mean feature distances before and after, and the share of photographs whose distance fell."""
    predicted, tuned = results["feature_distance_predicted"], results["feature_distance_tuned"]
    return {
        "feature_distance_predicted": predicted.mean().item(),
        "feature_distance_tuned": tuned.mean().item(),
        "lowered": (tuned < predicted).float().mean().item(),
        "photographs": len(tuned),
    }


if __name__ == "__main__":
    run(main)
