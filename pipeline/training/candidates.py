"""Poses and shapes that are tried for each training photograph (paper sections 3.2.1 and 3.2.2).

Candidates are laid out one after the other, each for the whole batch: row `candidate * batch + photograph`. Processes
that share a batch draw alike for all of its photographs and keep what belongs to their own.
"""

import math
from dataclasses import dataclass, replace
from typing import Annotated, NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from pipeline.device import constant
from pipeline.distributed import share, whole
from pipeline.errors import ConfigError
from pipeline.networks.full_model import FullModel
from pipeline.networks.pose_decoder import PoseRegression
from pipeline.ranges import Angle, Natural, NonNegative, Positive, Range

Flips = Annotated[int, Range(0, 3)]
"""How many flipped views of a pose are looked at: the far side, left and right swapped, front and rear swapped."""

_SAME_SIDE = 90.0
"""Degrees of azimuth, either way, beyond which a pose shows the object from the far side."""


@dataclass(frozen=True)
class ShapeSearchConfig:
    """How many shapes a photograph gets in one iteration, and how far they lie from its record.

    Sizes are those of the shape space's `draw`.
    """

    random: Natural
    """Drawn around the base shape."""
    perturbed: Natural
    """Drawn around the recorded shape."""
    step: tuple[Positive, Positive]
    """Smallest and largest size of a perturbation; drawn log-uniformly."""
    spread: NonNegative
    """Of random shapes."""

    def __post_init__(self) -> None:
        """Raise ConfigError for a step whose bounds are the wrong way round."""
        check_step("step", self.step)


@dataclass(frozen=True)
class ExplorationConfig:
    """How many candidates of each kind a photograph gets in one iteration, and how far they lie from its record."""

    map_weights: tuple[NonNegative, ...]
    """Weights of the pictures and of the first feature maps when candidates are compared, see `comparable`."""
    random_poses: Natural
    """Drawn from the whole pose range."""
    turned_poses: Natural
    """The recorded pose with other azimuths, evenly spread over the circle from a random start."""
    raised_poses: Natural
    """The recorded pose with other elevations, evenly spread over their range from a random start.

    A small picture fits about as well from a wrong elevation, by a shape that is wrong too: a search in small steps
    would leave the elevation where it was, and shapes would make up for it.
    """
    flipped_poses: Flips
    """Up to three: the recorded pose from the opposite side, with left and right, and with front and rear swapped.

    The outlines of such views hardly differ, so that neither gradients nor small steps lead from one to the other.
    """
    perturbed_poses: Natural
    """Near the recorded pose."""
    shapes: ShapeSearchConfig | None
    """None searches for no shapes: the estimated one is the best, and always learns."""
    pose_step: tuple[Positive, Positive]
    """Smallest and largest standard deviation of a perturbation, in pose coordinates; drawn log-uniformly."""
    azimuth_reach: Angle
    """Largest angle, in degrees, between the azimuths of a winner and of the record; 180 admits all."""

    def __post_init__(self) -> None:
        """Raise ConfigError for a step whose bounds are the wrong way round."""
        check_step("pose_step", self.pose_step)


def check_step(name: str, step: tuple[float, float]) -> None:
    """Raise ConfigError where the bounds of a log-uniform size are the wrong way round."""
    if step[0] > step[1]:
        raise ConfigError(f"{name} is {list(step)}; expected the smaller size first")


def refining(config: ExplorationConfig) -> ExplorationConfig:
    """Return the config of poses from the record's side: no random, turned or flipped ones, no winner far from it."""
    reach = min(config.azimuth_reach, _SAME_SIDE)
    return replace(config, random_poses=0, turned_poses=0, flipped_poses=0, azimuth_reach=reach)


class Record(NamedTuple):
    """The best pose and shape found so far for some photographs."""

    pose: Float[Tensor, "N 7"]
    """Pose coordinates, see `PoseCoordinates`."""
    shape: Float[Tensor, "N K"]
    """Shape parameters; the last estimate where no shapes are searched for."""

    def rows(self, index: Int[Tensor, " B"]) -> "Record":
        """Return the record of some photographs."""
        return Record(self.pose[index], self.shape[index])


class Estimate(NamedTuple):
    """What the networks predict for a batch of photographs."""

    student: PoseRegression
    heads: PoseRegression
    """In rows of `B heads`."""
    mirrored: PoseRegression
    """The student's prediction for the photographs' mirror images."""
    shape: Float[Tensor, "B K"]
    texture_maps: Float[Tensor, "B 3 T T"]
    backgrounds: Float[Tensor, "B 3 H W"]


def first_record(model: FullModel, count: int, rng: torch.Generator) -> Record:
    """Start with random poses and the base shape."""
    return Record(model.poses.draw(count, rng), torch.zeros(count, model.shapes.parameter_count, device=rng.device))


class Candidates(NamedTuple):
    """Poses and shapes to compare; row i of both is one candidate of each photograph."""

    poses: Float[Tensor, "candidates B 7"]
    shapes: Float[Tensor, "candidates B K"]
    heads: slice
    """Which of the candidates are the ensemble's."""


