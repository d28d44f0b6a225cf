"""The terms of full training's loss: how they are weighed, and which networks learn from them."""

from dataclasses import fields, replace
from typing import Any, Literal
from unittest.mock import patch

import pytest
import torch
from torch import Tensor, nn

from pipeline.errors import ConfigError
from pipeline.losses.image_distance import feature_distance
from pipeline.losses.smoothness import SmoothnessConfig
from pipeline.networks.discriminator import ViewDiscriminator
from pipeline.networks.full_model import Reconstruction
from pipeline.networks.pose_decoder import regression_error
from pipeline.seeding import generator, initialised
from pipeline.training import full_trainer
from pipeline.training.candidates import Record
from pipeline.training.exploration import Best
from pipeline.training.full_trainer import FullTrainer
from pipeline.training.photographs import Photographs
from tests.tiny_full_model import ENDS, TRAINING, base_mesh, exact_regression, photographs, tiny_extractor

UNWEIGHTED = replace(
    TRAINING.loss,
    **{field.name: 0.0 for field in fields(TRAINING.loss) if field.name != "smoothness"},
    smoothness=SmoothnessConfig(0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
)
POSES = {"pose_encoder", "pose_decoder"}
TEXTURES = {"texture_encoder", "texture_decoder"}
BACKGROUNDS = {"background_encoder", "background_decoder"}


def trainer_of(*, two_stage: bool = True) -> FullTrainer:
    """Build a trainer whose estimated shapes, and whose base shape where it learns, are not those it starts with."""
    images, _ = photographs(4)
    extractor = tiny_extractor()
    config = replace(TRAINING, model=replace(TRAINING.model, two_stage=two_stage))
    trainer = FullTrainer(config, Photographs(images, extractor, 4, 2**30), base_mesh(), 0)
    rng = generator(0)
    with torch.no_grad():
        for parameter in trainer.model.shape_decoder.parameters():
            parameter += 0.2 * torch.randn(parameter.shape, generator=rng)
        for parameters_by_vertex in trainer.model.shapes.parameters():
            parameters_by_vertex[3] = 0.1
    return trainer


def terms_of(trainer: FullTrainer) -> dict[str, Tensor]:
    """Compare the photographs with what is recorded of them, which no network has estimated."""
    images, features = trainer.photographs.batch(torch.arange(4))
    _, poses = photographs(4)
    record = Record(poses, trainer.model.shapes.draw(4, 0.5, generator(3)))
    best = Best(record, torch.zeros(4, dtype=torch.int64))
    return trainer.loss.terms(features, trainer.estimate(images, features), best, generator(1))


@pytest.mark.parametrize(
    "name", [field.name for field in fields(TRAINING.loss) if field.name not in ("smoothness", "deepest_map")]
)
def test_a_term_counts_by_its_weight(name: str) -> None:
    trainer = trainer_of()
    trainer.loss.config = replace(UNWEIGHTED, **{name: 3.0})
    terms = terms_of(trainer)
    assert terms[name].abs() > 1e-4
    torch.testing.assert_close(terms["loss"], terms["reconstruction"] + 3 * terms[name])


def test_the_smoothness_of_single_stage_shapes_counts() -> None:
    trainer = trainer_of(two_stage=False)
    trainer.loss.config = replace(UNWEIGHTED, smoothness=TRAINING.loss.smoothness)
    terms = terms_of(trainer)
    assert terms["smoothness"] > 1e-2
    torch.testing.assert_close(terms["loss"], terms["reconstruction"] + terms["smoothness"])


@pytest.mark.parametrize("name", ["reconstruction", "feature_matching"])
def test_the_deepest_map_counts_by_its_weight(name: str) -> None:
    trainer = trainer_of()
    terms = []
    for weight in (0.0, 1.0, 3.0):
        trainer.loss.config = replace(UNWEIGHTED, deepest_map=weight)
        terms.append(terms_of(trainer)[name])
    assert terms[1] > terms[0] > 0
    torch.testing.assert_close(terms[2] - terms[0], 3 * (terms[1] - terms[0]))


@pytest.mark.parametrize(
    ("name", "taught"),
    [
        ("reconstruction", TEXTURES | BACKGROUNDS | {"shapes"}),
        ("feature_matching", TEXTURES | BACKGROUNDS | {"shapes"}),
        ("pose_regression", POSES),
        ("mirrored_regression", POSES),
        ("rendered_regression", POSES),
        ("shape_regression", {"shape_encoder", "shape_decoder"}),
        ("rendered_shape_regression", {"shape_encoder", "shape_decoder"}),
        ("shape_prior", {"shape_encoder", "shape_decoder"}),
        ("total_variation", TEXTURES),
        ("copied_background", TEXTURES),
        ("view_prior", TEXTURES | BACKGROUNDS | {"shapes", "discriminator"}),
        ("base_roughness", {"shapes"}),
        ("base_thinness", {"shapes"}),
        ("smoothness", {"shape_encoder", "shape_decoder"}),
    ],
)
def test_a_term_teaches_its_networks_alone(name: str, taught: set[str]) -> None:
    trainer = trainer_of(two_stage=name != "smoothness")
    terms_of(trainer)[name].backward()
    networks = {**dict(trainer.model.named_children()), "discriminator": trainer.discriminator}
    assert {part for part, network in networks.items() if learns(network)} == taught


def test_shapes_are_compared_by_their_vertices() -> None:
    trainer = trainer_of()
    images, features = trainer.photographs.batch(torch.arange(4))
    estimate, shapes = trainer.estimate(images, features), trainer.model.shapes
    best = Best(Record(photographs(4)[1], shapes.draw(4, 0.5, generator(3))), torch.zeros(4, dtype=torch.int64))
    error = trainer.loss.terms(features, estimate, best, generator(1))["shape_regression"]
    torch.testing.assert_close(error, (shapes(estimate.shape) - shapes(best.record.shape)).abs().mean())


@pytest.mark.parametrize(("source", "calls"), [("features", 2), ("photographs", 1)])
def test_features_of_other_views_are_taken_where_shapes_are_read_off_them(
    source: Literal["features", "photographs"], calls: int
) -> None:
    images, _ = photographs(4)
    extractor = tiny_extractor()
    config = replace(TRAINING, model=replace(TRAINING.model, shapes_from=source))
    trainer = FullTrainer(config, Photographs(images, extractor, 4, 2**30), base_mesh(), 0)
    called: list[int] = []
    extractor.register_forward_hook(lambda *_: called.append(1))
    images, features = trainer.photographs.batch(torch.arange(4))
    called.clear()
    best = Best(Record(photographs(4)[1], trainer.model.shapes.draw(4, 0.5, generator(3))), torch.zeros(4).long())
    trainer.loss.terms(features, trainer.estimate(images, features), best, generator(1))
    assert len(called) == calls


def test_the_discriminator_descends_and_textures_ascend() -> None:
    for part, gains in (("discriminator", True), ("texture", False)):
        trainer = trainer_of()
        before = terms_of(trainer)["view_prior"]
        before.backward()
        network = trainer.discriminator if part == "discriminator" else trainer.model.texture_decoder
        with torch.no_grad():
            for parameter in network.parameters():
                assert parameter.grad is not None
                parameter -= 0.05 * parameter.grad / (parameter.grad.norm() + 1e-12)
        assert (terms_of(trainer)["view_prior"] < before) == gains


@pytest.mark.parametrize(("sign", "least", "most"), [(1, 0.0, 1e-3), (-1, 8.0, 10.0)])
def test_positive_scores_stand_for_estimated_views(sign: int, least: float, most: float) -> None:
    trainer, (_, poses) = trainer_of(), photographs(4)

    def knowing(_: Tensor, views: Tensor) -> Tensor:
        return sign * torch.where(torch.cdist(views, poses).amin(dim=1) < 1e-4, 9.0, -9.0)

    with patch.object(trainer.discriminator, "forward", knowing):
        assert least <= terms_of(trainer)["view_prior"] <= most


def test_the_discriminators_scores_do_not_grow_with_its_convolutions() -> None:
    discriminator = ViewDiscriminator(4, 7).eval()
    images, views = torch.rand(4, 3, 32, 32, generator=generator(0)), torch.rand(4, 7, generator=generator(1))
    before = discriminator(images, views)
    for parameter in discriminator.convolutions.parameters():
        parameter.data *= 10 if parameter.ndim > 1 else 1
    torch.testing.assert_close(discriminator(images, views), before)


@pytest.mark.parametrize(
    ("setting", "used"),
    [
        ("first_poses", {"first_poses": TRAINING.first_poses}),
        (r"ends\.after", {"ends": replace(ENDS, after=(0.5,))}),
        (r"loss\.mirrored_regression", {"loss": TRAINING.loss}),
    ],
)
def test_what_is_for_mirror_symmetric_objects_is_refused_for_others(setting: str, used: dict[str, Any]) -> None:
    shape = replace(TRAINING.model.shape, mirror=False, base_learning=None)
    unused = {"first_poses": None, "ends": ENDS, "loss": replace(TRAINING.loss, mirrored_regression=0.0)}
    without = replace(TRAINING, model=replace(TRAINING.model, shape=shape), **unused)
    with pytest.raises(ConfigError, match=rf"^{setting} is for mirror-symmetric objects"):
        replace(without, **used)


def test_ends_told_before_the_first_iteration_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"ends cannot be told before the first of 40 iterations; .* least 1/40"):
        replace(TRAINING, iterations=40, ends=replace(ENDS, after=(0.02,)))
    replace(TRAINING, iterations=40, ends=replace(ENDS, after=(0.025, 1.0)))


