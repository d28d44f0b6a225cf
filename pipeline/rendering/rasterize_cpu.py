"""The compiled rasteriser for the CPU, parallel over pictures; importing this module imports numba."""

from typing import no_type_check

import numpy as np
from jaxtyping import Float, Int

from pipeline.geometry.camera import NEAREST_DEPTH
from pipeline.rendering.compiled import njit, prange

LANES = 16
"""Columns that are drawn at once; fewer of them the compiler does not turn into vectors
(docs/decisions/rendering.md)."""


@njit()
@no_type_check
def pixel_points(vertices_ndc: Float[np.ndarray, "V 3"], size: int) -> Float[np.ndarray, "V 3"]:
    """Return column, row (0 at the first pixel's centre) and inverse depth, which is 0 behind the camera."""
    points = np.zeros(vertices_ndc.shape)
    for vertex in range(len(points)):
        points[vertex, 0] = 0.5 * size * (1.0 + vertices_ndc[vertex, 0]) - 0.5
        points[vertex, 1] = 0.5 * size * (1.0 - vertices_ndc[vertex, 1]) - 0.5
        depth = vertices_ndc[vertex, 2]
        points[vertex, 2] = 1.0 / depth if depth >= NEAREST_DEPTH else 0.0
    return points


@njit()
@no_type_check
def draw_face(
    face: int,
    x: tuple[float, float, float],
    y: tuple[float, float, float],
    nearness: tuple[float, float, float],
    nearest: Float[np.ndarray, "H W+lanes"],
    face_index: Int[np.ndarray, "H W+lanes"],
) -> None:
    """Draw one face, given in pixels and inverse depths, where nothing nearer has been drawn.

    What is drawn has `LANES` columns beyond the picture, into which the last vector of a row may reach.
    """
    last = len(nearest) - 1.0
    first_row, last_row = max(np.ceil(min(y)), 0.0), min(np.floor(max(y)), last)
    first_column, last_column = max(np.ceil(min(x)), 0.0), min(np.floor(max(x)), last)
    area = (x[1] - x[0]) * (y[2] - y[0]) - (y[1] - y[0]) * (x[2] - x[0])
    # Compared in this way, a corner that is not a number leaves its face out.
    if first_row > last_row or first_column > last_column or not abs(area) > 0.0 or min(nearness) == 0.0:
        return
    turn = 1.0 if area > 0.0 else -1.0
    near0, near1, near2 = nearness[0] / abs(area), nearness[1] / abs(area), nearness[2] / abs(area)
    for row in range(int(first_row), int(last_row) + 1):
        y0, y1, y2 = turn * (y[0] - row), turn * (y[1] - row), turn * (y[2] - row)
        for start in range(int(first_column), int(last_column) + 1, LANES):
            for lane in range(LANES):
                column = start + lane
                x0, x1, x2 = x[0] - column, x[1] - column, x[2] - column
                weight0, weight1, weight2 = x1 * y2 - y1 * x2, x2 * y0 - y2 * x0, x0 * y1 - y0 * x1
                near = weight0 * near0 + weight1 * near1 + weight2 * near2
                # No branches, and unsigned indices, which are not looked at for their sign: all lanes are one vector.
                i, j = np.uintp(row), np.uintp(column)
                before, shown = nearest[i, j], face_index[i, j]
                seen = (min(weight0, weight1, weight2) >= 0.0) & (near > before)
                nearest[i, j] = near if seen else before
                face_index[i, j] = face if seen else shown


@njit()
@no_type_check
def write_pixels(
    points: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    drawn: Int[np.ndarray, "H W+lanes"],
    face_index: Int[np.ndarray, "H W"],
    barycentric: Float[np.ndarray, "H W 3"],
) -> None:
    """Write faces and perspective-correct barycentric coordinates of pixel centres on them, 0 in the background."""
    for row in range(len(face_index)):
        for column in range(len(face_index)):
            face, weights = drawn[row, column], barycentric[row, column]
            face_index[row, column] = face
            if face < 0:
                weights[0], weights[1], weights[2] = 0.0, 0.0, 0.0
            else:
                a, b, c = points[faces[face, 0]], points[faces[face, 1]], points[faces[face, 2]]
                x0, x1, x2 = a[0] - column, b[0] - column, c[0] - column
                y0, y1, y2 = a[1] - row, b[1] - row, c[1] - row
                weight0, weight1, weight2 = x1 * y2 - y1 * x2, x2 * y0 - y2 * x0, x0 * y1 - y0 * x1
                weight0, weight1, weight2 = weight0 * a[2], weight1 * b[2], weight2 * c[2]
                total = weight0 + weight1 + weight2
                weights[0], weights[1], weights[2] = weight0 / total, weight1 / total, weight2 / total


