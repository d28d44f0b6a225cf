"""Full training: encoders and decoders around a base shape (paper section 3.2)."""

from pathlib import Path

import torch

from pipeline.errors import DataError
from pipeline.geometry.icosphere import icosphere
from pipeline.geometry.normalize import fit_unit_cube
from pipeline.networks.scene_generator import LearnedScenes
from pipeline.rendering.renderer import Mesh
from pipeline.tensor_files import load_tensors
from pipeline.training.checkpoint import Checkpoint
from pipeline.training.curves import Curve
from pipeline.training.exploration import require_maps
from pipeline.training.full_trainer import FullTrainer, FullTrainingConfig
from pipeline.training.loop import Schedule, run_training
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
    photographs: Photographs,
    base: Mesh,
    scenes: LearnedScenes,
    seed: int,
    checkpoint: Checkpoint,
) -> tuple[FullTrainer, Curve]:
    """Train the full model, going on from the checkpoint where there is one.

    `scenes` are base-shape learning's generators, for the warm-up and first poses. Raises DataError for a single
    photograph, and TrainingDiverged when the loss is not finite.
    """
    if len(photographs.images) < 2:
        raise DataError("full training compares photographs with each other, but there is only one; add more")
    require_maps(config.exploration.map_weights, photographs.extractor, "train_full.exploration.map_weights")
    trainer = FullTrainer(config, photographs, base, seed)
    schedule = Schedule(config.iterations, config.curve_every, config.checkpoint_every)
    prepare = trainer.starting_from(scenes) if config.model.two_stage else ()
    curve = run_training(trainer, schedule, "full training", checkpoint, prepare)
    trainer.finish()
    return trainer, curve