def learns(network: nn.Module) -> bool:
    """Say whether a gradient has reached a network."""
    return any(parameter.grad is not None and bool(parameter.grad.any()) for parameter in network.parameters())


def test_random_views_share_box_and_frame_with_the_estimated_ones_and_know_their_own_turns() -> None:
    trainer, (_, poses) = trainer_of(), photographs(4)
    given: list[tuple[Tensor, Tensor]] = []
    trainer.discriminator.register_forward_pre_hook(lambda _, arguments: given.append(arguments))
    terms = terms_of(trainer)
    [(images, views)] = given
    (estimated, turned), others = views.chunk(2), images.chunk(2)[1]
    assert torch.equal(estimated, poses)
    assert torch.equal(turned[:, 3:], poses[:, 3:])
    assert (turned[:, :3] != poses[:, :3]).all()
    said = trainer.model.pose_decoder(trainer.model.pose_encoder(others))
    torch.testing.assert_close(terms["rendered_regression"], regression_error(said, turned).mean())


def test_mirror_images_are_read_at_mirrored_poses() -> None:
    trainer, (_, poses) = trainer_of(), photographs(4)
    images, features = trainer.photographs.batch(torch.arange(4))
    estimate, model = trainer.estimate(images, features), trainer.model
    read = model.pose_decoder(model.pose_encoder(images.flip(-1)))
    torch.testing.assert_close(estimate.mirrored.coordinates, read.coordinates)
    known = estimate._replace(mirrored=exact_regression(model.poses.mirror(poses)))
    best = Best(Record(poses, trainer.records.best.shape), torch.zeros(4).long())
    assert trainer.loss.mirrored_regression(known, best) < 1e-5


