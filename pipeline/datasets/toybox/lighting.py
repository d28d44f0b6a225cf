"""Sun, sky and reflections on toybox objects."""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

from pipeline.datasets.toybox.model import Specimens
from pipeline.datasets.toybox.noise import sample
from pipeline.datasets.toybox.surroundings import Place
from pipeline.rendering.lighting import vertex_normals


class Lighting(NamedTuple):
    """The light of each picture, as radiance that a white surface reflects."""

    sun: Float[np.ndarray, "B 3"]
    """Unit vector towards the sun, world space."""
    strength: Float[np.ndarray, " B"]
    """Light of the sun."""
    ambient: Float[np.ndarray, " B"]
    """Light of the sky."""
    sky: Float[np.ndarray, "B 3"]
    """Colour that surfaces mirror above the horizon."""
    floor: Float[np.ndarray, "B 3"]
    """Colour that surfaces mirror below the horizon."""
    texture: Float[np.ndarray, "B 128 128"]
    """Unevenness of what surfaces mirror."""

    @property
    def on_ground(self) -> Float[np.ndarray, " B"]:
        """Light that falls on level ground."""
        return (self.ambient * 1.2 + self.strength * self.sun[:, 1]).astype(np.float32)

    @property
    def shadow(self) -> Float[np.ndarray, " B"]:
        """Share of that light which an object keeps away."""
        return (0.35 + 0.55 * self.strength * self.sun[:, 1] / self.on_ground).astype(np.float32)


def choose_lighting(place: Place, rng: np.random.Generator) -> Lighting:
    """Draw sunshine or overcast from any side."""
    count = len(place.sky)
    azimuth, height = rng.uniform(0, 2 * np.pi, count), rng.uniform(0.35, 1.4, count)
    sun = np.stack([np.sin(azimuth) * np.cos(height), np.sin(height), np.cos(azimuth) * np.cos(height)], axis=-1)
    studio = (place.studio | place.indoors)[:, None]
    return Lighting(
        sun=sun,
        strength=rng.uniform(0.0, 1.4, count),
        ambient=rng.uniform(0.3, 0.5, count),
        sky=np.where(studio, place.wall, place.sky),
        floor=place.ground * 0.5,
        texture=place.texture,
    )


def shade_faces(
    vertices: Float[Tensor, "B V 3"],
    specimens: Specimens,
    toward_camera: Float[np.ndarray, "B 3"],
    lighting: Lighting,
) -> Float[np.ndarray, "B F 3"]:
    """Return the radiance of every face: diffuse light of sun and sky, and a mirror image of sky, floor and sun."""
    normals = _normals(vertices, torch.from_numpy(specimens.solid.faces))
    lambert = np.maximum(np.einsum("bfc,bc->bf", normals, lighting.sun), 0)
    light = lighting.ambient[:, None] * (0.75 + 0.5 * normals[..., 1]) + lighting.strength[:, None] * lambert
    facing = np.einsum("bfc,bc->bf", normals, toward_camera)
    mirror = 2 * facing[..., None] * normals - toward_camera[:, None]
    above = np.clip(mirror[..., 1:2] * 3 + 0.4, 0, 1)
    surroundings = lighting.sky[:, None] * above + lighting.floor[:, None] * (1 - above)
    heading = np.arctan2(mirror[..., 0], mirror[..., 2]) / (2 * np.pi)
    streaks = sample(lighting.texture, heading[..., None], mirror[..., 1:2] / 2)
    surroundings = surroundings * np.exp(0.6 * streaks)
    shine = np.maximum(np.einsum("bfc,bc->bf", mirror, lighting.sun), 0) ** 30 * lighting.strength[:, None] * 2
    materials = specimens.solid.materials
    gloss = (specimens.gloss[materials] * (0.6 + 0.8 * (1 - np.clip(facing, 0, 1)) ** 3))[..., None]
    diffuse = specimens.palette[:, materials] * light[..., None]
    return (diffuse * (1 - gloss / 2) + gloss * (surroundings + shine[..., None])).astype(np.float32)


def _normals(vertices: Float[Tensor, "B V 3"], faces: Int[Tensor, "F 3"]) -> Float[np.ndarray, "B F 3"]:
    """Return unit normals half way between those of the flat faces and those of a smooth surface."""
    first, second, third = vertices[:, faces].unbind(2)
    flat = functional.normalize(torch.linalg.cross(second - first, third - first), dim=-1)
    smooth = functional.normalize(vertex_normals(vertices, faces)[:, faces].mean(dim=2), dim=-1)
    return functional.normalize(flat + smooth, dim=-1).numpy()
