"""The renderer once more in plain loops and double precision: slow and obvious, the oracle of the tests."""

from collections.abc import Iterator
from itertools import product
from math import atan2, ceil, floor, hypot, pi

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from pipeline.geometry.camera import NEAREST_DEPTH, Pose, pose_from_tensor, pose_to_tensor, project
from pipeline.rendering.lighting import Light
from pipeline.rendering.renderer import Mesh, RendererConfig, Rendering


def render(
    mesh: Mesh,
    texture_maps: Float[Tensor, "B 3 T T"],
    pose: Pose,
    backgrounds: Float[Tensor, "B 3 H W"] | None,
    light: Light | None,
    config: RendererConfig,
) -> Rendering:
    """Render what `renderer.render` renders, in float64 and without gradients."""
    pose = pose_from_tensor(pose_to_tensor(pose).double())
    vertices_ndc = project(mesh.vertices.double(), pose, config.camera).numpy()
    faces, directions = mesh.faces.numpy(), mesh.directions.double().numpy()
    sample_count = config.size * config.supersampling
    layers = []
    for index, vertices in enumerate(vertices_ndc):
        reflected = np.ones(len(vertices))
        if light is not None:
            reflected = shade(mesh.vertices[index].double().numpy(), faces, Light(*(part[index] for part in light)))
        fragments = rasterize(vertices, faces, sample_count)
        colors = np.zeros((sample_count, sample_count, 4))
        for row, column, face, weights in covered_pixels(*fragments[:2]):
            color = look_up(texture_maps[index].double().numpy(), weights @ directions[faces[face]])
            colors[row, column, :3] = color * (weights @ reflected[faces[face]])
            colors[row, column, 3] = 1
        colors = antialias(colors, fragments[2], vertices, faces)
        blocks = colors.reshape(config.size, config.supersampling, config.size, config.supersampling, 4)
        layers.append(torch.from_numpy(blocks.mean(axis=(1, 3))).movedim(-1, 0))
    images, silhouettes = torch.stack(layers)[:, :3], torch.stack(layers)[:, 3]
    if backgrounds is not None:
        images = images + (1 - silhouettes[:, None]) * backgrounds.double()
    return Rendering(images, silhouettes)


def covered_pixels(
    face_index: Int[np.ndarray, "H W"], barycentric: Float[np.ndarray, "H W 3"]
) -> Iterator[tuple[int, int, int, Float[np.ndarray, "3"]]]:
    """Go over row, column, face and barycentric coordinates of the pixels that show the object."""
    for row, column in np.argwhere(face_index >= 0):
        yield int(row), int(column), int(face_index[row, column]), barycentric[row, column]


def pixel_coordinates(vertices_ndc: Float[np.ndarray, "V 3"], size: int) -> Float[np.ndarray, "V 2"]:
    """Return columns and rows of vertices; the first pixel's centre has 0."""
    return np.stack((size / 2 * (1 + vertices_ndc[:, 0]) - 0.5, size / 2 * (1 - vertices_ndc[:, 1]) - 0.5), axis=1)


def rasterize(
    vertices_ndc: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], size: int
) -> tuple[Int[np.ndarray, "H W"], Float[np.ndarray, "H W 3"], Float[np.ndarray, "H W"]]:
    """Return face index, perspective-correct barycentric coordinates and depth (infinite in the background)."""
    points = pixel_coordinates(vertices_ndc, size)
    face_index = np.full((size, size), -1, np.int64)
    barycentric, depth = np.zeros((size, size, 3)), np.full((size, size), np.inf)
    for face, corners in enumerate(faces):
        corner_depth = vertices_ndc[corners, 2]
        equations = np.stack((*points[corners].T, np.ones(3)))
        if corner_depth.min() < NEAREST_DEPTH or np.linalg.det(equations) == 0:
            continue
        solve = np.linalg.inv(equations)
        first = [max(ceil(low), 0) for low in points[corners].min(axis=0)]
        last = [min(floor(high), size - 1) for high in points[corners].max(axis=0)]
        for column, row in product(range(first[0], last[0] + 1), range(first[1], last[1] + 1)):
            weights = solve @ (column, row, 1)
            pixel_depth = 1 / (weights / corner_depth).sum() if weights.min() >= 0 else np.inf
            if pixel_depth < depth[row, column]:
                face_index[row, column], depth[row, column] = face, pixel_depth
                barycentric[row, column] = weights / corner_depth * pixel_depth
    return face_index, barycentric, depth


