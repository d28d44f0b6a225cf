"""Training HoloGAN on a category's photographs: generator against discriminator (Nguyen-Phuoc et al. 2019)."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, UInt8
from torch import Tensor
from torch.nn import functional

from pipeline.errors import DataError
from pipeline.networks.hologan import HoloDiscriminator, HoloGANConfig, HoloGenerator
from pipeline.ranges import Count, Momentum, NonNegative, Positive
from pipeline.seeding import generator, initialised
from pipeline.training.checkpoint import Checkpoint, Part
from pipeline.training.curves import Curve
from pipeline.training.loop import Schedule, run_training
from pipeline.training.optimization import adam, falling, set_learning_rate, take_step
from pipeline.training.viewpoints import ViewpointConfig, sample_viewpoints


@dataclass(frozen=True)
class HoloGANTrainingConfig:
    """Settings of HoloGAN's training."""

    iterations: Count
    batch_size: Count
    learning_rate: Positive
    """Of both networks; constant for half of the iterations, then falls linearly to zero."""
    betas: tuple[Momentum, Momentum]
    generator_steps: Count
    """Steps of the generator for one of the discriminator."""
    identity: NonNegative
    """Weight of the identity regularizer, the squared error of the noise read off generated pictures."""
    network: HoloGANConfig
    viewpoint: ViewpointConfig
    """The distribution that objects are turned by."""
    curve_every: Count
    """Iterations that one row of the curve averages."""
    checkpoint_every: Count
    """Iterations between restart states."""


class HoloGANTrainer:
    """Hold everything that changes while HoloGAN is trained."""

    def __init__(self, config: HoloGANTrainingConfig, images: UInt8[Tensor, "N 3 H W"], seed: int) -> None:
        """Build both networks and their optimizers on the photographs' device."""
        device = images.device
        self.config, self.images = config, images
        with initialised(seed, "hologan"):
            self.generator = HoloGenerator(config.network).to(device)
            self.discriminator = HoloDiscriminator(config.network).to(device)
        self.generator_optimizer, self.discriminator_optimizer = (
            adam(network.parameters(), config.learning_rate, config.betas)
            for network in (self.generator, self.discriminator)
        )
        self.rng = generator(seed, "hologan", device=device)

    def parts(self) -> dict[str, Part]:
        """Name everything a restart state has to hold."""
        return {
            "generator": self.generator,
            "discriminator": self.discriminator,
            "generator_optimizer": self.generator_optimizer,
            "discriminator_optimizer": self.discriminator_optimizer,
            "rng": self.rng,
        }

    def step(self, iteration: int) -> dict[str, Float[Tensor, ""]]:
        """Improve the discriminator once and the generator `generator_steps` times on the same noise and views.

        Returns the losses of the discriminator and of the generator's last step, on the device.
        """
        config = self.config
        rate = falling(config.learning_rate, iteration, config.iterations, 0.5)
        set_learning_rate(rate, self.generator_optimizer, self.discriminator_optimizer)
        latent = self.generator.sample_latent(config.batch_size, self.rng)
        pose = sample_viewpoints(config.viewpoint, config.batch_size, self.rng)
        draw = (latent, pose.azimuth, pose.elevation)
        with torch.no_grad():
            generated = self.generator(*draw)
        discrimination = self._improve_discriminator(generated, latent)
        improvements = [self._improve_generator(*draw) for _ in range(config.generator_steps)]
        imitation, identity = improvements[-1]
        losses = {"discriminator": discrimination, "generator": imitation, "identity": identity}
        return {name: loss.detach() for name, loss in losses.items()}

    def _improve_discriminator(
        self, generated: Float[Tensor, "B 3 H W"], latent: Float[Tensor, "B K"]
    ) -> Float[Tensor, ""]:
        index = torch.randint(len(self.images), (len(latent),), generator=self.rng, device=self.rng.device)
        real, _ = self.discriminator(self.images[index].float() / 127.5 - 1)
        score, read = self.discriminator(generated)
        loss = functional.softplus(-real).mean() + functional.softplus(score).mean()
        total = loss + self.config.identity * functional.mse_loss(read, latent)
        take_step(total, self.discriminator_optimizer)
        return loss

    def _improve_generator(
        self, latent: Float[Tensor, "B K"], azimuth: Float[Tensor, " B"], elevation: Float[Tensor, " B"]
    ) -> tuple[Float[Tensor, ""], Float[Tensor, ""]]:
        score, read = self.discriminator(self.generator(latent, azimuth, elevation))
        loss, identity = functional.softplus(-score).mean(), functional.mse_loss(read, latent)
        take_step(loss + self.config.identity * identity, self.generator_optimizer)
        return loss, identity


def train_hologan(
    config: HoloGANTrainingConfig, images: UInt8[Tensor, "N 3 H W"], seed: int, checkpoint: Checkpoint
) -> tuple[HoloGenerator, Curve]:
    """Train HoloGAN, going on from the checkpoint where there is one; return the generator and mean losses.

    A killed call that is repeated with the same checkpoint returns the same bytes (CPU). Raises TrainingDiverged, and
    DataError where the photographs are not of the networks' size.
    """
    size = config.network.image_size
    if images.shape[2:] != (size, size):
        raise DataError(f"train_hologan.network.image_size is {size}; photographs are {images.shape[3]} pixels wide")
    trainer = HoloGANTrainer(config, images, seed)
    schedule = Schedule(config.iterations, config.curve_every, config.checkpoint_every)
    return trainer.generator, run_training(trainer, schedule, "HoloGAN", checkpoint)
