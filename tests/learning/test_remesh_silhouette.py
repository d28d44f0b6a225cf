from dataclasses import replace

import pytest
import torch

from pipeline.errors import MeshError
from pipeline.geometry.camera import CameraConfig
from pipeline.geometry.icosphere import icosphere
from pipeline.geometry.mapped_mesh import MappedMesh
from pipeline.geometry.mesh_quality import area_variation, measure_remeshing
from pipeline.geometry.symmetry import mirror_index, reflect
from pipeline.geometry.topology import polygon_areas
from pipeline.geometry.voxels import voxelize
from pipeline.rendering.renderer import RendererConfig
from pipeline.training.remesh_silhouette import SilhouetteConfig, remesh_by_silhouettes, silhouettes, views_all_around
from tests.deformed_spheres import deformed_sphere

RENDERER = RendererConfig(CameraConfig(distance=2.7, field_of_view=30.0), size=48, supersampling=1)
CONFIG = SilhouetteConfig(
    subdivisions=2,
    iterations=80,
    learning_rate=0.05,
    stiffness=20.0,
    views=12,
    area_variance_weight=0.003,
    area_weight=0.003,
    renderer=RENDERER,
)


def test_sphere_becomes_a_car_of_even_polygons() -> None:
    original = MappedMesh(*deformed_sphere("car"))
    fitted = remesh_by_silhouettes(original, CONFIG)
    voxels = [voxelize(mesh.vertices[None], mesh.faces, 32) for mesh in (original, fitted)]
    assert (voxels[0] & voxels[1]).sum() / (voxels[0] | voxels[1]).sum() > 0.9
    measured = measure_remeshing(original, fitted)
    assert measured["area_variation_after"] < 0.35 < measured["area_variation_before"]
    assert measured["map_flipped_faces"] == 0
    mirror = mirror_index(fitted.directions)
    assert torch.equal(fitted.vertices[mirror], reflect(fitted.vertices))


def test_surfaces_are_kept_small_where_their_area_costs() -> None:
    original = MappedMesh(*deformed_sphere("car", 2))
    config = replace(CONFIG, iterations=3, views=2, renderer=replace(RENDERER, size=16))
    free, dear = (
        polygon_areas(mesh.vertices, mesh.faces).sum()
        for mesh in (remesh_by_silhouettes(original, replace(config, area_weight=weight)) for weight in (0.0, 10.0))
    )
    assert dear < 0.95 * free


def test_a_remeshing_that_diverges_is_an_error() -> None:
    with pytest.raises(MeshError, match="vertices that are not finite numbers"):
        remesh_by_silhouettes(MappedMesh(*deformed_sphere("car")), replace(CONFIG, iterations=3, learning_rate=1e30))


def test_views_lie_all_around() -> None:
    poses = views_all_around(50)
    towards_camera = torch.stack(
        [
            poses.azimuth.sin() * poses.elevation.cos(),
            poses.elevation.sin(),
            poses.azimuth.cos() * poses.elevation.cos(),
        ],
        dim=1,
    )
    assert towards_camera.mean(dim=0).norm() < 0.05
    torch.testing.assert_close(towards_camera.T @ towards_camera / 50, torch.eye(3) / 3, atol=0.03, rtol=0)


def test_silhouette_of_a_sphere_is_its_disk() -> None:
    vertices, faces = icosphere(4)
    rendered = silhouettes(vertices / 2, faces, views_all_around(3), RENDERER)
    # Seen from 2.7 the sphere of radius 1/2 spans arcsin(0.5 / 2.7), the picture 15 degrees to each side.
    radius = torch.tensor(0.5 / 2.7).asin().tan() / torch.tensor(15.0).deg2rad().tan()
    torch.testing.assert_close(rendered.mean(dim=(1, 2)), (torch.pi * radius**2 / 4).expand(3), atol=0.01, rtol=0)


def test_polygons_become_more_even_where_their_variance_costs() -> None:
    original = MappedMesh(*deformed_sphere("car", 2))
    config = replace(CONFIG, iterations=20, views=2, area_weight=0.0, renderer=replace(RENDERER, size=16))
    free, dear = (
        area_variation(remesh_by_silhouettes(original, replace(config, area_variance_weight=weight)))
        for weight in (0.0, 0.1)
    )
    assert dear < 0.8 * free


def test_the_fit_starts_from_the_ellipsoid_of_the_box() -> None:
    vertices, faces, directions = deformed_sphere("car", 2)
    still = remesh_by_silhouettes(
        MappedMesh(vertices, faces, directions), replace(CONFIG, iterations=1, learning_rate=1e-9)
    )
    lower, upper = vertices.amin(dim=0), vertices.amax(dim=0)
    expected = still.directions * (upper - lower) / 2 + (lower + upper) / 2
    torch.testing.assert_close(still.vertices, expected, atol=1e-4, rtol=0)
