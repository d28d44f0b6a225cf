"""What the tests of shared trainings run in every process: a few steps of each training, on tiny models."""

import json
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import torch
from torch import Tensor, nn

from pipeline.distributed import average, is_first, share, world
from pipeline.files import write_json
from pipeline.geometry.sphere import build_sphere
from pipeline.networks.scene_generator import scene_tensors
from pipeline.tensor_files import save_tensors
from pipeline.training import ends
from pipeline.training.base_shape import SeedTrainer, learn_base_shape
from pipeline.training.checkpoint import Checkpoint
from pipeline.training.ends import consistent_axes
from pipeline.training.features import FeatureTrainer
from pipeline.training.first_poses import first_poses
from pipeline.training.full import train_full
from pipeline.training.full_trainer import FullTrainer
from pipeline.training.lessons import learn_poses
from pipeline.training.photographs import Photographs
from pipeline.training.warm_up import warm_up
from tests.learning import test_base_shape, test_train_features
from tests.tiny_full_model import ENDS, TRAINING, base_mesh, photographs, tiny_extractor, tiny_scenes

MEMORY = 2**30
SEEDS = replace(test_base_shape.CONFIG, seeds=3, iterations=2)


def take_steps(folder: Path) -> None:
    """Take steps of each training and write what every process holds then; learn seeds; train the full model."""
    with double_precision():
        trained = {**_features(), **_base_shape(), **_warm_up(), **_first_poses(), **_lessons(), **_ends(), **_full()}
        state = {**trained, **_derivatives()}
    save_tensors(folder / f"{world().rank}.safetensors", state, {})
    write_json(folder / f"{world().rank}.convolutions.json", torch.backends.cudnn.conv.fp32_precision)  # pyright: ignore[reportAttributeAccessIssue]
    learn_seeds(folder)
    train(folder, None)


@contextmanager
def double_precision() -> Iterator[None]:
    """Compute in float64 what is float32 otherwise, so that rounding is far below what a wrong share would change."""
    torch.set_default_dtype(torch.float64)
    try:
        with patch.object(Tensor, "float", Tensor.double):
            yield
    finally:
        torch.set_default_dtype(torch.float32)


def learn_seeds(folder: Path) -> None:
    """Learn base shapes from three seeds; the first process writes them, and each how many steps it took."""
    steps = 0
    step = SeedTrainer.step

    def counted(self: SeedTrainer, iteration: int) -> dict[str, Tensor]:
        nonlocal steps
        steps += 1
        return step(self, iteration)

    images, _ = photographs(8)
    with patch.object(SeedTrainer, "step", counted):
        pictures = Photographs(images[:, :, ::2, ::2], tiny_extractor(), SEEDS.batch_size, MEMORY)
        shapes = learn_base_shape(SEEDS, pictures, 0, Checkpoint(folder / "seeds", "key"))
    (folder / f"{world().rank}.steps.json").write_text(json.dumps(steps))
    if is_first():
        tensors = {"vertices": shapes.vertices, "scores": shapes.scores, **scene_tensors(shapes.generators)}
        save_tensors(folder / "seeds.safetensors", tensors, {"curve": str(shapes.curve.rows)})


def train(folder: Path, dying: int | None) -> None:
    """Train the full model in float64; the first process writes it. Process `dying` dies before the last step."""
    step = FullTrainer.step

    def deadly(self: FullTrainer, iteration: int) -> dict[str, Tensor]:
        if iteration == TRAINING.iterations - 1:
            os.kill(os.getpid(), signal.SIGKILL)
        return step(self, iteration)

    if world().rank == dying:
        FullTrainer.step = deadly
    with double_precision():
        (images, _), checkpoint = photographs(8), Checkpoint(folder / "full", "key")
        pictures = Photographs(images, tiny_extractor(), TRAINING.batch_size, MEMORY)
        trainer, curve = train_full(TRAINING, pictures, base_mesh(), tiny_scenes(), 0, checkpoint)
    if is_first():
        record = {
            "pose": trainer.records.best.pose,
            "shape": trainer.records.best.shape,
            "visits": trainer.records.visits,
        }
        save_tensors(folder / "full.safetensors", {**trainer.model.state_dict(), **record}, {})
        curve.write(folder / "full.csv")


def _derivatives() -> dict[str, Tensor]:
    """Differentiate a loss of a whole batch twice."""
    weight = torch.tensor(1.5, requires_grad=True)
    loss = average((weight * share(torch.arange(8.0))).mean()) ** 3
    (first,) = torch.autograd.grad(loss, weight, create_graph=True)
    (second,) = torch.autograd.grad(first, weight)
    return {"first derivative": average(first).detach(), "second derivative": average(second)}


