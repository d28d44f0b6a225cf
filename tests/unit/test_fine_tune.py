"""What fine-tuning keeps, and in which order it goes on (paper section 3.2.4)."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor
from tqdm import tqdm

from pipeline.networks.feature_extractor import extract
from pipeline.networks.full_model import Reconstruction
from pipeline.seeding import generator
from pipeline.training import fine_tune as fine_tuning
from pipeline.training.checkpoint import Checkpoint
from pipeline.training.fine_tune import Outputs, PhaseConfig, choose_start, fine_tune, keep_better, tune
from stages.fine_tune import summary
from tests.learning.test_full_training import FINE_TUNING
from tests.tiny_full_model import photographs, tiny_extractor, tiny_model


def outputs_of(count: int) -> Outputs:
    images, _ = photographs(count)
    features = [layer.float() for layer in extract(tiny_extractor(), images, count)]
    return Outputs(tiny_model().eval(), images.float() / 255, features)


def test_a_step_too_far_is_taken_back() -> None:
    outputs = outputs_of(3)
    outputs.values["pose"][:, 2] = 0.0
    start = outputs.values["pose"].clone()
    least = outputs.reconstruct().pose.elevation.detach()
    tune(outputs, "pose", lambda found: (found.pose.elevation - least).square(), PhaseConfig(1, 2.0), (0.5, 0.99))
    assert torch.equal(outputs.values["pose"], start)


def test_without_momenta_every_step_is_as_long_as_the_rate() -> None:
    outputs, met, slopes = outputs_of(2), list[Tensor](), iter([1.0, 100.0, -0.1, 1.0])
    outputs.values["pose"][:, 2] = 0.0

    def loss(found: Reconstruction) -> Tensor:
        met.append(found.pose.elevation.detach() / outputs.model.poses.reach[0])
        return next(slopes) * found.pose.elevation

    tune(outputs, "pose", loss, PhaseConfig(3, 0.1), (0.0, 0.0))
    torch.testing.assert_close(torch.stack(met).diff(dim=0), torch.tensor([[-0.1], [-0.1], [0.1]]).expand(3, 2))


def test_each_picture_keeps_what_is_better() -> None:
    outputs = outputs_of(2)
    outputs.values["pose"][:, 2] = 0.0
    first = {name: value.clone() for name, value in outputs.values.items()}
    outputs.values["pose"][:, 2] = torch.tensor([0.5, -0.5])
    keep_better(outputs, first, lambda found: found.pose.elevation)
    assert outputs.values["pose"][:, 2].tolist() == [0.0, -0.5]


def test_it_starts_from_the_head_that_fits_best() -> None:
    outputs = outputs_of(2)
    target = outputs.model.poses.draw(2, generator(3))
    azimuth = torch.atan2(target[:, 1], target[:, 0])
    outputs.heads[:, 1] = target
    choose_start(outputs, lambda found: 1 - (found.pose.azimuth - azimuth).cos(), 0)
    torch.testing.assert_close(outputs.values["pose"], target)


def test_backgrounds_come_first_then_poses_then_shapes_and_the_better_is_kept(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    taken: list[object] = []
    monkeypatch.setattr(fine_tuning, "tune", lambda _, name, __, phase, ___: taken.append((name, phase)))
    monkeypatch.setattr(fine_tuning, "choose_start", lambda *_: taken.append("start"))
    monkeypatch.setattr(fine_tuning, "keep_better", lambda *_: taken.append("kept"))
    checkpoint = Checkpoint(tmp_path, "key")
    fine_tune(FINE_TUNING, photographs(2)[0], tiny_model().eval(), tiny_extractor(), checkpoint)
    phases = [(name, getattr(FINE_TUNING, name)) for name in ("background", "pose", "shape")]
    assert taken == ["start", *phases, "kept"]


def test_the_summary_counts_photographs_whose_distance_fell() -> None:
    before, after = torch.tensor([4.0, 4.0, 4.0, 4.0]), torch.tensor([1.0, 1.0, 1.0, 4.0])
    figures = summary({"feature_distance_predicted": before, "feature_distance_tuned": after})
    assert figures == {
        "feature_distance_predicted": 4.0,
        "feature_distance_tuned": 1.75,
        "lowered": 0.75,
        "photographs": 4,
    }


def test_starts_are_compared_by_the_weighted_maps(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    met: list[Tensor] = []

    def met_distance(outputs: Outputs, distance: fine_tuning.Loss, flips: int) -> None:
        met.append(distance(outputs.reconstruct()))
        assert flips == FINE_TUNING.flipped_poses

    monkeypatch.setattr(fine_tuning, "choose_start", met_distance)
    monkeypatch.setattr(fine_tuning, "tune", lambda *_: None)
    for factor in (1.0, 2.0):
        config = replace(FINE_TUNING, map_weights=tuple(factor * weight for weight in FINE_TUNING.map_weights))
        checkpoint = Checkpoint(tmp_path / str(factor), "key")
        fine_tune(config, photographs(2)[0], tiny_model().eval(), tiny_extractor(), checkpoint)
    torch.testing.assert_close(met[1], 2 * met[0])


def test_progress_counts_steps_also_those_that_were_done_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bars: list[tqdm] = []

    def bar(total: int, **_: Any) -> tqdm:
        bars.append(tqdm(total=total))
        return bars[-1]

    monkeypatch.setattr(fine_tuning, "tqdm", bar)
    config = replace(FINE_TUNING, batch_size=1)
    steps = 2 * (config.background.steps + config.pose.steps + config.shape.steps + 3)
    for _ in range(2):
        fine_tune(config, photographs(2)[0], tiny_model().eval(), tiny_extractor(), Checkpoint(tmp_path, "key"))
        assert bars[-1].total == bars[-1].n == steps


def test_it_starts_from_a_flipped_view_that_fits_better() -> None:
    outputs = outputs_of(2)
    student = outputs.values["pose"].clone()
    outputs.heads[:] = student[:, None]
    rear = torch.atan2(-student[:, 1], -student[:, 0])
    choose_start(outputs, lambda found: 1 - (found.pose.azimuth - rear).cos(), 3)
    torch.testing.assert_close(outputs.values["pose"], torch.cat([-student[:, :2], student[:, 2:]], 1))
