"""Learn a category's base shape from its photographs (paper 3.1)."""

from pathlib import Path

from pipeline.config import load, scalar
from pipeline.datasets.images import load_images_of_size, place_images
from pipeline.device import resolve_device, resolve_memory
from pipeline.files import save_tensors, write_json
from pipeline.networks.feature_extractor import load_feature_extractor
from pipeline.networks.scene_generator import scene_texts
from pipeline.training.base_shape import BaseShapeConfig, BaseShapes, learn_base_shape
from pipeline.training.checkpoint import Checkpoint, restart_key
from stages.command_line import parse, run


def main() -> None:
    """Learn every seed's shape, then write all of them and the best one's generators."""
    arguments = parse(
        __doc__,
        images=Path,
        features=Path,
        seed=int,
        checkpoints=Path,
        out=Path,
        metrics=Path,
        curve=Path,
    )
    config = load(arguments.params, BaseShapeConfig, arguments.sections)
    device = resolve_device(scalar(arguments.params, "device"))
    memory = resolve_memory(scalar(arguments.params, "memory"))
    key = restart_key(config, [arguments.images, arguments.features], arguments.seed)
    shapes = learn_base_shape(
        config,
        place_images([load_images_of_size(arguments.images, config.renderer.size)], device, memory),
        memory,
        load_feature_extractor(arguments.features, device),
        arguments.seed,
        arguments.checkpoints,
        key,
    )
    save(shapes, arguments.out)
    shapes.curve.write(arguments.curve)
    scores = shapes.scores.tolist()
    write_json(arguments.metrics, {"best_seed": shapes.best, "scores": scores, "seeds": len(scores)})
    for index in range(config.seeds):
        Checkpoint(arguments.checkpoints / str(index), key).clear()


def save(shapes: BaseShapes, path: Path) -> None:
    """Write the chosen shape, all seeds' shapes and scores, and the chosen generators."""
    tensors = {
        "vertices": shapes.vertices[shapes.best],
        "faces": shapes.sphere.faces,
        "directions": shapes.sphere.directions,
        "seed_vertices": shapes.vertices,
        "seed_scores": shapes.scores,
        **shapes.generator.state_dict(),
    }
    save_tensors(path, tensors, scene_texts(shapes.generator))


if __name__ == "__main__":
    run(main)
