"""The warm-up on renderings of the base shape."""

from dataclasses import replace

import torch

from pipeline.seeding import generator
from pipeline.training.warm_up import draw_sample, warm_up
from tests.tiny_full_model import TRAINING, tiny_model, tiny_scenes

CONFIG = replace(TRAINING.warm_up, iterations=150, batch_size=16, learning_rate=3e-3)


def test_warm_up_teaches_poses_of_unseen_renderings() -> None:
    model, scenes = tiny_model(), tiny_scenes()
    images, pose, _ = draw_sample(model, scenes, replace(CONFIG, batch_size=64), generator(1))

    def azimuth_cosines() -> torch.Tensor:
        with torch.no_grad():
            return (model.pose_decoder(model.pose_encoder(images))[:, :2] * pose[:, :2]).sum(1)

    before = azimuth_cosines().mean()
    warm_up(model, scenes, CONFIG, generator(0))
    assert before < 0.2
    assert azimuth_cosines().mean() > 0.35


def test_renderings_stay_in_range_and_differ() -> None:
    images, _, shape = draw_sample(tiny_model(), tiny_scenes(), CONFIG, generator(2))
    assert images.min() >= 0
    assert images.max() <= 1
    assert images.std(dim=0).mean() > 0.01
    assert shape.std() > 0
