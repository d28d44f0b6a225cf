"""The state of full training, and one step of it (paper section 3.2)."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn import functional

from pipeline.distributed import agree, average_losses, gather, share, shared_batch
from pipeline.errors import ConfigError
from pipeline.geometry.camera import Pose
from pipeline.losses.image_distance import Features
from pipeline.networks.discriminator import ViewDiscriminator
from pipeline.networks.full_model import FullModel, FullModelConfig
from pipeline.networks.pose_coordinates import POSE_COORDINATES
from pipeline.networks.scene_generator import LearnedScenes
from pipeline.ranges import Count, Fraction, Momentum, Natural, Positive
from pipeline.rendering.renderer import Mesh
from pipeline.seeding import generator, initialised
from pipeline.training.candidates import (
    Estimate,
    ExplorationConfig,
    first_record,
    flipped,
    refining,
)
from pipeline.training.checkpoint import Part
from pipeline.training.cuda_graph import GraphedStep
from pipeline.training.ends import EndsConfig, tell_ends
from pipeline.training.exploration import explore
from pipeline.training.first_poses import FirstPosesConfig, first_poses, read_all_poses
from pipeline.training.full_losses import FullLoss, LossConfig
from pipeline.training.lessons import LessonsConfig, learn_poses
from pipeline.training.optimization import adam, falling, set_learning_rate, take_step
from pipeline.training.photographs import Photographs
from pipeline.training.warm_up import WarmUpConfig, warm_up

_CHUNK = 10_000
"""Photographs whose recorded shapes are held at once."""


@dataclass(frozen=True)
class EllipsoidConfig:
    """The shape that single-stage training starts from (paper section 4.1.3)."""

    dimensions: tuple[Positive, Positive, Positive]
    """Width, height and depth, up to a common factor."""
    subdivisions: Natural
    """Of the icosphere."""


@dataclass(frozen=True)
class FullTrainingConfig:
    """Settings of full training."""

    iterations: Count
    batch_size: Count
    learning_rate: Positive
    betas: tuple[Momentum, Momentum]
    cool_down: Fraction
    """The last part of the iterations, over which the learning rate falls to zero; the paper has none."""
    photographs_per_iteration: Positive
    """Iteration i draws from the first i times this many photographs; the paper's curriculum has 1."""
    model: FullModelConfig
    ellipsoid: EllipsoidConfig
    warm_up: WarmUpConfig
    """Of two-stage training alone: there is nothing to render without a base shape."""
    first_poses: FirstPosesConfig | None
    """Of two-stage training alone; None leaves records at the paper's random poses."""
    lessons: LessonsConfig
    """From the first poses, from the recorded ones when ends are told apart, and from those after training."""
    ends: EndsConfig | None
    """None leaves ends as they are recorded."""
    settle: Fraction
    """The first part of the iterations, in which poses are refined, but not turned to the object's far side at once:
    textures that mean nothing yet would choose between its ends blindly, and undo what `ends` told
    (docs/decisions/poses.md). 1 is all of them, which leaves random, turned and flipped poses out. Without first poses
    there is nothing to keep, and poses are free from the start."""
    exploration: ExplorationConfig
    loss: LossConfig
    discriminator_width: Count
    curve_every: Count
    """Iterations that one row of the curve averages."""
    checkpoint_every: Count
    """Iterations between restart states."""

    def __post_init__(self) -> None:
        """Raise ConfigError for parts that are for mirror-symmetric objects alone."""
        if not self.model.shape.mirror:
            for name, value in (
                ("first_poses", self.starts_from_first_poses),
                ("ends", self.ends),
                ("loss.mirrored_regression", self.loss.mirrored_regression),
            ):
                if value:
                    raise ConfigError(
                        f"train_full.{name} is for mirror-symmetric objects, but train_full.model.shape.mirror is "
                        "false; expected null or 0, as in the ablation no-symmetry"
                    )

    @property
    def starts_from_first_poses(self) -> bool:
        """Whether records start from first poses, which are compared with renderings of the base shape."""
        return self.model.two_stage and self.first_poses is not None


