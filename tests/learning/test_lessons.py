"""Lessons from known poses."""

from dataclasses import replace
from itertools import pairwise

import pytest
import torch
from torch import Tensor

from pipeline.errors import TrainingDiverged
from pipeline.networks.pose_decoder import regression_error
from pipeline.seeding import generator
from pipeline.training.lessons import LessonsConfig, learn_poses
from tests.tiny_full_model import MODEL, photographs, tiny_model

LESSONS = LessonsConfig(60, 16, 3e-3, (0.9, 0.99))


def test_the_student_learns_to_read_poses_off_photographs_and_their_mirror_images() -> None:
    model = tiny_model()
    images, coordinates = photographs(80)
    index = torch.arange(80)[::2]
    pictures, poses = images[index].float() / 255, coordinates[index]

    def errors() -> Tensor:
        with torch.no_grad():
            here = regression_error(model.pose_decoder(model.pose_encoder(pictures)), poses)
            mirrored = model.pose_decoder(model.pose_encoder(pictures.flip(-1)))
            return torch.stack([here, regression_error(mirrored, model.poses.mirror(poses))])

    before = errors()
    others = [parameter.clone() for parameter in model.texture_encoder.parameters()]
    learn_poses(model, images, index, poses, LESSONS, generator(0))
    assert (errors() < 0.7 * before).all()
    assert all(map(torch.equal, others, model.texture_encoder.parameters()))


def test_mirror_images_teach_symmetric_objects_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    images, coordinates = photographs(8)
    taught: list[int] = []
    for mirror in (True, False):
        model = tiny_model(shape=replace(MODEL.shape, mirror=mirror))
        encoder = model.pose_encoder.forward
        monkeypatch.setattr(model.pose_encoder, "forward", lambda x, e=encoder: (taught.append(len(x)), e(x))[1])
        learn_poses(model, images, torch.arange(8), coordinates, replace(LESSONS, iterations=1), generator(0))
    assert taught == [32, 16]


@pytest.mark.parametrize(
    ("iterations", "message"),
    [(60, "the loss of lessons became"), (1, "no longer finite after iteration 1 of lessons")],
)
def test_lessons_that_diverge_stop(iterations: int, message: str) -> None:
    images, coordinates = photographs(8)
    config = replace(LESSONS, iterations=iterations, learning_rate=1e39)
    with pytest.raises(TrainingDiverged, match=message):
        learn_poses(tiny_model(), images, torch.arange(8), coordinates, config, generator(0))


def test_every_head_learns() -> None:
    model = tiny_model()
    images, poses = photographs(80)

    def errors() -> Tensor:
        with torch.no_grad():
            said = model.pose_decoder.ensemble(model.pose_encoder(images.float() / 255))
        heads = [type(said)(*(part[:, head] for part in said)) for head in range(said.coordinates.shape[1])]
        return torch.stack([regression_error(one, poses).mean() for one in heads])

    before = errors()
    learn_poses(model, images, torch.arange(80), poses, LESSONS, generator(0))
    assert (errors() < 0.8 * before).all()


def test_steps_grow_smaller_in_the_second_half_of_the_lessons() -> None:
    model, (images, coordinates) = tiny_model(), photographs(8)
    weight, weights = model.pose_encoder.project.weight, list[Tensor]()
    model.pose_encoder.register_forward_pre_hook(lambda *_: weights.append(weight.detach().clone()))
    config = LessonsConfig(8, 4, 1e-2, (0.0, 0.0))  # without momentum every step is as long as the rate
    learn_poses(model, images, torch.arange(8), coordinates, config, generator(0))
    lengths = [(after - before).abs().max() for before, after in pairwise([*weights, weight.detach()])]
    torch.testing.assert_close(torch.stack(lengths[:4]), torch.full((4,), 1e-2), atol=1e-5, rtol=0)
    assert lengths[4] > lengths[5] > lengths[6] > lengths[7]
