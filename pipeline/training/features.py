"""Train the network whose features pictures are compared in (paper section 4.1: WRN-16-4 on CIFAR-10)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor, nn
from torch.nn import functional

from pipeline.datasets.images import Images, load_images, place_images
from pipeline.distributed import agree, average, share, shared_batch
from pipeline.errors import ConfigError, DataError
from pipeline.networks.wide_resnet import WideResNet, load_wide_resnet
from pipeline.ranges import Count, Fraction, Momentum, Natural, NonNegative, Positive
from pipeline.seeding import generator, initialised
from pipeline.training.augmentation import crop_and_mirror, to_float, turn
from pipeline.training.checkpoint import Checkpoint, Part
from pipeline.training.curves import Curve
from pipeline.training.loop import Schedule, run_training
from pipeline.training.optimization import set_learning_rate, take_step

_SAMPLE = 50_000
"""Evenly spread pictures, at most, whose colours stand for those of all."""


@dataclass(frozen=True)
class FeaturesConfig:
    """Say which network learns what, and how fast."""

    method: Literal["classification", "rotation", "transfer", "pretrained"]
    """Tell the data set's categories apart; or (self-supervised, no label at all) by how many right angles a picture
    was turned (Gidaris et al., 2018); or keep the features of given weights and learn only a classifier on them; or
    learn nothing and take a given network of another architecture as it is."""
    depth: Count
    """Layers of the wide residual network: 6 N + 4."""
    width: Count
    """Its widening factor."""
    epochs: Count
    batch_size: Count
    learning_rate: Positive
    """The peak of the one-cycle schedule, for this batch size."""
    warm_up: Fraction
    """The fraction of all iterations in which the learning rate rises, linearly, before it falls to zero."""
    momentum: Momentum
    weight_decay: NonNegative
    """On the weights of convolutions and of the classifier; normalisations and biases are free."""
    label_smoothing: Fraction
    color_weight: NonNegative
    """Weight of the pictures' own colours beside the network's features wherever pictures are compared."""
    distance: Positive
    """Mean distance of two photographs, summed over the feature maps, to which a `pretrained` network is scaled."""
    crop_margin: Natural
    """The largest random shift, in pixels; the border is reflected."""
    checkpoint_every: Count
    """Iterations between two restart states."""

    def __post_init__(self) -> None:
        """Raise ConfigError for a depth that no wide residual network has."""
        if self.depth < 10 or self.depth % 6 != 4:
            raise ConfigError(f"depth is {self.depth}; expected 10, 16, 22, 28 or so on")


class Pictures(NamedTuple):
    """Hold a split of a data set: pictures of all categories, and their category's number on the device."""

    images: Images
    labels: Int[Tensor, " N"]


class Batch(NamedTuple):
    """Hold pictures of one iteration, on the device, and what the network must tell of each."""

    images: UInt8[Tensor, "B 3 H W"]
    labels: Int[Tensor, " B"]


def list_categories(folder: Path) -> list[str]:
    """Name the categories of a prepared split in the order of their labels. Raises DataError where there are none."""
    categories = sorted(path.stem for path in folder.glob("*.npy"))
    if not categories:
        raise DataError(f"{folder} holds no pictures (*.npy); run prepare_data for its dataset first")
    return categories


def load_pictures(folder: Path, categories: Sequence[str], device: torch.device, memory: int) -> Pictures:
    """Load the categories of a prepared split, see `place_images`. Raises DataError where one is missing."""
    images = [load_images(folder / f"{category}.npy") for category in categories]
    labels = [torch.full((len(group),), label) for label, group in enumerate(images)]
    return Pictures(place_images(images, device, memory), torch.cat(labels).to(device))


class FeatureTrainer:
    """Hold everything that changes while a network is trained."""

    def __init__(
        self, config: FeaturesConfig, train: Pictures, initial: Path, precision: torch.dtype, seed: int
    ) -> None:
        """Build the network, on the pictures' device, and its optimizer; `initial` are the weights for `transfer`."""
        device = train.images.device
        self.config, self.train, self.precision, self.seed = config, train, precision, seed
        self.batch_size = shared_batch(config.batch_size, len(train.images))
        self.iterations_per_epoch = len(train.images) // self.batch_size
        self.iterations = config.epochs * self.iterations_per_epoch
        self.network = _build_network(config, train, initial, seed).to(device)
        self.optimizer = _build_optimizer(config, self.network)
        self.rng = generator(seed, "features", "augmentation", device=device)
        self.epoch, self.order = -1, torch.zeros(0, dtype=torch.int64, device=device)
        agree(self.network.state_dict().values())

    def parts(self) -> dict[str, Part]:
        """Name everything a restart state has to hold."""
        return {"network": self.network, "optimizer": self.optimizer, "rng": self.rng}

    def batch(self, iteration: int) -> Batch:
        """Draw the iteration's pictures, augmented, and what the network must tell of them."""
        epoch, position = divmod(iteration, self.iterations_per_epoch)
        if epoch != self.epoch:
            order = torch.randperm(len(self.train.images), generator=generator(self.seed, "features", "order", epoch))
            self.epoch, self.order = epoch, order.to(self.rng.device)
        index = self.order[position * self.batch_size : (position + 1) * self.batch_size]
        images = crop_and_mirror(self.train.images[index], self.config.crop_margin, self.rng)
        if self.config.method != "rotation":
            return Batch(images, self.train.labels[index])
        quarters = torch.randint(4, (len(index),), generator=self.rng, device=self.rng.device)
        return Batch(turn(images, quarters), quarters)

    def learning_rate(self, iteration: int) -> float:
        """Return the learning rate of an iteration."""
        return self.config.learning_rate * one_cycle(iteration, self.iterations, self.config.warm_up)

    def step(self, iteration: int) -> dict[str, Float[Tensor, ""]]:
        """Take one optimisation step and return its loss, on the device."""
        set_learning_rate(self.learning_rate(iteration), self.optimizer)
        images, labels = share(self.batch(iteration))
        with _multiplying_in(self.precision, images.device):
            scores = self.network.train(self.config.method != "transfer")(to_float(images))
            loss = functional.cross_entropy(scores, labels, label_smoothing=self.config.label_smoothing)
        take_step(loss, self.optimizer)
        return {"train_loss": average(loss.detach())}


