"""Full training: encoders and decoders around a base shape (paper section 3.2)."""

from pathlib import Path

import torch
from tqdm import tqdm

from pipeline.datasets.images import Images
from pipeline.distributed import silent
from pipeline.files import load_tensors
from pipeline.geometry.icosphere import icosphere
from pipeline.geometry.normalize import fit_unit_cube
from pipeline.networks.feature_extractor import FeatureExtractor
from pipeline.networks.scene_generator import LearnedScenes
from pipeline.rendering.renderer import Mesh
from pipeline.training.checkpoint import Checkpoint, pack, read_losses, unpack
from pipeline.training.curves import Curve
from pipeline.training.exploration import require_maps
from pipeline.training.full_trainer import FullTrainer, FullTrainingConfig
from pipeline.training.photographs import Photographs


def load_base(config: FullTrainingConfig, path: Path, device: torch.device) -> Mesh:
    """Load the base mesh that `remesh` wrote; in single-stage training build the ellipsoid instead."""
    if config.model.two_stage:
        tensors, _ = load_tensors(path)
        vertices, faces, directions = tensors["vertices"], tensors["faces"], tensors["directions"]
    else:
        directions, faces = icosphere(config.ellipsoid.subdivisions)
        vertices = directions * torch.tensor(config.ellipsoid.dimensions)
    return Mesh(fit_unit_cube(vertices[None]).to(device), faces.to(device), directions.to(device))


def train_full(
    config: FullTrainingConfig,
    images: Images,
    memory: int,
    extractor: FeatureExtractor,
    base: Mesh,
    scenes: LearnedScenes,
    seed: int,
    checkpoint: Checkpoint,
) -> tuple[FullTrainer, Curve]:
    """Train the full model, going on from the checkpoint where there is one.

    `scenes` are base-shape learning's generators, for the warm-up and first poses; `memory` is what photographs and
    their kept features may take, in bytes. Raises TrainingDiverged when the loss is not finite.
    """
    require_maps(config.exploration.map_weights, extractor, "train_full.exploration.map_weights")
    photographs = Photographs(images, extractor, config.batch_size, memory)
    trainer = FullTrainer(config, photographs, extractor, base, seed)
    curve, recent, unread, first = Curve(), [], [], 0
    if (restored := checkpoint.load()) is not None:
        tensors, values = restored
        unpack(tensors, **trainer.parts())
        curve, recent, first = Curve(values["rows"]), values["recent"], values["iteration"]
    elif config.model.two_stage:
        trainer.start_from(scenes)
        checkpoint.save(pack(**trainer.parts()), {"iteration": 0, "rows": [], "recent": []})
    steps = range(first, config.iterations)
    for iteration in tqdm(steps, "full training", initial=first, total=config.iterations, disable=silent()):
        if config.ends is not None and iteration in (int(part * config.iterations) for part in config.ends.after):
            trainer.turn_round(config.ends)
        unread.append(trainer.step(iteration))
        last = iteration + 1 == config.iterations
        if last or any((iteration + 1) % every == 0 for every in (config.curve_every, config.checkpoint_every)):
            recent, unread = recent + read_losses(unread, iteration, "full training"), []
        if last or (iteration + 1) % config.curve_every == 0:
            curve.append(iteration + 1, **_means(recent))
            recent = []
        if (iteration + 1) % config.checkpoint_every == 0:
            values = {"iteration": iteration + 1, "rows": curve.rows, "recent": recent}
            checkpoint.save(pack(**trainer.parts()), values)
    if config.ends is not None and 1 in config.ends.after:
        trainer.turn_round(config.ends)
    trainer.review()
    return trainer, curve


def _means(rows: list[dict[str, float]]) -> dict[str, float]:
    return {name: sum(row[name] for row in rows) / len(rows) for name in rows[0]}
