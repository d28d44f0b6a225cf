"""Take toybox photographs: projection, light, surroundings, and the faults of small pictures."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from pipeline.datasets.toybox.development import develop, shrink
from pipeline.datasets.toybox.lighting import choose_lighting, shade_faces
from pipeline.datasets.toybox.model import Specimens
from pipeline.datasets.toybox.scenery import Footprint, Rays, paint_scenery
from pipeline.datasets.toybox.surroundings import Setting, choose_places
from pipeline.datasets.toybox.views import ViewRange, choose_poses
from pipeline.datasets.truth import GroundTruth
from pipeline.errors import ConfigError
from pipeline.geometry.camera import CameraConfig, Pose, project, rotation_from_angles
from pipeline.geometry.normalize import fit_unit_cube
from pipeline.ranges import Count
from pipeline.rendering.rasterize import rasterize

SCENERY_SUPERSAMPLING = 2


@dataclass(frozen=True)
class PhotographConfig:
    """Size of the photographs and the camera their ground truth refers to."""

    size: Count
    """Pixels a side."""
    supersampling: int
    """Rays a pixel along each axis for the object; even."""
    camera: CameraConfig
    """The reference camera."""

    def __post_init__(self) -> None:
        """Raise ConfigError if the object's rays cannot be shared out among the scenery's."""
        if self.supersampling < 1 or self.supersampling % SCENERY_SUPERSAMPLING:
            raise ConfigError(f"supersampling is {self.supersampling}; expected a positive even number")


def photograph(
    specimens: Specimens, viewpoints: ViewRange, setting: Setting, config: PhotographConfig, rng: np.random.Generator
) -> tuple[UInt8[np.ndarray, "B H W 3"], GroundTruth]:
    """Photograph every specimen once, each in its own light and place."""
    vertices = fit_unit_cube(torch.from_numpy(specimens.solid.vertices).float())
    pose = choose_poses(viewpoints, vertices, config.camera, rng)
    place = choose_places(setting, pose.elevation.numpy(), rng)
    lighting = choose_lighting(place, rng)
    rotation = rotation_from_angles(pose.azimuth, pose.elevation, pose.roll).numpy()
    seen, cover = _draw(vertices, specimens, pose, shade_faces(vertices, specimens, rotation[:, 2], lighting), config)
    rays = _rays(pose, rotation, config)
    scenery = paint_scenery(place, rays, _footprint(vertices.numpy()), lighting.shadow, rng)
    radiance = seen + scenery * lighting.on_ground[:, None, None, None] * (1 - cover)
    images = develop(shrink(radiance, SCENERY_SUPERSAMPLING), rng)
    masks = (shrink(cover, SCENERY_SUPERSAMPLING)[..., 0] >= 0.5).astype(np.uint8)
    truth = GroundTruth(
        azimuth=pose.azimuth.numpy(),
        elevation=pose.elevation.numpy(),
        roll=pose.roll.numpy(),
        center=pose.center.numpy(),
        scale=pose.scale.numpy(),
        masks=masks,
        vertices=vertices.numpy(),
        faces=specimens.solid.faces,
    )
    return images, truth


def _draw(
    vertices: Float[Tensor, "B V 3"],
    specimens: Specimens,
    pose: Pose,
    face_colors: Float[np.ndarray, "B F 3"],
    config: PhotographConfig,
) -> tuple[Float[np.ndarray, "B H W 3"], Float[np.ndarray, "B H W 1"]]:
    """Return the light from the object, black elsewhere, and its share of each of the scenery's pixels."""
    vertices_ndc = project(vertices, pose, config.camera)
    faces = torch.from_numpy(specimens.solid.faces)
    index = rasterize(vertices_ndc, faces, config.size * config.supersampling).face_index.numpy()
    inside = (index >= 0)[..., None]
    seen = face_colors[np.arange(len(index))[:, None, None], index] * inside
    reduction = config.supersampling // SCENERY_SUPERSAMPLING
    return shrink(seen, reduction), shrink(inside.astype(np.float32), reduction)


def _rays(pose: Pose, rotation: Float[np.ndarray, "B 3 3"], config: PhotographConfig) -> Rays:
    """Return the lines of sight through the pixels: the inverse of the projection."""
    size = config.size * SCENERY_SUPERSAMPLING
    steps = (np.arange(size, dtype=np.float32) + 0.5) / size * 2 - 1
    x, y = np.meshgrid(steps, -steps)
    offset = np.stack([x, y], axis=-1) - pose.center.numpy()[:, None, None]
    plane = offset / pose.scale.numpy()[:, None, None, None] * np.tan(np.deg2rad(config.camera.field_of_view / 2))
    directions = np.concatenate([plane, np.full((*plane.shape[:3], 1), -1.0)], axis=-1).astype(np.float32)
    return Rays(rotation[:, 2] * config.camera.distance, np.einsum("bhwi,bij->bhwj", directions, rotation))


def _footprint(vertices: Float[np.ndarray, "B V 3"]) -> Footprint:
    reach = np.abs(vertices).max(axis=1)
    return Footprint(half_width=reach[:, 0], half_depth=reach[:, 2], bottom=vertices[..., 1].min(axis=1))
