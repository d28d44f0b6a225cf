"""How even the polygons of a mesh are, how near it is to another one and how true its map to the sphere."""

import torch

from pipeline.geometry.mapped_mesh import MappedMesh
from pipeline.geometry.meshlab import one_sided_distance
from pipeline.geometry.sphere_map import area_distortion, area_ratios
from pipeline.geometry.topology import polygon_areas


def measure_remeshing(original: MappedMesh, remeshed: MappedMesh) -> dict[str, float]:
    """Compare a mesh before and after remeshing.

    `area_variation_*`: standard deviation over mean of polygon areas. `hausdorff`, `mean_distance`: see
    `surface_distance`. `map_*`: see `measure_map`, for the new mesh.
    """
    return {
        "faces_after": len(remeshed.faces),
        "faces_before": len(original.faces),
        "area_variation_before": area_variation(original),
        "area_variation_after": area_variation(remeshed),
        **surface_distance(original, remeshed),
        **measure_map(remeshed),
    }


def area_variation(mesh: MappedMesh) -> float:
    """Divide the standard deviation of polygon areas by their mean."""
    areas = polygon_areas(mesh.vertices.double(), mesh.faces)
    return (areas.std(correction=0) / areas.mean()).item()


def measure_map(mesh: MappedMesh) -> dict[str, float]:
    """Measure the map to the sphere.

    A polygon's distortion is the factor, at least 1, between its share of the sphere and its share of the surface.
    `map_area_distortion` is its mean over the surface, `map_area_distortion_max` its maximum;
    `map_flipped_faces` counts spherical triangles that are turned over or empty.
    """
    vertices, directions = mesh.vertices.double(), mesh.directions.double()
    ratios = area_ratios(vertices, mesh.faces, directions)
    return {
        "map_area_distortion": area_distortion(vertices, mesh.faces, directions),
        "map_area_distortion_max": torch.maximum(ratios, 1 / ratios).max().item(),
        "map_flipped_faces": int((ratios <= 0).sum()),
    }


def surface_distance(first: MappedMesh, second: MappedMesh) -> dict[str, float]:
    """Measure how far two surfaces are apart, relative to the first one's diagonal.

    `hausdorff` is the largest distance from either surface to the other; `mean_distance` the larger one of the two mean
    distances.
    """
    there = one_sided_distance(first[:2], second[:2])
    back = one_sided_distance(second[:2], first[:2])
    diagonal = (first.vertices.amax(dim=0) - first.vertices.amin(dim=0)).norm().item()
    return {
        "hausdorff": max(there["max"], back["max"]) / diagonal,
        "mean_distance": max(there["mean"], back["mean"]) / diagonal,
    }
