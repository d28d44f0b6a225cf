"""The six parameters of a pose in the form in which they are regressed and explored (paper section 3.2.2)."""

import math
from dataclasses import dataclass, fields
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn

from pipeline.device import constant
from pipeline.errors import ConfigError
from pipeline.geometry.camera import CameraConfig, Pose, place_in_picture
from pipeline.ranges import Elevation, Positive

POSE_COORDINATES = 7
Framing = Literal["free", "box"]
"""Whether objects may stand anywhere in the picture, or fill it because photographs were cut to their boxes."""


@dataclass(frozen=True)
class PoseRange:
    """Where the poses of a category lie: bounds of what is predicted and of what is explored."""

    elevation: tuple[Elevation, Elevation]
    """Degrees."""
    roll: tuple[float, float]
    """Degrees, as far to either side: poses of mirror images are learned too."""
    center: tuple[float, float]
    """Of the middle of the object's box in the picture, along x and along y, in ndc, as far to either side."""
    extent: tuple[Positive, Positive]
    """Longer side of the object's box over the picture's side; 1 fills the picture."""

    def __post_init__(self) -> None:
        """Raise ConfigError for a range that ends below its start, and for a lopsided one of what is mirrored."""
        for field in fields(self):
            lowest, highest = getattr(self, field.name)
            if lowest > highest:
                raise ConfigError(f"{field.name} is [{lowest}, {highest}]; expected the lower bound first")
            if field.name in ("roll", "center") and lowest != -highest:
                raise ConfigError(f"{field.name} is [{lowest}, {highest}]; expected as far to either side")


class PoseCoordinates(nn.Module):
    """Turn the seven coordinates that networks regress into poses.

    The coordinates are cosine and sine of the azimuth, which has no seam, then elevation, roll, the middle of the
    object's box in the picture (x, y) and the logarithm of the box's longer side, mapped from their ranges to [-1, 1].
    Photographers fill the frame from every side, so the box says where and how large an object is without regard to its
    shape and its azimuth; the centre and scale of a `Pose` follow from it.
    """

    middle: Float[Tensor, " 5"]
    reach: Float[Tensor, " 5"]

    def __init__(self, pose_range: PoseRange, camera: CameraConfig, rim: float, fills_picture: bool) -> None:
        """Take the ranges and the share of vertices that make up each side of a box.

        With `fills_picture` the object's outermost vertices reach the picture's sides, whatever the last three
        coordinates say: photographs are cut that way.
        """
        super().__init__()
        self.camera, self.rim, self.fills_picture = camera, rim, fills_picture
        bounds = torch.tensor(
            [
                [math.radians(bound) for bound in pose_range.elevation],
                [math.radians(bound) for bound in pose_range.roll],
                pose_range.center,
                pose_range.center,
                [math.log(bound) for bound in pose_range.extent],
            ]
        )
        self.register_buffer("middle", bounds.mean(dim=1), persistent=False)
        self.register_buffer("reach", (bounds[:, 1] - bounds[:, 0]) / 2, persistent=False)

    def forward(self, coordinates: Float[Tensor, "B 7"], vertices: Float[Tensor, "B V 3"]) -> Pose:
        """Return the poses that put the shapes where the coordinates say. Gradients flow to both."""
        elevation = self.middle[0] + self.reach[0] * coordinates[:, 2]
        azimuth = torch.atan2(coordinates[:, 1], coordinates[:, 0])
        roll, rim = self.roll(coordinates), 0.0 if self.fills_picture else self.rim
        return place_in_picture(vertices, azimuth, elevation, roll, *self.box(coordinates), self.camera, rim)

    def roll(self, coordinates: Float[Tensor, "B 7"]) -> Float[Tensor, " B"]:
        """Return the rolls in radians."""
        return self.middle[1] + self.reach[1] * coordinates[:, 3]

    def box(self, coordinates: Float[Tensor, "B 7"]) -> tuple[Float[Tensor, "B 2"], Float[Tensor, " B"]]:
        """Return the middle of the object's box in the picture in ndc, and its longer side over the picture's."""
        x, y, log_extent = (self.middle[2:] + self.reach[2:] * coordinates[:, 4:]).unbind(1)
        center, extent = torch.stack([x, y], 1), log_extent.exp()
        if self.fills_picture:
            return torch.zeros_like(center), torch.ones_like(extent)
        return center, extent

    def draw(self, count: int, rng: torch.Generator) -> Float[Tensor, "B 7"]:
        """Draw coordinates uniformly: azimuth over the circle, others over their ranges; 0 where a range is a point."""
        uniform = 2 * torch.rand(count, POSE_COORDINATES - 1, generator=rng, device=rng.device) - 1
        turn = math.pi * uniform[:, :1]
        return torch.cat([turn.cos(), turn.sin(), uniform[:, 1:] * (self.reach > 0)], 1)

    def mirror(self, coordinates: Float[Tensor, "... 7"]) -> Float[Tensor, "... 7"]:
        """Return the coordinates of mirror-symmetric objects in the pictures' left-right mirror images."""
        turn, others = coordinates[..., :2], self.middle + self.reach * coordinates[..., 2:]
        turn = turn * constant((1.0, -1.0), turn)
        others = others * constant((1.0, -1.0, -1.0, 1.0, 1.0), others)  # roll and x change their signs
        return torch.cat([turn, torch.where(self.reach > 0, (others - self.middle) / self.reach, 0.0)], -1)

    def clamp(self, coordinates: Float[Tensor, "... 7"]) -> Float[Tensor, "... 7"]:
        """Return the nearest coordinates within the ranges, with the azimuth's pair on the unit circle."""
        turn = nn.functional.normalize(coordinates[..., :2], dim=-1, eps=1e-6)
        return torch.cat([turn, coordinates[..., 2:].clamp(-1, 1) * (self.reach > 0)], -1)