def test_what_exploration_finds_is_recorded_for_the_photographs_that_were_drawn(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    trainer, index = trainer_of(), torch.tensor([2, 0, 3, 1])
    found = Record(trainer.model.poses.draw(4, generator(5)), trainer.model.shapes.draw(4, 0.5, generator(6)))
    monkeypatch.setattr(full_trainer, "explore", lambda *_: Best(found, torch.zeros(4).long()))
    monkeypatch.setattr(trainer, "draw", lambda _: index)
    trainer.step(TRAINING.iterations - 1)
    for kept, wanted in zip(trainer.records.best.rows(index), found, strict=True):
        assert torch.equal(kept, wanted)


def test_codes_of_the_first_photographs_are_centred_before_training() -> None:
    trainer = trainer_of()
    images, _ = trainer.photographs.batch(torch.arange(4))
    codes = trainer.model.pose_encoder(images)
    torch.testing.assert_close(codes.mean(dim=0), torch.zeros(codes.shape[1]), atol=1e-3, rtol=0)


def test_the_rate_of_full_training_cools_down() -> None:
    trainer = trainer_of()
    trainer.config = replace(trainer.config, iterations=4, cool_down=0.5, learning_rate=1e-3)
    rates = []
    for iteration in range(4):
        trainer.step(iteration)
        rates.append(trainer.optimizer.param_groups[0]["lr"])
    assert rates == pytest.approx([1e-3, 1e-3, 1e-3, 5e-4])


def test_a_step_moves_the_discriminator_too() -> None:
    trainer = trainer_of()
    before = {name: value.clone() for name, value in trainer.discriminator.named_parameters()}
    trainer.step(0)
    assert all(not torch.equal(before[name], value) for name, value in trainer.discriminator.named_parameters())


def test_full_training_takes_the_betas_of_its_settings() -> None:
    assert trainer_of().optimizer.defaults["betas"] == TRAINING.betas


def test_reconstruction_is_the_mean_over_photographs() -> None:
    trainer = trainer_of()
    trainer.loss.config = replace(UNWEIGHTED, deepest_map=1.0)
    images, features = trainer.photographs.batch(torch.arange(4))
    estimate, model = trainer.estimate(images, features), trainer.model
    record = Record(photographs(4)[1], model.shapes.draw(4, 0.5, generator(3)))
    vertices = model.shapes(record.shape)
    pose = model.poses(record.pose, vertices)
    drawn = model.render(Reconstruction(vertices, estimate.texture_maps, pose, estimate.backgrounds))
    terms = trainer.loss.terms(features, estimate, Best(record, torch.zeros(4).long()), generator(1))
    expected = feature_distance(features, trainer.extractor(drawn))
    torch.testing.assert_close(terms["reconstruction"], expected.sum() / 4)


def test_the_discriminator_judges_by_the_view() -> None:
    with initialised(0):
        discriminator = ViewDiscriminator(4, 7).eval()
    images, views = torch.rand(4, 3, 32, 32, generator=generator(0)), torch.rand(4, 7, generator=generator(1))
    assert not torch.isclose(discriminator(images, views), discriminator(images, views.roll(1, 0)), atol=1e-3).any()