def look_up(texture: Float[np.ndarray, "3 T T"], direction: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Return the bilinear look-up of an equirectangular map."""
    size = texture.shape[-1]
    x, y, z = direction
    column = (0.5 + atan2(x, z) / (2 * pi)) * size - 0.5
    row = (0.5 - atan2(y, hypot(x, z)) / pi) * size - 0.5
    color = np.zeros(3)
    for i, j in product((floor(row), floor(row) + 1), (floor(column), floor(column) + 1)):
        texel = texture[:, min(max(i, 0), size - 1), j % size]
        color += (1 - abs(row - i)) * (1 - abs(column - j)) * texel
    return color


def shade(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], light: Light) -> Float[np.ndarray, " V"]:
    """Return the light that each vertex reflects."""
    normals = np.zeros_like(vertices)
    for corners in faces:
        first, second, third = vertices[corners]
        normals[corners] += np.cross(second - first, third - first)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    cosine = normals @ light.direction.double().numpy()
    return float(light.ambient) + float(light.directional) * np.maximum(cosine, 0)


def silhouette_edges(points: Float[np.ndarray, "V 2"], faces: Int[np.ndarray, "F 3"]) -> Int[np.ndarray, "E 2"]:
    """Return the edges between a face seen from outside and one from inside, the object to the left of each."""
    outside, inside = set(), set()
    for corners in faces.tolist():
        (ax, ay), (bx, by) = points[corners[1]] - points[corners[0]], points[corners[2]] - points[corners[0]]
        seen_from_outside = ax * by < ay * bx  # rows grow downwards
        (outside if seen_from_outside else inside).update(zip(corners, corners[1:] + corners[:1], strict=True))
    # A neighbour that is turned like the face itself traverses their edge the other way round.
    return np.array([edge for edge in outside if edge[::-1] not in outside], np.int64).reshape(-1, 2)


def antialias(
    colors: Float[np.ndarray, "H W C"],
    depth: Float[np.ndarray, "H W"],
    vertices_ndc: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
) -> Float[np.ndarray, "H W C"]:
    """Blend every two neighbouring pixels by how far the object reaches from the one into the other."""
    points = pixel_coordinates(vertices_ndc, len(depth))
    edges = silhouette_edges(points, faces)
    edges = edges[(vertices_ndc[edges, 2] >= NEAREST_DEPTH).all(axis=1)]
    edge_depth, edge_points = vertices_ndc[edges, 2], points[edges]
    sideways = abs(np.ptp(edge_points[..., 0], axis=1)) > abs(np.ptp(edge_points[..., 1], axis=1))
    blends = []
    for axis, (row, column) in product((0, 1), np.ndindex(depth.shape)):
        first, second = (row, column), (row + axis, column + 1 - axis)
        if max(second) < len(depth) and depth[first] != depth[second]:
            inside, outside = (first, second) if depth[first] < depth[second] else (second, first)
            chosen = sideways == bool(axis)
            excess = reach(inside, outside, edge_points[chosen], edge_depth[chosen], depth)
            if excess is not None:
                target, source = (outside, inside) if excess > 0 else (inside, outside)
                blends.append((target, source, abs(excess)))
    taken = np.zeros(depth.shape)
    for target, _, share in blends:
        taken[target] += share
    result = colors.copy()
    for target, source, share in blends:
        result[target] += share / max(taken[target], 1) * (colors[source] - colors[target])
    return result


def reach(
    inside: tuple[int, int],
    outside: tuple[int, int],
    edge_points: Float[np.ndarray, "E 2 2"],
    edge_depth: Float[np.ndarray, "E 2"],
    depth: Float[np.ndarray, "H W"],
) -> float | None:
    """Return how far the object reaches over the border of two pixels, None where no silhouette passes there.

    Edges that are longer across the border than along it do not count: they cut the other two neighbours.
    """
    (row, column), outwards = inside, np.subtract(outside, inside)
    across_axis = 1 if outwards[0] else 0  # of points, which are columns and rows
    step = outwards[1 - across_axis]
    line, pixel = (column, row) if across_axis else (row, column)
    across, along = edge_points[..., across_axis], edge_points[..., 1 - across_axis]
    direction = along[:, 1] - along[:, 0]
    meets_line = (along.min(axis=1) <= line) & (line < along.max(axis=1))
    # With the object to the left, rows growing downwards: it lies below an edge to the left, left of one upwards.
    object_first = direction > 0 if across_axis else direction < 0
    candidates = meets_line & (object_first == (step > 0))
    portion = (line - along[candidates, 0]) / direction[candidates]
    crossing = across[candidates, 0] + portion * (across[candidates, 1] - across[candidates, 0])
    crossing_depth = 1 / ((1 - portion) / edge_depth[candidates, 0] + portion / edge_depth[candidates, 1])
    distance = (crossing - pixel) * step
    reached = distance[(distance >= 0) & (distance < 1) & (crossing_depth < depth[outside])]
    return float(reached.max()) - 0.5 if len(reached) else None
