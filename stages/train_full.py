"""Train the model that reads shape, pose, texture and background off one photograph (paper 3.2)."""

from argparse import Namespace
from pathlib import Path

from pipeline.config import load, scalar
from pipeline.datasets.images import load_images_of_size, place_images
from pipeline.distributed import is_first
from pipeline.files import write_json
from pipeline.geometry.camera import pose_to_tensor
from pipeline.launch import resolve_processes, share_work
from pipeline.networks.feature_extractor import load_feature_extractor
from pipeline.networks.full_model import save_full_model
from pipeline.networks.scene_generator import load_scenes
from pipeline.training.checkpoint import Checkpoint, reserved, restart_key
from pipeline.training.full import load_base, train_full
from pipeline.training.full_trainer import FullTrainer, FullTrainingConfig
from pipeline.training.photographs import Photographs
from stages.command_line import parse, run
from stages.machine import Machine, load_machine


def main() -> None:
    """Train in as many processes as the parameters say."""
    paths = dict.fromkeys(["images", "features", "base_shape", "mesh", "checkpoints", "out", "metrics", "curve"], Path)
    arguments = parse(__doc__, **paths, seed=int)
    config = load(arguments.params, FullTrainingConfig, arguments.sections)
    machine = load_machine(arguments.params)
    processes = resolve_processes(scalar(arguments.params, "processes.train_full"), machine.device, parts=1)
    with reserved(arguments.checkpoints):
        share_work(processes, machine.device, train, config, arguments, machine)


def train(config: FullTrainingConfig, arguments: Namespace, machine: Machine) -> None:
    """Train around the base mesh, then write the model, the recorded best poses, and the curve."""
    device, precision, memory = machine
    inputs = [arguments.images, arguments.features, arguments.base_shape, arguments.mesh]
    checkpoint = Checkpoint(arguments.checkpoints, restart_key(config, inputs, arguments.seed, device, precision))
    images = place_images([load_images_of_size(arguments.images, config.model.renderer.size)], device, memory)
    extractor = load_feature_extractor(arguments.features, device, precision)
    trainer, curve = train_full(
        config,
        Photographs(images, extractor, config.batch_size, memory),
        load_base(config, arguments.mesh, device),
        load_scenes(arguments.base_shape, arguments.mesh, config.model.renderer.size, device),
        arguments.seed,
        checkpoint,
    )
    if not is_first():
        return
    curve.write(arguments.curve)
    write_json(arguments.metrics, curve.rows[-1])
    save(trainer, arguments.out)
    checkpoint.clear()


def save(trainer: FullTrainer, path: Path) -> None:
    """Write the model and the poses it recorded of the training photographs."""
    recorded = {"train_pose": pose_to_tensor(trainer.records.poses()), "train_visits": trainer.records.visits}
    save_full_model(path, trainer.model, recorded)


if __name__ == "__main__":
    run(main)