def candidates(
    model: FullModel, estimate: Estimate, record: Record, config: ExplorationConfig, rng: torch.Generator
) -> Candidates:
    """List poses (recorded, estimated, near, turned, raised, flipped, random), then shapes.

    Poses come with the recorded shape, shapes with the recorded pose.

    Where no shapes are searched for, all poses come with the estimated shape, whose gradients flow.
    """
    batch = len(record.pose)
    first = torch.stack([record.pose, estimate.student.coordinates])
    ensemble = estimate.heads.coordinates.transpose(0, 1)
    heads = slice(len(first), len(first) + len(ensemble))
    poses = torch.cat(
        [
            first,
            ensemble,
            _near_poses(record.pose, config, rng),
            _turned(record.pose, config.turned_poses, rng),
            _raised(record.pose, config.raised_poses, rng),
            flipped(record.pose, config.flipped_poses),
            _random_poses(model, batch, config, rng),
        ]
    )
    poses = model.poses.clamp(poses)
    if config.shapes is None:
        return Candidates(poses, estimate.shape.expand(len(poses), -1, -1), heads)
    shapes = torch.cat(
        [
            estimate.shape[None],
            _near_shapes(model, record.shape, config.shapes, rng),
            _random_shapes(model, batch, config.shapes, rng),
        ]
    )
    pose_count, shape_count = len(poses), len(shapes)
    return Candidates(
        torch.cat([poses, record.pose.expand(shape_count, -1, -1)]),
        torch.cat([record.shape.expand(pose_count, -1, -1), shapes]),
        heads,
    )


def within_reach(
    poses: Float[Tensor, "candidates B 7"], recorded: Float[Tensor, "B 7"], azimuth_reach: float
) -> Bool[Tensor, "candidates B"]:
    """Tell which candidates' azimuths lie within some degrees of the recorded ones."""
    cosine = (poses[..., :2] * recorded[:, :2]).sum(dim=-1)
    return cosine >= math.cos(math.radians(azimuth_reach)) - 1e-5


def flipped(pose: Float[Tensor, "B 7"], count: int) -> Float[Tensor, "count B 7"]:
    """Turn poses to the opposite side, swap left and right, swap front and rear: the first `count` of the three."""
    cosine_and_sine = constant(((-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0)), pose)[:count, None]
    return torch.cat([cosine_and_sine * pose[:, :2], pose[:, 2:].expand(count, -1, -1)], dim=2)


def _near_poses(
    recorded: Float[Tensor, "B 7"], config: ExplorationConfig, rng: torch.Generator
) -> Float[Tensor, "count B 7"]:
    rows = (config.perturbed_poses, whole(len(recorded)))
    size = _sizes(rows, config.pose_step, rng)
    return recorded + share(size * torch.randn(*rows, 7, generator=rng, device=rng.device), dim=1)


def _near_shapes(
    model: FullModel, recorded: Float[Tensor, "B K"], config: ShapeSearchConfig, rng: torch.Generator
) -> Float[Tensor, "count B K"]:
    rows = (config.perturbed, whole(len(recorded)))
    size = _sizes(rows, config.step, rng)
    return recorded + share(model.shapes.draw(math.prod(rows), size.flatten(0, 1), rng).unflatten(0, rows), dim=1)


def _sizes(rows: tuple[int, int], step: tuple[float, float], rng: torch.Generator) -> Float[Tensor, "count B 1"]:
    smallest, largest = step
    return smallest * (largest / smallest) ** torch.rand(*rows, 1, generator=rng, device=rng.device)


def _turned(recorded: Float[Tensor, "B 7"], count: int, rng: torch.Generator) -> Float[Tensor, "count B 7"]:
    azimuth = 2 * math.pi * _spread(len(recorded), count, rng)
    turn = torch.stack([azimuth.cos(), azimuth.sin()], dim=2)
    return torch.cat([turn, recorded[:, 2:].expand(count, -1, -1)], dim=2)


def _raised(recorded: Float[Tensor, "B 7"], count: int, rng: torch.Generator) -> Float[Tensor, "count B 7"]:
    elevation = 2 * _spread(len(recorded), count, rng) - 1
    others = recorded.expand(count, -1, -1)
    return torch.cat([others[..., :2], elevation[..., None], others[..., 3:]], dim=2)


def _spread(batch: int, count: int, rng: torch.Generator) -> Float[Tensor, "count B"]:
    """Spread numbers evenly over [0, 1), each photograph's from a random start."""
    start = share(torch.rand(1, whole(batch), generator=rng, device=rng.device), dim=1)
    return (start + torch.arange(count, device=rng.device)[:, None]) / max(count, 1)


def _random_poses(
    model: FullModel, batch: int, config: ExplorationConfig, rng: torch.Generator
) -> Float[Tensor, "count B 7"]:
    drawn = model.poses.draw(config.random_poses * whole(batch), rng)
    return share(drawn.unflatten(0, (config.random_poses, whole(batch))), dim=1)


def _random_shapes(
    model: FullModel, batch: int, config: ShapeSearchConfig, rng: torch.Generator
) -> Float[Tensor, "count B K"]:
    drawn = model.shapes.draw(config.random * whole(batch), config.spread, rng)
    return share(drawn.unflatten(0, (config.random, whole(batch))), dim=1)
