"""Poses and the perspective camera."""

from dataclasses import dataclass
from math import radians, tan
from typing import Annotated, NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from pipeline.ranges import Range

NEAREST_DEPTH = 1e-3
"""Depth in world units below which a point counts as behind the camera."""


@dataclass(frozen=True)
class CameraConfig:
    """Set the camera that looks at the origin from a fixed distance."""

    distance: Annotated[float, Range(3**0.5 / 2, open_low=True)]
    """Distance from the camera to the origin, in world units; it stands outside of the unit cube."""
    field_of_view: Annotated[float, Range(0, 180, open_low=True, open_high=True)]
    """Full opening angle of the square picture, in degrees."""


class Pose(NamedTuple):
    """Hold one viewpoint and one placement in the picture for each object of a batch (paper 3.2.2)."""

    azimuth: Float[Tensor, " B"]
    """Turn of the camera about +y, in radians; 0 looks at the front (+z), pi / 2 stands at +x."""
    elevation: Float[Tensor, " B"]
    """Height angle of the camera above the xz plane, in radians."""
    roll: Float[Tensor, " B"]
    """Counter-clockwise turn of the object in the picture, in radians."""
    center: Float[Tensor, "B 2"]
    """Where the world's origin falls in the picture, in ndc."""
    scale: Float[Tensor, " B"]
    """Factor on the size in the picture; 1 leaves the perspective projection as it is."""

    def at(self, index: Int[Tensor, " K"] | slice) -> "Pose":
        """Return the poses of some of the objects."""
        return Pose(*(values[index] for values in self))


def level_pose(azimuth: Float[Tensor, " B"], elevation: Float[Tensor, " B"]) -> Pose:
    """Return poses without roll, at the picture's centre and at scale 1."""
    zeros = torch.zeros_like(azimuth)
    return Pose(azimuth, elevation, zeros, torch.stack([zeros, zeros], dim=1), torch.ones_like(azimuth))


def pose_to_tensor(pose: Pose) -> Float[Tensor, "B 6"]:
    """Stack a pose as azimuth, elevation, roll, center x, center y, scale."""
    angles = torch.stack((pose.azimuth, pose.elevation, pose.roll), dim=1)
    return torch.cat((angles, pose.center, pose.scale[:, None]), dim=1)


def pose_from_tensor(values: Float[Tensor, "B 6"]) -> Pose:
    """Read a pose from the columns that `pose_to_tensor` writes."""
    return Pose(values[:, 0], values[:, 1], values[:, 2], values[:, 3:5], values[:, 5])


def rotation_from_angles(
    azimuth: Float[Tensor, " B"], elevation: Float[Tensor, " B"], roll: Float[Tensor, " B"]
) -> Float[Tensor, "B 3 3"]:
    """Return the rotations from world to camera axes (x right, y up, z towards the viewer), angles in radians."""
    sin_a, cos_a = azimuth.sin(), azimuth.cos()
    sin_e, cos_e = elevation.sin(), elevation.cos()
    sin_r, cos_r = roll.sin(), roll.cos()
    right = torch.stack((cos_a, torch.zeros_like(cos_a), -sin_a), dim=1)
    up = torch.stack((-sin_a * sin_e, cos_e, -cos_a * sin_e), dim=1)
    backward = torch.stack((sin_a * cos_e, sin_e, cos_a * cos_e), dim=1)
    rolled_right = cos_r[:, None] * right - sin_r[:, None] * up
    rolled_up = sin_r[:, None] * right + cos_r[:, None] * up
    return torch.stack((rolled_right, rolled_up, backward), dim=1)


def project(vertices_world: Float[Tensor, "B V 3"], pose: Pose, camera: CameraConfig) -> Float[Tensor, "B V 3"]:
    """Project vertices to ndc.

    The first two coordinates are x right and y up, in [-1, 1] inside the picture; the third is the depth along the
    viewing axis in world units, positive in front of the camera. Vertices nearer than `NEAREST_DEPTH` are projected
    as if they lay there, so that every value is finite. Gradients flow to the vertices and to the pose.
    """
    rotation = rotation_from_angles(pose.azimuth, pose.elevation, pose.roll)
    # One row a coordinate: rows are contiguous in memory, where columns of three are not.
    rows_camera = rotation @ vertices_world.transpose(1, 2)
    depth = camera.distance - rows_camera[:, 2:]
    focal_length = 1 / tan(radians(camera.field_of_view) / 2)
    xy_ndc = focal_length * rows_camera[:, :2] / depth.clamp(min=NEAREST_DEPTH)
    xy_ndc = pose.scale[:, None, None] * xy_ndc + pose.center[:, :, None]
    return torch.cat((xy_ndc, depth), dim=1).transpose(1, 2)


def place_in_picture(
    vertices: Float[Tensor, "B V 3"],
    azimuth: Float[Tensor, " B"],
    elevation: Float[Tensor, " B"],
    roll: Float[Tensor, " B"],
    center: Float[Tensor, "B 2"],
    extent: Float[Tensor, " B"],
    camera: CameraConfig,
    rim: float = 0.0,
) -> Pose:
    """Choose the pose's centre and scale so that the object's box in the picture has a given middle and longer side.

    Angles are in radians, the middle is in ndc, the extent relative to the picture's side. Each side of the box is the
    mean of the outermost vertices there: `rim` is their share of all, at 0 a single one. Gradients flow to everything
    else.
    """
    plain = Pose(azimuth, elevation, roll, torch.zeros_like(center), torch.ones_like(extent))
    xy_ndc = project(vertices, plain, camera)[..., :2]
    outermost = max(1, round(rim * vertices.shape[1]))
    lower = xy_ndc.topk(outermost, dim=1, largest=False).values.mean(dim=1)
    upper = xy_ndc.topk(outermost, dim=1).values.mean(dim=1)
    scale = 2 * extent / (upper - lower).amax(dim=1)
    return plain._replace(center=center - scale[:, None] * (lower + upper) / 2, scale=scale)


def fill_picture(vertices: Float[Tensor, "B V 3"], pose: Pose, camera: CameraConfig) -> Pose:
    """Move poses so that the longer side of each object's box is the picture's side and the box is in its middle."""
    center, extent = torch.zeros_like(pose.center), torch.ones_like(pose.scale)
    return place_in_picture(vertices, pose.azimuth, pose.elevation, pose.roll, center, extent, camera)
