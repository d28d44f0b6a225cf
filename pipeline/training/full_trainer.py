"""The state of full training, and one step of it (paper section 3.2)."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import torch
from jaxtyping import Float, Int
from torch import Tensor

from pipeline.distributed import agree, average_losses, require_divisible, share, shared_batch
from pipeline.errors import ConfigError
from pipeline.losses.image_distance import Features
from pipeline.networks.discriminator import ViewDiscriminator
from pipeline.networks.full_model import FullModel, FullModelConfig
from pipeline.networks.pose_coordinates import POSE_COORDINATES
from pipeline.networks.scene_generator import LearnedScenes
from pipeline.ranges import Count, Fraction, Momentum, Natural, Positive
from pipeline.rendering.renderer import Mesh
from pipeline.seeding import generator, initialised
from pipeline.training.candidates import Estimate, ExplorationConfig, refining
from pipeline.training.checkpoint import Part
from pipeline.training.cuda_graph import GraphedStep
from pipeline.training.ends import EndsConfig
from pipeline.training.exploration import explore
from pipeline.training.first_poses import FirstPosesConfig
from pipeline.training.full_losses import FullLoss, LossConfig
from pipeline.training.lessons import LessonsConfig
from pipeline.training.optimization import adam, falling, set_learning_rate, take_step
from pipeline.training.photographs import Photographs
from pipeline.training.records import Records
from pipeline.training.warm_up import WarmUpConfig, warm_up


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
    ends: EndsConfig
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
        """Raise ConfigError for ends told before the first step, and for parts of mirror-symmetric objects alone."""
        if any(int(part * self.iterations) == 0 for part in self.ends.after):
            raise ConfigError(
                f"ends.after is {list(self.ends.after)}, but ends cannot be told before the first of "
                f"{self.iterations} iterations; expected parts of at least 1/{self.iterations}"
            )
        if not self.model.shape.mirror:
            for name, value in (
                ("first_poses", self.starts_from_first_poses),
                ("ends.after", self.ends.after),
                ("loss.mirrored_regression", self.loss.mirrored_regression),
            ):
                if value:
                    raise ConfigError(
                        f"{name} is for mirror-symmetric objects, but model.shape.mirror is false; expected null, [] "
                        "or 0, as in the ablation no-symmetry"
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
        _require_divisible(config, len(photographs.images))
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
        self.records = Records(self.model, photographs, config.lessons, self.rng)
        self._refine = self._graphed(refining(config.exploration))
        self._explore = self._graphed(config.exploration)
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
        self._tell_ends_if_due(iteration)
        config = self.config
        set_learning_rate(falling(config.learning_rate, iteration, config.iterations, config.cool_down), self.optimizer)
        refines = config.starts_from_first_poses and iteration < config.settle * config.iterations
        return (self._refine if refines else self._explore)(self.draw(iteration))

    def _graphed(self, exploration: ExplorationConfig) -> Callable[[Tensor], dict[str, Float[Tensor, ""]]]:
        learn = partial(self._explore_and_learn, exploration)
        return GraphedStep(learn, self.rng.device, self.rng) if self.photographs.on_device else learn

    def _explore_and_learn(
        self, exploration: ExplorationConfig, index: Int[Tensor, " B"]
    ) -> dict[str, Float[Tensor, ""]]:
        own = share(index)
        images, features = self.photographs.batch(own)
        estimate = self.estimate(images, features)
        recorded = self.records.best.rows(own)
        best = explore(self.model, self.extractor, features, estimate, recorded, exploration, self.rng)
        self.records.keep(index, best.record)
        losses = self.loss.terms(features, estimate, best, self.rng)
        take_step(losses["loss"], self.optimizer)
        return average_losses(losses)

    def starting_from(self, scenes: LearnedScenes) -> list[Callable[[], None]]:
        """List what comes before the first step of two-stage training: warm-up, first poses, lessons from them."""
        config = self.config
        start = [partial(warm_up, self.model, scenes.generators[0], config.warm_up, self.rng)]
        if config.first_poses is not None:
            start += self.records.starting_from(scenes, config.first_poses, config.warm_up.light)
        return start

    def finish(self) -> None:
        """Tell ends where they are to be told after training, and teach the pose networks all visited records."""
        self._tell_ends_if_due(self.config.iterations)
        self.records.teach_visited()

    def _tell_ends_if_due(self, done: int) -> None:
        ends = self.config.ends
        if done in (int(part * self.config.iterations) for part in ends.after):
            self.records.turn_round(ends)

    def estimate(self, images: Float[Tensor, "B 3 H W"], features: Features) -> Estimate:
        """Run all encoders and decoders on a batch of photographs."""
        model = self.model
        pose_code, mirrored_code = model.pose_encoder(torch.cat([images, images.flip(-1)])).chunk(2)
        return Estimate(
            model.pose_decoder(pose_code),
            model.pose_decoder.ensemble(pose_code),
            model.pose_decoder(mirrored_code),
            model.read_shapes(images, features),
            model.read_textures(images),
            model.read_backgrounds(images),
        )

    def parts(self) -> dict[str, Part]:
        """Name everything a restart state has to hold."""
        return {
            "model": self.model,
            "discriminator": self.discriminator,
            "optimizer": self.optimizer,
            "rng": self.rng,
            **self.records.parts(),
        }


def _require_divisible(config: FullTrainingConfig, photographs: int) -> None:
    """Raise ConfigError for a batch that the processes cannot share, before hours are spent on the others."""
    require_divisible(shared_batch(config.batch_size, photographs))
    if config.model.two_stage and config.warm_up.iterations:
        require_divisible(config.warm_up.batch_size)
    if config.lessons.iterations:
        require_divisible(config.lessons.batch_size)
