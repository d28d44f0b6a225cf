"""Random viewpoints and lights of base-shape learning (paper 3.1.3, 3.1.5 and Table 4)."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.errors import ConfigError
from pipeline.geometry.camera import Pose, level_pose
from pipeline.ranges import Azimuth, Concentration, NonNegative
from pipeline.rendering.lighting import Light

_QUANTILES = 1025
"""Points at which a cumulative distribution is tabulated: the ends of 1024 intervals, within which it is linear."""


@dataclass(frozen=True)
class AngleConfig:
    """A symmetric Beta distribution stretched over an interval of degrees."""

    low: Azimuth
    """Smallest angle in degrees."""
    high: Azimuth
    """Largest angle in degrees."""
    concentration: Concentration
    """Both parameters of the Beta distribution; 1 is the uniform distribution."""

    def __post_init__(self) -> None:
        """Raise ConfigError for an interval that ends below its start."""
        if self.low > self.high:
            raise ConfigError(f"low is {self.low} and high is {self.high}; expected the smaller angle as low")


@dataclass(frozen=True)
class ViewpointConfig:
    """The fixed distribution of viewpoints of a category (paper Table 4)."""

    azimuth: AngleConfig
    elevation: AngleConfig
    mirrored: bool
    """Whether half of the azimuths are negated. Photographs show objects from both sides: with azimuths of one side
    only, as in the paper, a horse grows a head at either end."""

    def __post_init__(self) -> None:
        """Raise ConfigError for elevations beyond the poles."""
        if self.elevation.low < -90 or self.elevation.high > 90:
            raise ConfigError(
                f"elevation is {self.elevation.low} to {self.elevation.high}; expected degrees from -90 to 90"
            )


@dataclass(frozen=True)
class LightConfig:
    """Ambient and directional light; a surface facing the light has the brightness of their sum."""

    ambient: NonNegative
    directional: NonNegative


def sample_angles(config: AngleConfig, count: int, rng: torch.Generator) -> Float[Tensor, " B"]:
    """Draw angles in radians by inverting the tabulated cumulative distribution."""
    grid = torch.linspace(0, 1, _QUANTILES, device=rng.device)
    middle = (grid[1:] + grid[:-1]) / 2
    density = (4 * middle * (1 - middle)) ** (config.concentration - 1)
    cumulative = torch.cat([density.new_zeros(1), density.cumsum(0)]) / density.sum()
    uniform = torch.rand(count, generator=rng, device=rng.device)
    upper = torch.searchsorted(cumulative, uniform).clamp(1, _QUANTILES - 1)
    low, high = cumulative[upper - 1], cumulative[upper]
    fraction = (uniform - low) / (high - low).clamp_min(1e-12)
    unit = grid[upper - 1] + fraction * (grid[upper] - grid[upper - 1])
    return torch.deg2rad(config.low + unit * (config.high - config.low))


def sample_viewpoints(config: ViewpointConfig, count: int, rng: torch.Generator) -> Pose:
    """Draw poses without roll, at the picture's centre and at scale 1 (paper 3.1.3)."""
    azimuth = sample_angles(config.azimuth, count, rng)
    elevation = sample_angles(config.elevation, count, rng)
    if config.mirrored:
        azimuth = azimuth * torch.randint(2, (count,), generator=rng, device=rng.device).mul(2).sub(1)
    return level_pose(azimuth, elevation)


def enlarge_fronts(pose: Pose, front_scale: float) -> Pose:
    """Scale objects by `front_scale` from ahead and behind, not from the side, and in between from between (ours)."""
    return pose._replace(scale=pose.scale * (1 + (front_scale - 1) * pose.azimuth.cos() ** 2))


def sample_lights(config: LightConfig, count: int, rng: torch.Generator) -> Light:
    """Draw directions towards the light uniformly on the upper half of the world's unit sphere."""
    height, turn = torch.rand(2, count, generator=rng, device=rng.device).unbind(0)
    radius = (1 - height**2).sqrt()
    turn = turn * 2 * math.pi
    direction = torch.stack([radius * turn.cos(), height, radius * turn.sin()], 1)
    return Light(direction, torch.full_like(height, config.ambient), torch.full_like(height, config.directional))
