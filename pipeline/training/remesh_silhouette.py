"""Remeshing by silhouettes, the paper's own way (paper 3.1.7)."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional
from tqdm import trange

from pipeline.geometry.camera import Pose, level_pose, project
from pipeline.geometry.compliance import compliance_matrix
from pipeline.geometry.icosphere import icosphere
from pipeline.geometry.mapped_mesh import MappedMesh, check_surface
from pipeline.geometry.symmetry import is_symmetric, mirror_index, symmetrize
from pipeline.geometry.topology import laplacian_matrix, polygon_areas
from pipeline.ranges import Count, Natural, NonNegative, Positive
from pipeline.rendering.antialias import antialias
from pipeline.rendering.rasterize import rasterize
from pipeline.rendering.renderer import RendererConfig

GOLDEN_ANGLE = math.pi * (3 - 5**0.5)


@dataclass(frozen=True)
class SilhouetteConfig:
    """Settings of the fit."""

    subdivisions: Natural
    """Of the icosphere that is deformed: 3 gives 1280 faces."""
    iterations: Count
    learning_rate: Positive
    """Of Adam."""
    stiffness: NonNegative
    """How far a step at one vertex carries its neighbours along; 0 lets single vertices grow into spikes."""
    views: Count
    """Silhouettes compared in each iteration, seen from all around."""
    area_variance_weight: NonNegative
    """Weight of the squared area variation against the mean squared difference of the silhouettes."""
    area_weight: NonNegative
    """Weight of the whole area of the surface."""
    renderer: RendererConfig


def remesh_by_silhouettes(original: MappedMesh, config: SilhouetteConfig) -> MappedMesh:
    """Fit an icosphere to the silhouettes of a mesh while minimising the variance of polygon areas and the whole area.

    The sphere's own vertices are the directions, so polygons of even size are a map of even areas. What no silhouette
    shows, such as a dent, is filled. Steps are taken in the coordinates (I + stiffness L) v, in which they are smooth
    (Nicolet, Jacobson & Jakob 2021). A mirror-symmetric shape stays so. Raises MeshError when the input is not finite,
    closed and of genus 0, or has no extent.
    """
    check_surface(original)
    directions, faces = icosphere(config.subdivisions)
    mirror = mirror_index(directions)
    symmetric = is_symmetric(original.vertices, mirror_index(original.directions))
    poses = views_all_around(config.views)
    targets = silhouettes(original.vertices, original.faces, poses, config.renderer)
    lower, upper = original.vertices.amin(dim=0), original.vertices.amax(dim=0)
    ellipsoid = directions * (upper - lower) / 2 + (lower + upper) / 2
    compliance = compliance_matrix(faces, config.stiffness)
    free = (ellipsoid + config.stiffness * laplacian_matrix(faces) @ ellipsoid).requires_grad_()
    optimizer = torch.optim.Adam([free], config.learning_rate)

    def shape() -> Float[Tensor, "V 3"]:
        return symmetrize(compliance @ free, mirror) if symmetric else compliance @ free

    for _ in trange(config.iterations, desc="remesh", disable=None):
        vertices = shape()
        areas = polygon_areas(vertices, faces)
        loss = (silhouettes(vertices, faces, poses, config.renderer) - targets).square().mean()
        loss = loss + config.area_variance_weight * areas.var() / areas.mean().square()
        loss = loss + config.area_weight * areas.sum()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    result = MappedMesh(shape().detach(), faces, directions)
    check_surface(result)
    return result


def views_all_around(count: int) -> Pose:
    """Spread viewpoints evenly over the sphere on a spiral of golden angles."""
    step = torch.arange(count)
    elevation = torch.asin(1 - (2 * step + 1) / count)
    return level_pose(step * GOLDEN_ANGLE, elevation)


def silhouettes(
    vertices: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"], poses: Pose, config: RendererConfig
) -> Float[Tensor, "B H W"]:
    """Render the part of each pixel that one shape covers, from several poses. Gradients flow to `vertices`."""
    vertices_ndc = project(vertices.expand(len(poses.scale), -1, -1), poses, config.camera)
    fragments = rasterize(vertices_ndc, faces, config.size * config.supersampling)
    covered = (fragments.face_index >= 0).to(vertices.dtype)[:, None]
    return functional.avg_pool2d(antialias(covered, fragments, vertices_ndc, faces), config.supersampling)[:, 0]