def train_features(
    config: FeaturesConfig,
    train: Pictures,
    test: Pictures,
    initial: Path,
    precision: torch.dtype,
    seed: int,
    checkpoint: Checkpoint,
) -> tuple[WideResNet, Curve]:
    """Train a network and return it with one row an epoch: learning rate, mean loss, test accuracy.

    `precision` is that of convolutions and matrix products; weights have float32.

    A killed call that is repeated with the same checkpoint returns the same bytes (CPU). Raises TrainingDiverged.
    """
    trainer = FeatureTrainer(config, train, initial, precision, seed)

    def observe(iteration: int) -> dict[str, float]:
        right = told_right(trainer.network, test, config, precision)
        return {"learning_rate": trainer.learning_rate(iteration), "test_accuracy": right.mean().item()}

    schedule = Schedule(trainer.iterations, trainer.iterations_per_epoch, config.checkpoint_every)
    curve = run_training(trainer, schedule, "feature training", checkpoint, observe=observe)
    return trainer.network.eval(), curve


@torch.no_grad()
def told_right(
    network: WideResNet, pictures: Pictures, config: FeaturesConfig, precision: torch.dtype
) -> Float[Tensor, " N"]:
    """Return which pictures the network tells right, as 0 or 1; for `rotation`, the share of each one's four turns."""
    network.eval()
    shares = []
    for images, labels in zip(*(part.split(config.batch_size) for part in pictures), strict=True):
        right = []
        for quarters in range(4 if config.method == "rotation" else 1):
            turned = images.rot90(quarters, (2, 3))
            answers = torch.full_like(labels, quarters) if config.method == "rotation" else labels
            with _multiplying_in(precision, images.device):
                right.append(network(to_float(turned)).argmax(dim=1) == answers)
        shares.append(torch.stack(right).double().mean(dim=0))
    return torch.cat(shares)


def measure(path: Path, test: Pictures, config: FeaturesConfig, device: torch.device) -> dict[str, float]:
    """Measure the accuracy of the weights as they are stored; its standard error is over pictures."""
    network = load_wide_resnet(path, device)
    shares = told_right(network, test, config, torch.float32)
    value, n = shares.mean().item(), len(shares)
    error = math.sqrt(max(0.0, shares.square().mean().item() - value * value) / n)
    return {"accuracy": value, "accuracy_standard_error": error, "n": n, "parameters": count_parameters(network)}


def count_parameters(network: nn.Module) -> int:
    """Return the number of weights and biases."""
    return sum(parameter.numel() for parameter in network.parameters())


def one_cycle(iteration: int, iterations: int, warm_up: float) -> float:
    """Return the learning rate, as a fraction of its peak: up linearly from zero, then down linearly to zero."""
    progress = (iteration + 0.5) / iterations
    return progress / warm_up if progress < warm_up else (1 - progress) / (1 - warm_up)


def _multiplying_in(precision: torch.dtype, device: torch.device) -> torch.autocast:
    return torch.autocast(device.type, torch.bfloat16, enabled=precision == torch.bfloat16)


def _build_network(config: FeaturesConfig, train: Pictures, initial: Path, seed: int) -> WideResNet:
    classes = 4 if config.method == "rotation" else int(train.labels.max()) + 1
    if config.method == "transfer":
        return _with_new_classifier(load_wide_resnet(initial, torch.device("cpu")), classes, config, seed)
    if classes < 2:
        raise ConfigError(
            "train_features.method is classification but the data set has one category; set it to rotation, "
            "which needs no categories, or to transfer"
        )
    with initialised(seed, "features", "network"):
        network = WideResNet(config.depth, config.width, classes)
    sample = train.images[:: -(-len(train.images) // _SAMPLE)]
    for channel, name in enumerate(("red", "green", "blue")):
        std, mean = torch.std_mean(sample[:, channel].float() / 255)
        if std == 0:
            raise DataError(f"the {name} of all training pictures is the same everywhere; expected colour photographs")
        network.std[:, channel], network.mean[:, channel] = std.cpu(), mean.cpu()
    return network.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]


def _with_new_classifier(network: WideResNet, classes: int, config: FeaturesConfig, seed: int) -> WideResNet:
    if (network.depth, network.width) != (config.depth, config.width):
        raise ConfigError(
            f"train_features.depth and .width are {config.depth} and {config.width}, but the weights to start from are "
            f"WRN-{network.depth}-{network.width}; set both to those"
        )
    with initialised(seed, "features", "network"):
        classifier = nn.Linear(network.classifier.in_features, classes)
    network.requires_grad_(False).classifier = classifier
    network.classes = classes
    return network.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]


def _build_optimizer(config: FeaturesConfig, network: WideResNet) -> torch.optim.SGD:
    learned = [parameter for parameter in network.parameters() if parameter.requires_grad]
    decayed = [parameter for parameter in learned if parameter.ndim > 1]
    free = [parameter for parameter in learned if parameter.ndim == 1]
    groups = [{"params": decayed, "weight_decay": config.weight_decay}, {"params": free, "weight_decay": 0.0}]
    return torch.optim.SGD(groups, lr=config.learning_rate, momentum=config.momentum, nesterov=config.momentum > 0)
