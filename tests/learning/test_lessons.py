"""Lessons from known poses."""

import torch
from torch import Tensor

from pipeline.networks.pose_decoder import regression_error
from pipeline.seeding import generator
from pipeline.training.lessons import LessonsConfig, learn_poses
from tests.tiny_full_model import photographs, tiny_model


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
    learn_poses(model, images, index, poses, LessonsConfig(60, 16, 3e-3, (0.9, 0.99)), generator(0))
    assert (errors() < 0.7 * before).all()
    assert all(map(torch.equal, others, model.texture_encoder.parameters()))