def _features() -> dict[str, Tensor]:
    config = replace(test_train_features.CONFIG, batch_size=16)
    trainer = FeatureTrainer(config, test_train_features.bars(32, 0), test_train_features.NO_WEIGHTS, torch.float32, 0)
    losses = [trainer.step(iteration)["train_loss"] for iteration in range(2)]
    return {**_weights("features", trainer.network), "features.losses": torch.stack(losses)}


def _base_shape() -> dict[str, Tensor]:
    images, _ = photographs(8)
    config, extractor = test_base_shape.CONFIG, tiny_extractor()
    real = Photographs(images[:, :, ::2, ::2], extractor, 4, MEMORY)
    trainer = SeedTrainer(config, build_sphere(config.subdivisions, torch.device("cpu")), real, 0, 0)
    losses = [*trainer.step(0).values(), *trainer.step(1).values(), trainer.score()]
    return {**_weights("base", trainer.scene), "base.losses": torch.tensor(losses), "base.shape": trainer.shape()}


def _warm_up() -> dict[str, Tensor]:
    trainer = _full_trainer()
    warm_up(trainer.model, tiny_scenes().generators[0], replace(TRAINING.warm_up, iterations=1), trainer.rng)
    return _weights("warm-up", trainer.model)


def _first_poses() -> dict[str, Tensor]:
    trainer, (images, _) = _full_trainer(), photographs(8)
    config, light = TRAINING.first_poses, TRAINING.warm_up.light
    assert config is not None
    return {
        "first poses": first_poses(trainer.model, tiny_scenes(), tiny_extractor(), images, config, light, trainer.rng)
    }


def _lessons() -> dict[str, Tensor]:
    trainer, (images, poses) = _full_trainer(), photographs(8)
    index, config = torch.arange(len(poses)), replace(TRAINING.lessons, iterations=1)
    learn_poses(trainer.model, images, index, poses, config, trainer.rng)
    return _weights("lessons", trainer.model)


def _ends() -> dict[str, Tensor]:
    images, poses = photographs(80)
    config, extractor = replace(TRAINING, lessons=replace(TRAINING.lessons, iterations=1)), tiny_extractor()
    trainer = FullTrainer(config, Photographs(images, extractor, 8, MEMORY), base_mesh(), 0)
    trainer.records.best.pose.copy_(poses)
    trainer.records.visits += 1
    with patch.object(ends, "consistent_axes", _axes_of_a_device_that_rounds_differently):
        trainer.records.turn_round(replace(ENDS, side_reach=75.0, photographs=60))
    drawn = {"ends rng": trainer.rng.get_state()}
    return {**_weights("ends", trainer.model), **drawn, "ends record": trainer.records.best.pose}


def _axes_of_a_device_that_rounds_differently(*arguments: Any) -> Tensor:
    """Return axes whose sides are too few to tell ends by, in all processes but the first."""
    turn = consistent_axes(*arguments)
    return turn if is_first() else torch.tensor([1, 0]).to(turn).expand_as(turn).clone()


def _full() -> dict[str, Tensor]:
    """Take one step near the record and, from the same start, one that tries everything."""
    return {**_full_step("near", 0), **_full_step("everything", TRAINING.iterations // 2)}


def _full_step(name: str, iteration: int) -> dict[str, Tensor]:
    trainer = _full_trainer()
    losses = list(trainer.step(iteration).values())
    return {
        **_weights(f"{name} full", trainer.model),
        **_weights(f"{name} discriminator", trainer.discriminator),
        f"{name} full.losses": torch.stack(losses),
        f"{name} record.pose": trainer.records.best.pose,
        f"{name} record.shape": trainer.records.best.shape,
        f"{name} record.visits": trainer.records.visits,
    }


def _full_trainer() -> FullTrainer:
    images, _ = photographs(8)
    extractor = tiny_extractor()
    return FullTrainer(TRAINING, Photographs(images, extractor, 8, MEMORY), base_mesh(), 0)


def _weights(name: str, module: nn.Module) -> dict[str, Tensor]:
    """Return parameters, buffers and the gradients of the last step."""
    state = {f"{name} {entry}": value for entry, value in module.state_dict().items()}
    gradients = {f"gradient of {name} {entry}": value.grad for entry, value in module.named_parameters()}
    state |= {entry: value for entry, value in gradients.items() if value is not None}
    return {entry: value.clone() for entry, value in state.items()}
