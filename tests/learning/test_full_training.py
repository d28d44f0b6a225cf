"""Full training and fine-tuning on photographs of one body: they learn, and they resume to the same bytes."""

from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock, patch

import numpy as np
import pytest
import torch
from torch import Tensor

from pipeline import distributed
from pipeline.datasets.images import load_images, place_images
from pipeline.errors import ConfigError, TrainingDiverged
from pipeline.evaluation.shape import proportions
from pipeline.geometry.camera import pose_to_tensor
from pipeline.networks.feature_extractor import extract
from pipeline.networks.full_model import Reconstruction
from pipeline.networks.pose_coordinates import PoseRange
from pipeline.seeding import generator
from pipeline.tensor_files import load_tensors
from pipeline.training import full_trainer, records
from pipeline.training.candidates import flipped
from pipeline.training.checkpoint import Checkpoint
from pipeline.training.curves import Curve
from pipeline.training.exploration import Best, explore, score
from pipeline.training.fine_tune import FineTuneConfig, Outputs, PhaseConfig, fine_tune, tune
from pipeline.training.full import train_full
from pipeline.training.full_trainer import FullTrainer, FullTrainingConfig
from pipeline.training.photographs import Photographs
from pipeline.training.reading import read_all_poses
from pipeline.training.records import Records
from stages.train_full import save
from tests.tiny_full_model import (
    ENDS,
    MODEL,
    TRAINING,
    base_mesh,
    inferred,
    photographs,
    photographs_of,
    tiny_extractor,
    tiny_model,
    tiny_scenes,
)

MEMORY = 2**30
SINGLE_STAGE = replace(TRAINING, model=replace(MODEL, two_stage=False))
FINE_TUNING = FineTuneConfig(
    None, 3, (0.5, 0.99), (0.1, 1.0, 2.0), 3, PhaseConfig(4, 0.05), PhaseConfig(6, 0.02), PhaseConfig(6, 0.02)
)


def train(
    config: FullTrainingConfig, folder: Path, count: int = 8, precision: torch.dtype = torch.float32
) -> FullTrainer:
    trainer, curve = train_with_curve(config, folder, count, precision)
    assert [row["iteration"] for row in curve.rows] == list(range(2, config.iterations + 1, 2))
    return trainer


def train_with_curve(
    config: FullTrainingConfig, folder: Path, count: int = 8, precision: torch.dtype = torch.float32
) -> tuple[FullTrainer, Curve]:
    (images, _), extractor = photographs(count), tiny_extractor().to(precision)
    pictures = Photographs(images, extractor, config.batch_size, MEMORY)
    return train_full(config, pictures, base_mesh(), tiny_scenes(), 0, Checkpoint(folder, "key"))


def state(trainer: FullTrainer) -> dict[str, Tensor]:
    return {
        **trainer.model.state_dict(),
        **{f"discriminator.{name}": value for name, value in trainer.discriminator.state_dict().items()},
        "pose": trainer.records.best.pose,
        "shape": trainer.records.best.shape,
        "rng": trainer.rng.get_state(),
    }


@pytest.mark.parametrize(
    ("config", "precision"),
    [
        (TRAINING, torch.float32),
        (TRAINING, torch.bfloat16),
        (SINGLE_STAGE, torch.float32),
        (replace(TRAINING, first_poses=None), torch.float32),
    ],
)
def test_interrupted_training_ends_with_the_same_bytes(
    config: FullTrainingConfig, precision: torch.dtype, tmp_path: Path
) -> None:
    whole = state(train(config, tmp_path / "whole", precision=precision))
    settled = 0.99 * 2 * config.settle  # as many iterations of half the training
    train(replace(config, iterations=2, settle=settled), tmp_path / "halves", precision=precision)
    halves = state(train(config, tmp_path / "halves", precision=precision))
    assert whole.keys() == halves.keys()
    assert [name for name in whole if not torch.equal(whole[name], halves[name])] == []


