"""The compiled rasteriser for the CPU; importing this module imports numba."""

import numpy as np
from numba import njit, prange

from pipeline.geometry.camera import NEAREST_DEPTH


@njit(cache=True)
def rasterize_picture(vertices, faces, face_index, nearness):  # noqa: ANN001, ANN201
    """Write the nearest face of every pixel of one picture; `nearness` is the inverse depth, 0 where empty."""
    size = face_index.shape[0]
    for f in range(faces.shape[0]):
        a, b, c = vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]]
        if min(a[2], b[2], c[2]) < NEAREST_DEPTH:
            continue
        ax, bx, cx = [0.5 * size * (1.0 + v) - 0.5 for v in (a[0], b[0], c[0])]
        ay, by, cy = [0.5 * size * (1.0 - v) - 0.5 for v in (a[1], b[1], c[1])]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0.0:
            continue
        first_row, last_row = max(np.ceil(min(ay, by, cy)), 0.0), min(np.floor(max(ay, by, cy)), size - 1.0)
        first_column, last_column = max(np.ceil(min(ax, bx, cx)), 0.0), min(np.floor(max(ax, bx, cx)), size - 1.0)
        if first_row > last_row or first_column > last_column:
            continue
        for row in range(int(first_row), int(last_row) + 1):
            for column in range(int(first_column), int(last_column) + 1):
                weight_a = ((bx - column) * (cy - row) - (by - row) * (cx - column)) / area
                weight_b = ((cx - column) * (ay - row) - (cy - row) * (ax - column)) / area
                weight_c = ((ax - column) * (by - row) - (ay - row) * (bx - column)) / area
                if weight_a >= 0.0 and weight_b >= 0.0 and weight_c >= 0.0:
                    near = weight_a / a[2] + weight_b / b[2] + weight_c / c[2]
                    if near > nearness[row, column]:
                        nearness[row, column] = near
                        face_index[row, column] = f


@njit(cache=True, parallel=True)
def nearest_faces(vertices, faces, size):  # noqa: ANN001, ANN201
    """Return face_index (B, H, W) of float64 or float32 vertices_ndc (B, V, 3)."""
    face_index = np.full((len(vertices), size, size), -1, np.int64)
    for picture in prange(len(vertices)):
        nearness = np.zeros((size, size), np.float64)
        rasterize_picture(vertices[picture].astype(np.float64), faces, face_index[picture], nearness)
    return face_index