@njit(parallel=True)
@no_type_check
def rasterize(
    vertices_ndc: Float[np.ndarray, "B V 3"], faces: Int[np.ndarray, "F 3"], size: int
) -> tuple[Int[np.ndarray, "B H W"], Float[np.ndarray, "B H W 3"]]:
    """Return the nearest face at every pixel's centre and barycentric coordinates on it, -1 and 0 in the background."""
    batch = len(vertices_ndc)
    # Written picture by picture below, while in the cache: a fifth of the time.
    face_index = np.empty((batch, size, size), np.int64)  # noqa: TID251
    barycentric = np.empty((batch, size, size, 3), vertices_ndc.dtype)  # noqa: TID251
    for picture in prange(batch):
        points, nearest = pixel_points(vertices_ndc[picture], size), np.zeros((size, size + LANES))
        drawn = np.full((size, size + LANES), -1, np.int64)
        for face in range(len(faces)):
            a, b, c = points[faces[face, 0]], points[faces[face, 1]], points[faces[face, 2]]
            x, y, nearness = (a[0], b[0], c[0]), (a[1], b[1], c[1]), (a[2], b[2], c[2])
            draw_face(face, x, y, nearness, nearest, drawn)
        write_pixels(points, faces, drawn, face_index[picture], barycentric[picture])
    return face_index, barycentric


@njit()
@no_type_check
def put(source: Float[np.ndarray, "C H W"], target: Float[np.ndarray, "C H W"]) -> None:
    """Copy an array into another: an assignment would compile the words of its errors too, as slowly as a kernel."""
    for channel in range(source.shape[0]):
        for row in range(source.shape[1]):
            for column in range(source.shape[2]):
                target[channel, row, column] = source[channel, row, column]


@njit()
@no_type_check
def add_vertex_gradient(
    corners: Int[np.ndarray, " 3"],
    center: tuple[float, float],
    vertices: Float[np.ndarray, "V 3"],
    gradient: Float[np.ndarray, " 3"],
    vertex_gradient: Float[np.ndarray, "V 3"],
) -> None:
    """Carry one pixel's gradient from its barycentric coordinates to the corners of its face."""
    a, b, c = corners
    x0, x1, x2 = vertices[a, 0] - center[0], vertices[b, 0] - center[0], vertices[c, 0] - center[0]
    y0, y1, y2 = vertices[a, 1] - center[1], vertices[b, 1] - center[1], vertices[c, 1] - center[1]
    near0, near1, near2 = 1.0 / vertices[a, 2], 1.0 / vertices[b, 2], 1.0 / vertices[c, 2]
    weight0, weight1, weight2 = (x1 * y2 - y1 * x2) * near0, (x2 * y0 - y2 * x0) * near1, (x0 * y1 - y0 * x1) * near2
    total = weight0 + weight1 + weight2
    mean = (gradient[0] * weight0 + gradient[1] * weight1 + gradient[2] * weight2) / total
    slope0, slope1, slope2 = (gradient[0] - mean) / total, (gradient[1] - mean) / total, (gradient[2] - mean) / total
    vertex_gradient[a, 2] -= slope0 * weight0 * near0
    vertex_gradient[b, 2] -= slope1 * weight1 * near1
    vertex_gradient[c, 2] -= slope2 * weight2 * near2
    slope0, slope1, slope2 = slope0 * near0, slope1 * near1, slope2 * near2
    vertex_gradient[a, 0] += slope2 * y1 - slope1 * y2
    vertex_gradient[b, 0] += slope0 * y2 - slope2 * y0
    vertex_gradient[c, 0] += slope1 * y0 - slope0 * y1
    vertex_gradient[a, 1] += slope1 * x2 - slope2 * x1
    vertex_gradient[b, 1] += slope2 * x0 - slope0 * x2
    vertex_gradient[c, 1] += slope0 * x1 - slope1 * x0


@njit(parallel=True)
@no_type_check
def barycentric_backward(
    vertices_ndc: Float[np.ndarray, "B V 3"],
    faces: Int[np.ndarray, "F 3"],
    face_index: Int[np.ndarray, "B H W"],
    gradient: Float[np.ndarray, "B H W 3"],
) -> Float[np.ndarray, "B V 3"]:
    """Return the gradient with respect to the vertices, given the one with respect to barycentric coordinates."""
    vertex_gradient = np.zeros_like(vertices_ndc)
    size = face_index.shape[1]
    for picture in prange(len(vertices_ndc)):
        vertices = vertices_ndc[picture].astype(np.float64)
        total = np.zeros_like(vertices)
        for row in range(size):
            for column in range(size):
                face = face_index[picture, row, column]
                if face >= 0:
                    center = ((2 * column + 1) / size - 1.0, 1.0 - (2 * row + 1) / size)
                    add_vertex_gradient(faces[face], center, vertices, gradient[picture, row, column], total)
        put(total[None], vertex_gradient[picture : picture + 1])
    return vertex_gradient
