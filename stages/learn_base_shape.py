"""Learn a category's base shape from its photographs (paper 3.1)."""

from argparse import Namespace
from pathlib import Path

from pipeline.config import load, scalar
from pipeline.datasets.images import load_images_to_reduce, place_images
from pipeline.distributed import is_first
from pipeline.files import write_json
from pipeline.launch import resolve_processes, share_work
from pipeline.networks.feature_extractor import load_feature_extractor
from pipeline.networks.scene_generator import scene_metadata, scene_tensors
from pipeline.tensor_files import save_tensors
from pipeline.training.base_shape import BaseShapeConfig, BaseShapes, learn_base_shape
from pipeline.training.checkpoint import Checkpoint, reserved, restart_key
from pipeline.training.photographs import Photographs
from stages.command_line import parse, run
from stages.machine import Machine, load_machine


def main() -> None:
    """Learn in as many processes as the parameters say."""
    paths = dict.fromkeys(["images", "features", "checkpoints", "out", "metrics", "curve"], Path)
    arguments = parse(__doc__, **paths, seed=int)
    config = load(arguments.params, BaseShapeConfig, arguments.sections)
    machine = load_machine(arguments.params)
    processes = resolve_processes(scalar(arguments.params, "processes.learn_base_shape"), machine.device, config.seeds)
    with reserved(arguments.checkpoints):
        share_work(processes, machine.device, learn, config, arguments, machine)


def learn(config: BaseShapeConfig, arguments: Namespace, machine: Machine) -> None:
    """Learn every seed's shape, then write all of them with their generators."""
    (device, precision, memory), size = machine, config.renderer.size
    key = restart_key(config, [arguments.images, arguments.features], arguments.seed, device, precision)
    checkpoint = Checkpoint(arguments.checkpoints, key)
    images = place_images([load_images_to_reduce(arguments.images, size)], device, memory, size)
    extractor = load_feature_extractor(arguments.features, device, precision)
    shapes = learn_base_shape(
        config, Photographs(images, extractor, config.batch_size, memory), arguments.seed, checkpoint
    )
    if not is_first():
        return
    save(shapes, arguments.out)
    shapes.curve.write(arguments.curve)
    scores = shapes.scores.tolist()
    write_json(arguments.metrics, {"best_seed": shapes.best, "scores": scores, "seeds": len(scores)})
    checkpoint.clear()


def save(shapes: BaseShapes, path: Path) -> None:
    """Write all seeds' shapes, scores and generators."""
    tensors = {
        "faces": shapes.sphere.faces,
        "directions": shapes.sphere.directions,
        "seed_vertices": shapes.vertices,
        "seed_scores": shapes.scores,
        **scene_tensors(shapes.generators),
    }
    save_tensors(path, tensors, scene_metadata(shapes.generators[0]))


if __name__ == "__main__":
    run(main)