@pytest.mark.parametrize("deadly", ["first_poses", "learn_poses"])
def test_a_start_that_dies_goes_on_after_what_is_done(
    deadly: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert TRAINING.first_poses is not None
    config = replace(TRAINING, iterations=2, first_poses=replace(TRAINING.first_poses, photographs=6))
    whole = state(train(config, tmp_path / "whole"))
    with patch.object(records, deadly, side_effect=KeyboardInterrupt), pytest.raises(KeyboardInterrupt):
        train(config, tmp_path / "dead")
    monkeypatch.setattr(full_trainer, "warm_up", Mock(side_effect=AssertionError("the warm-up is done")))
    resumed = state(train(config, tmp_path / "dead"))
    assert [name for name in whole if not torch.equal(whole[name], resumed[name])] == []


@pytest.mark.parametrize(("two_stage", "first_poses"), [(True, True), (True, False), (False, True)])
def test_poses_are_free_from_the_start_where_there_are_no_first_ones(
    two_stage: bool, first_poses: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    far = []

    def noticing(*arguments: Any) -> Best:
        far.append(arguments[5].random_poses > 0)
        return explore(*arguments)

    monkeypatch.setattr(full_trainer, "explore", noticing)
    config = replace(TRAINING, model=replace(MODEL, two_stage=two_stage), settle=0.5)
    train(config if first_poses else replace(config, first_poses=None), tmp_path)
    assert far == ([False, False, True, True] if two_stage and first_poses else [True] * 4)


def test_training_that_dies_after_telling_ends_resumes_to_the_same_bytes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = replace(TRAINING, first_poses=None, ends=replace(ENDS, after=(0.5,)), photographs_per_iteration=40.0)
    count, step = 80, FullTrainer.step
    whole = state(train(config, tmp_path / "whole", count))
    untold = state(train(replace(config, ends=ENDS), tmp_path / "untold", count))
    turned = (whole["pose"][:, :2] * untold["pose"][:, :2]).sum(dim=1) < -0.9
    assert 0.1 < turned.float().mean() < 0.9

    def deadly(self: FullTrainer, iteration: int) -> dict[str, Tensor]:
        if iteration == 2:
            raise KeyboardInterrupt
        return step(self, iteration)

    with monkeypatch.context() as patch:
        patch.setattr(FullTrainer, "step", deadly)
        with pytest.raises(KeyboardInterrupt):
            train(config, tmp_path / "halves", count)
    halves = state(train(config, tmp_path / "halves", count))
    assert [name for name in whole if not torch.equal(whole[name], halves[name])] == []


@pytest.mark.parametrize("part", ["batch_size", "warm_up", "lessons"])
def test_batches_that_processes_cannot_share_are_refused_before_the_first_step(
    part: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = replace(TRAINING, batch_size=6)
    whole = replace(whole, **{name: replace(getattr(whole, name), batch_size=6) for name in ("warm_up", "lessons")})
    odd = 7 if part == "batch_size" else replace(getattr(whole, part), batch_size=7, iterations=1)
    given = Photographs(photographs(8)[0], tiny_extractor(), 8, MEMORY)
    monkeypatch.setattr(distributed, "world", lambda: distributed.World(0, 3))
    with pytest.raises(ConfigError, match="a batch of 7 cannot be shared by 3 processes"):
        FullTrainer(replace(whole, **{part: odd}), given, base_mesh(), 0)


def test_ends_are_turned_as_told_and_elsewhere_as_read(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (images, _), extractor = photographs(12), tiny_extractor()
    trainer = FullTrainer(TRAINING, Photographs(images, extractor, 8, MEMORY), base_mesh(), 0)
    before, told = trainer.records.best.pose.clone(), torch.tensor([1.0, -1, 1, -1, 1, 1, -0.1, 1])
    trainer.records.visits += 1
    trainer.records.visits[7] = 0
    read_as_recorded = torch.tensor([True] * 7 + [False, True, False, True, False])
    read = torch.where(read_as_recorded[:, None], before, flipped(before, 1)[0])
    monkeypatch.setattr("pipeline.training.records.tell_ends", lambda images, *_: told[: len(images)])
    monkeypatch.setattr("pipeline.training.records.read_all_poses", lambda *_: read)
    trainer.records.turn_round(replace(ENDS, photographs=8))
    assert "ends told: 3 of 7 photographs turned round" in capsys.readouterr().out
    turned = (trainer.records.best.pose[:, :2] * before[:, :2]).sum(dim=1) < 0
    assert turned.nonzero().flatten().tolist() == [1, 3, 6, 7, 9, 11]
    torch.testing.assert_close(trainer.records.best.pose[:, 2:], before[:, 2:])


def test_ends_of_photographs_without_a_visit_are_not_turned(monkeypatch: pytest.MonkeyPatch) -> None:
    (images, _), extractor = photographs(12), tiny_extractor()
    trainer = FullTrainer(TRAINING, Photographs(images, extractor, 8, MEMORY), base_mesh(), 0)
    before = trainer.records.best.pose.clone()
    monkeypatch.setattr("pipeline.training.records.tell_ends", lambda images, *_: -torch.ones(len(images)))
    trainer.records.turn_round(replace(ENDS, photographs=8))
    assert torch.equal(trainer.records.best.pose, before)


def test_ends_told_after_training_are_learned_in_the_last_lessons(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ends = replace(ENDS, after=(1.0,))
    lessons: list[Tensor] = []
    monkeypatch.setattr("pipeline.training.records.learn_poses", lambda *given: lessons.append(given[3]))
    untold = train(TRAINING, tmp_path / "untold")
    monkeypatch.setattr("pipeline.training.records.tell_ends", lambda images, *_: -torch.ones(len(images)))
    told = train(replace(TRAINING, ends=ends), tmp_path / "told")
    visited = told.records.visits > 0
    assert torch.equal(told.records.best.pose[visited], flipped(untold.records.best.pose, 1)[0][visited])
    assert torch.equal(lessons[-1], told.records.best.pose[visited])


@pytest.mark.parametrize(
    ("after", "steps"), [((), []), ((0.5,), [2]), ((0.5, 1.0), [2, 4]), ((0.25, 0.75), [1, 3]), ((1.0,), [4])]
)
def test_ends_are_told_when_the_config_says(
    after: tuple[float, ...], steps: list[int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    step, done, told = FullTrainer.step, [], []
    monkeypatch.setattr(FullTrainer, "step", lambda self, i: (step(self, i), done.append(i))[0])
    monkeypatch.setattr(Records, "turn_round", lambda *_: told.append(len(done)))
    train(replace(SINGLE_STAGE, iterations=4, ends=replace(ENDS, after=after)), tmp_path)
    assert told == steps


@pytest.mark.parametrize(("iterations", "rows"), [(1, [1]), (3, [2, 3])])
def test_the_curve_ends_where_training_ends(iterations: int, rows: list[int], tmp_path: Path) -> None:
    _, curve = train_with_curve(replace(SINGLE_STAGE, iterations=iterations), tmp_path)
    assert [row["iteration"] for row in curve.rows] == rows


def test_diverged_training_keeps_the_last_checkpoint(tmp_path: Path) -> None:
    wild = replace(TRAINING, loss=replace(TRAINING.loss, total_variation=float("inf")))
    train(replace(TRAINING, iterations=2), tmp_path)
    before = (tmp_path / "state.safetensors").read_bytes()
    with pytest.raises(TrainingDiverged, match="iteration 3;"):
        train(wild, tmp_path)
    assert (tmp_path / "state.safetensors").read_bytes() == before


def test_curriculum_draws_different_photographs_from_the_first_ones() -> None:
    images, _ = photographs(16)
    extractor = tiny_extractor()
    trainer = FullTrainer(TRAINING, Photographs(images, extractor, 8, MEMORY), base_mesh(), 0)
    draws = torch.stack([trainer.draw(iteration) for iteration in (0, 0, 0, 3, 3, 3, 99, 99, 99)])
    assert all(len(draw.unique()) == 4 for draw in draws)
    assert draws[:3].max() < 4
    assert 4 <= draws[3:6].max() < 8
    assert draws[6:].max() >= 8


@pytest.mark.parametrize("iteration", [3, 5])
def test_an_iteration_draws_from_as_many_photographs_as_the_curriculum_has_reached(iteration: int) -> None:
    (images, _), extractor = photographs(16), tiny_extractor()
    trainer = FullTrainer(TRAINING, Photographs(images, extractor, 8, MEMORY), base_mesh(), 0)
    drawn = torch.cat([trainer.draw(iteration) for _ in range(40)]).unique()
    assert drawn.tolist() == list(range(int(TRAINING.photographs_per_iteration * (iteration + 1))))


def test_every_visit_of_a_photograph_counts() -> None:
    (images, _), extractor = photographs(TRAINING.batch_size), tiny_extractor()
    trainer = FullTrainer(TRAINING, Photographs(images, extractor, 8, MEMORY), base_mesh(), 0)
    for iteration in range(2):
        trainer.step(iteration)
    assert trainer.records.visits.tolist() == [2] * TRAINING.batch_size


def test_photographs_on_disk_give_the_same_training(tmp_path: Path) -> None:
    """Neither the pictures nor their features fit into one byte."""
    images, _ = photographs(8)
    np.save(tmp_path / "car.npy", images.permute(0, 2, 3, 1).numpy())
    mapped = place_images([load_images(tmp_path / "car.npy")], images.device, 1)
    results = [
        train_full(
            TRAINING,
            Photographs(pictures, tiny_extractor(), TRAINING.batch_size, memory),
            base_mesh(),
            tiny_scenes(),
            0,
            Checkpoint(tmp_path, str(memory)),
        )
        for pictures, memory in ((images, MEMORY), (mapped, 1))
    ]
    (resident, curve), (streamed, same_curve) = results
    torch.testing.assert_close(state(streamed), state(resident), atol=1e-6, rtol=1e-6)
    for row, same_row in zip(curve.rows, same_curve.rows, strict=True):
        assert same_row == pytest.approx(row, rel=1e-5)


def test_photographs_beyond_the_first_start_from_poses_that_the_networks_read(tmp_path: Path) -> None:
    images, _ = photographs(8)
    assert TRAINING.first_poses is not None
    few = replace(TRAINING, iterations=0, first_poses=replace(TRAINING.first_poses, photographs=6))
    pictures = Photographs(images, tiny_extractor(), few.batch_size, MEMORY)
    trainer, _ = train_full(few, pictures, base_mesh(), tiny_scenes(), 0, Checkpoint(tmp_path, "key"))
    read = read_all_poses(trainer.model, images)
    torch.testing.assert_close(trainer.records.best.pose[6:], read[6:])
    assert not torch.isclose(trainer.records.best.pose[:6], read[:6]).all(dim=1).any()


@pytest.mark.slow
def test_training_finds_poses_and_reconstructs(tmp_path: Path) -> None:
    upright = replace(MODEL, pose_range=PoseRange((5.0, 25.0), (-2.0, 2.0), (-0.1, 0.1), (0.8, 1.0)))
    config = replace(
        TRAINING,
        iterations=20,
        batch_size=8,
        learning_rate=3e-3,
        model=upright,
        exploration=replace(TRAINING.exploration, turned_poses=6),
        curve_every=2,
    )
    images, _ = photographs(8)
    extractor = tiny_extractor()
    pictures = Photographs(images, extractor, config.batch_size, MEMORY)
    trainer, curve = train_full(config, pictures, base_mesh(), tiny_scenes(), 0, Checkpoint(tmp_path, "key"))
    first, last = curve.rows[0], curve.rows[-1]
    assert last["reconstruction"] < 0.85 * first["reconstruction"]
    features = [layer.float() for layer in extract(extractor, images, 8)]
    with torch.no_grad():
        estimate = trainer.estimate(images.float() / 255, features)
    poses = torch.cat([trainer.records.best.pose, trainer.model.poses.draw(8 * 10, generator(9))]).unflatten(0, (11, 8))
    shapes = trainer.records.best.shape.expand(11, -1, -1)
    distances = score(trainer.model, extractor, features, estimate, poses, shapes, config.exploration.map_weights)
    assert (distances[0] < distances[1:]).float().mean() > 0.9


def test_fine_tuning_lowers_every_distance_and_resumes_to_the_same_bytes(tmp_path: Path) -> None:
    images, _ = photographs(6)
    model, extractor = tiny_model().eval(), tiny_extractor()
    whole = fine_tune(FINE_TUNING, images, model, extractor, Checkpoint(tmp_path / "whole", "key"))
    fine_tune(replace(FINE_TUNING, photographs=3), images, model, extractor, Checkpoint(tmp_path / "halves", "key"))
    halves = fine_tune(FINE_TUNING, images, model, extractor, Checkpoint(tmp_path / "halves", "key"))
    assert all(torch.equal(whole[name], halves[name]) for name in whole)
    assert whole["test_index"].tolist() == [0, 1, 2, 3, 4, 5]
    before, after = whole["feature_distance_predicted"], whole["feature_distance_tuned"]
    assert (after < before).all()
    assert after.mean() < 0.97 * before.mean()


def test_photographs_that_are_tuned_are_not_tuned_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    images, _ = photographs(6)
    model, extractor = tiny_model().eval(), tiny_extractor()
    first = fine_tune(FINE_TUNING, images, model, extractor, Checkpoint(tmp_path, "key"))
    monkeypatch.delattr("pipeline.training.fine_tune.tune")
    again = fine_tune(FINE_TUNING, images, model, extractor, Checkpoint(tmp_path, "key"))
    assert all(torch.equal(first[name], again[name]) for name in first)
    with pytest.raises(NameError):
        fine_tune(FINE_TUNING, images, model, extractor, Checkpoint(tmp_path, "another"))


def test_fine_tuning_moves_only_background_pose_and_shape(tmp_path: Path) -> None:
    images, _ = photographs(3)
    only_pose = replace(FINE_TUNING, background=PhaseConfig(0, 0.05), shape=PhaseConfig(0, 0.02))
    model = tiny_model().eval()
    results = fine_tune(only_pose, images, model, tiny_extractor(), Checkpoint(tmp_path, "key"))
    assert torch.equal(results["vertices_predicted"], results["vertices_tuned"])
    assert torch.equal(results["backgrounds_predicted"], results["backgrounds_tuned"])
    assert not torch.equal(results["pose_predicted"], results["pose_tuned"])
    torch.testing.assert_close(results["textures"], inferred(model, images.float() / 255).texture_maps)


def test_poses_that_leave_their_ranges_are_led_back() -> None:
    images, _ = photographs(2)
    model, extractor = tiny_model().eval(), tiny_extractor()
    outputs = Outputs(model, images.float() / 255, [layer.float() for layer in extract(extractor, images, 2)])
    outputs.values["pose"][:, 2] = 1.5

    def elevation(reconstruction: Reconstruction) -> Tensor:
        return reconstruction.pose.elevation

    tune(outputs, "pose", elevation, PhaseConfig(5, 0.1), (0.5, 0.99))
    assert (outputs.values["pose"][:, 2] < 0.8).all()


def train_with_known_poses(images: Tensor, poses: Tensor, iterations: int) -> FullTrainer:
    """Train on photographs whose poses are recorded, without a search."""
    extractor = tiny_extractor()
    searched = ("random_poses", "turned_poses", "raised_poses", "flipped_poses", "perturbed_poses")
    config = replace(
        TRAINING,
        iterations=iterations,
        learning_rate=3e-3,
        exploration=replace(TRAINING.exploration, shapes=None, **dict.fromkeys(searched, 0)),
        photographs_per_iteration=float(len(images)),
    )
    trainer = FullTrainer(config, Photographs(images, extractor, 4, MEMORY), base_mesh(), 0)
    trainer.records.best.pose.copy_(poses)
    for iteration in range(iterations):
        trainer.step(iteration)
    return trainer


@pytest.mark.slow
def test_predicted_shapes_differ_as_the_photographed_ones_do() -> None:
    poses = tiny_model().poses.draw(48, generator(2))
    shape = torch.zeros(48, tiny_model().shapes.parameter_count)
    shape[::2, -2], shape[1::2, -2] = 2.0, -2.0  # high and low bodies by turns: logarithms .8 apart
    images = photographs_of(poses, shape=shape)
    trainer = train_with_known_poses(images, poses, 120)
    with torch.no_grad():
        vertices = trainer.model.shapes(trainer.estimate(*trainer.photographs.batch(torch.arange(len(images)))).shape)
    extent = vertices.amax(dim=1) - vertices.amin(dim=1)
    height = (extent[:, 1] / extent[:, 2]).log()
    assert height[::2].mean() > height[1::2].mean() + 0.15
    assert torch.corrcoef(torch.stack([height, shape[:, -2]]))[0, 1] > 0.5


def learned_width(photographed: float) -> Tensor:
    """Train on bodies of one width, and read the base shape's: a logarithm, as a fifth of the parameter is."""
    poses = tiny_model().poses.draw(24, generator(2))
    shape = torch.zeros(24, tiny_model().shapes.parameter_count)
    shape[:, -3] = photographed
    trainer = train_with_known_poses(photographs_of(poses, shape=shape), poses, 60)
    return proportions(trainer.model.shapes.base().detach()[None])[0, 0]


@pytest.mark.slow
def test_the_base_shape_learns_what_all_photographs_share() -> None:
    wide, narrow = learned_width(2.0), learned_width(-2.0)
    given = proportions(base_mesh().vertices[:1])[0, 0]
    assert narrow < given < wide
    assert 0.1 < wide - narrow < 0.8  # .8 is the whole difference between the photographs


def test_pose_networks_learn_the_ends_that_are_surely_told(monkeypatch: pytest.MonkeyPatch) -> None:
    (images, _), extractor = photographs(12), tiny_extractor()
    trainer = FullTrainer(TRAINING, Photographs(images, extractor, 8, MEMORY), base_mesh(), 0)
    told, lessons = torch.tensor([1.0, -1, 0, -1, 1, 1, -0.1, 1]), list[tuple[Tensor, Tensor]]()
    trainer.records.visits += 1
    trainer.records.visits[7] = 0
    monkeypatch.setattr(records, "tell_ends", lambda *_: told)
    monkeypatch.setattr(records, "learn_poses", lambda *given: lessons.append(given[2:4]))
    trainer.records.turn_round(replace(ENDS, photographs=8))
    [(index, poses)] = lessons
    assert index.tolist() == [0, 1, 3, 4, 5, 6]
    assert torch.equal(poses, trainer.records.best.pose[index])


def test_first_lessons_are_of_photographs_that_have_first_poses(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert TRAINING.first_poses is not None
    few, taught = replace(TRAINING, iterations=0, first_poses=replace(TRAINING.first_poses, photographs=6)), []
    monkeypatch.setattr(records, "learn_poses", lambda *given: taught.append(given[2].tolist()))
    pictures = Photographs(photographs(8)[0], tiny_extractor(), few.batch_size, MEMORY)
    train_full(few, pictures, base_mesh(), tiny_scenes(), 0, Checkpoint(tmp_path, "key"))
    assert taught == [list(range(6))]


def test_the_chosen_base_shapes_generator_warms_up() -> None:
    (images, _), extractor, scenes = photographs(8), tiny_extractor(), tiny_scenes()
    trainer = FullTrainer(TRAINING, Photographs(images, extractor, 8, MEMORY), base_mesh(), 0)
    first, *_ = trainer.starting_from(scenes)
    assert first.args[1] is scenes.generators[0]  # pyright: ignore[reportFunctionMemberAccess]


def test_seeds_of_full_training_differ() -> None:
    (images, _), extractor = photographs(8), tiny_extractor()
    kept = Photographs(images, extractor, 8, MEMORY)
    first, second = (FullTrainer(TRAINING, kept, base_mesh(), seed) for seed in (0, 1))
    assert not torch.equal(first.records.best.pose, second.records.best.pose)
    for one, other in ((first.model, second.model), (first.discriminator, second.discriminator)):
        weights = zip(one.parameters(), other.parameters(), strict=True)
        assert any(not torch.equal(ours, theirs) for ours, theirs in weights)


def test_the_stage_writes_how_often_photographs_were_visited(tmp_path: Path) -> None:
    (images, _), extractor = photographs(8), tiny_extractor()
    trainer = FullTrainer(TRAINING, Photographs(images, extractor, 8, MEMORY), base_mesh(), 0)
    trainer.records.visits[[1, 5]] = torch.tensor([3, 1])
    save(trainer, tmp_path / "model.safetensors")
    tensors, _ = load_tensors(tmp_path / "model.safetensors")
    assert tensors["train_visits"].tolist() == [0, 3, 0, 0, 0, 1, 0, 0]
    torch.testing.assert_close(tensors["train_pose"], pose_to_tensor(trainer.records.poses()))