class FullTrainer:
    """Hold everything that changes during full training, and change it one step at a time."""

    def __init__(self, config: FullTrainingConfig, photographs: Photographs, base: Mesh, seed: int) -> None:
        """Build networks, as precise as the extractor, optimiser and random streams from the seed."""
        device = photographs.images.device
        self.config, self.photographs, self.extractor = config, photographs, photographs.extractor
        first = torch.arange(min(4 * config.batch_size, len(photographs.images)), device=device)
        images, features = photographs.batch(first)
        with initialised(seed, "full_model"):
            channels = sum(layer.shape[1] for layer in features)
            self.model = FullModel(config.model, base, self.extractor.precision, channels).to(device)
        self.model.standardize(images, features)
        with initialised(seed, "view_discriminator"):
            self.discriminator = ViewDiscriminator(config.discriminator_width, POSE_COORDINATES).to(device)
        self.loss = FullLoss(config.loss, self.model, self.discriminator, self.extractor)
        parameters = [*self.model.parameters(), *self.discriminator.parameters()]
        self.optimizer = adam(parameters, config.learning_rate, config.betas)
        self.rng = generator(seed, "full_training", device=device)
        self.record = first_record(self.model, len(photographs.images), self.rng)
        self.visits = torch.zeros(len(photographs.images), dtype=torch.int64, device=device)
        self._refine, self._explore = map(self._graphed, (refining(config.exploration), config.exploration))
        agree([*self.model.state_dict().values(), *self.discriminator.state_dict().values()])

    def draw(self, iteration: int) -> Int[Tensor, " B"]:
        """Draw different photographs from the first to the i-th, counted from 1; at least a batch (paper 3.2.3)."""
        config, count = self.config, len(self.photographs.images)
        reached = int(config.photographs_per_iteration * (iteration + 1))
        among = min(count, max(config.batch_size, reached))
        order = torch.randperm(among, generator=self.rng, device=self.rng.device)
        return order[: shared_batch(config.batch_size, among)]

    def step(self, iteration: int) -> dict[str, Float[Tensor, ""]]:
        """Explore, record, and take one optimisation step; return the terms of the loss, on the device.

        Ends are told before the step where `ends.after` says so. Every process explores for its share of the
        photographs and records what all of them found.
        """
        self._turn_round_if_due(iteration)
        config = self.config
        set_learning_rate(falling(config.learning_rate, iteration, config.iterations, config.cool_down), self.optimizer)
        refines = config.starts_from_first_poses and iteration < config.settle * config.iterations
        return (self._refine if refines else self._explore)(self.draw(iteration))

    def _graphed(self, exploration: ExplorationConfig) -> Callable[[Tensor], dict[str, Float[Tensor, ""]]]:
        learn = partial(self._learn_from, exploration)
        return GraphedStep(learn, self.rng.device, self.rng) if self.photographs.on_device else learn

    def _learn_from(self, exploration: ExplorationConfig, index: Int[Tensor, " B"]) -> dict[str, Float[Tensor, ""]]:
        own = share(index)
        images, features = self.photographs.batch(own)
        estimate = self.estimate(images, features)
        best = explore(self.model, self.extractor, features, estimate, self.record.rows(own), exploration, self.rng)
        self.record.pose[index], self.record.shape[index] = gather(best.record.pose), gather(best.record.shape)
        self.visits[index] += 1
        losses = self.loss.terms(features, estimate, best, self.rng)
        take_step(losses["loss"], self.optimizer)
        return average_losses(losses)

    def starting_from(self, scenes: LearnedScenes) -> list[Callable[[], None]]:
        """List what comes before the first step of two-stage training: warm-up, first poses, lessons from them."""
        start = [partial(warm_up, self.model, scenes.generators[0], self.config.warm_up, self.rng)]
        if (first := self.config.first_poses) is not None:
            start += [partial(self._record_first_poses, scenes, first), partial(self._learn_first_poses, first)]
        return start

    def _record_first_poses(self, scenes: LearnedScenes, config: FirstPosesConfig) -> None:
        """Record first poses of the first photographs from the base shapes of all seeds."""
        images, light = self.photographs.images[: config.photographs], self.config.warm_up.light
        poses = first_poses(self.model, scenes, self.extractor, images, config, light, self.rng)
        agree([poses])
        self.record.pose[: len(poses)] = poses

    def _learn_first_poses(self, config: FirstPosesConfig) -> None:
        """Let the pose networks learn the recorded first poses, and record what they then read off the others."""
        photographs, poses = self.photographs.images, self.record.pose
        count = min(config.photographs, len(photographs))
        self._learn(torch.arange(count, device=poses.device), poses)
        if count < len(photographs):
            read = read_all_poses(self.model, photographs, count)
            agree([read])
            poses[count:] = read

    def turn_round(self, config: EndsConfig) -> None:
        """Turn recorded poses of photographs that show the opposite ends, and let the pose networks learn them.

        Photographs beyond the first, or without a visit, show the ends that the networks then read off them.
        """
        surely = self._record_told_ends(config)
        if not surely.any():
            return
        poses = self.record.pose
        self._learn(surely.nonzero().flatten(), poses)
        read = read_all_poses(self.model, self.photographs.images)
        agree([read])
        opposite = ~surely & ((read[:, :2] * poses[:, :2]).sum(dim=1) < 0)
        poses.copy_(torch.where(opposite[:, None], flipped(poses, 1)[0], poses))

    def finish(self) -> None:
        """Tell ends where they are to be told after training, and let the pose networks learn all visited records."""
        self._turn_round_if_due(self.config.iterations)
        index = self.visits.nonzero().flatten()
        if len(index):
            self._learn(index, self.record.pose)

    def _turn_round_if_due(self, done: int) -> None:
        ends = self.config.ends
        if ends is not None and done in (int(part * self.config.iterations) for part in ends.after):
            self.turn_round(ends)

    def _record_told_ends(self, config: EndsConfig) -> Bool[Tensor, " N"]:
        """Turn records of the first photographs, those visited, that show the opposite ends; tell which are sure."""
        images, poses, model = self.photographs.images[: config.photographs], self.record.pose, self.model
        read = read_all_poses(model, images)
        told = tell_ends(images, poses[: len(read)], read, model.poses, self.extractor, config, self.rng)
        agree([told])
        told = functional.pad(told, (0, len(poses) - len(told))) * (self.visits > 0)
        poses.copy_(torch.where(told[:, None] < 0, flipped(poses, 1)[0], poses))
        return told != 0

    def _learn(self, index: Int[Tensor, " K"], poses: Float[Tensor, "N 7"]) -> None:
        learn_poses(self.model, self.photographs.images, index, poses[index], self.config.lessons, self.rng)

    def estimate(self, images: Float[Tensor, "B 3 H W"], features: Features) -> Estimate:
        """Run all encoders and decoders on a batch of photographs."""
        model = self.model
        pose_code, mirrored_code = model.pose_encoder(torch.cat([images, images.flip(-1)])).chunk(2)
        return Estimate(
            model.pose_decoder(pose_code),
            model.pose_decoder.ensemble(pose_code),
            model.pose_decoder(mirrored_code),
            model.read_shapes(images, features),
            model.texture_decoder(model.texture_encoder(images)),
            model.background_decoder(model.background_encoder(images)),
        )

    @torch.no_grad()
    def recorded_pose(self) -> Pose:
        """Return the best poses of all training photographs; those without a visit have the one they started with."""
        rows = zip(self.record.pose.split(_CHUNK), self.record.shape.split(_CHUNK), strict=True)
        poses = [self.model.poses(pose, self.model.shapes(shape)) for pose, shape in rows]
        return Pose(*(torch.cat(values) for values in zip(*poses, strict=True)))

    def parts(self) -> dict[str, Part]:
        """Name everything a restart state has to hold."""
        return {
            "model": self.model,
            "discriminator": self.discriminator,
            "optimizer": self.optimizer,
            "rng": self.rng,
            "pose": self.record.pose,
            "shape": self.record.shape,
            "visits": self.visits,
        }
