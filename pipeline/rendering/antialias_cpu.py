"""Compiled antialiasing for the CPU, parallel over pictures; importing this module imports numba.

Each picture has two slots for each pixel: the first for the pair with the pixel to the right, the second for the pair
with the pixel below. A slot holds the crossing that reaches farthest: its excess and, as a code, twice the edge plus 1
where the object is on the side of the pair's first pixel. An empty slot has the code -1.
"""

from typing import no_type_check

import numpy as np
from jaxtyping import Float, Int

from pipeline.rendering.compiled import njit, prange
from pipeline.rendering.rasterize_cpu import pixel_points, put


@njit()
@no_type_check
def seen_from_outside(points: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], face: int) -> bool:
    """Return whether corners run counter-clockwise in the picture, whose rows grow downwards."""
    a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
    x, y = points[a, 0], points[a, 1]
    return (points[b, 0] - x) * (points[c, 1] - y) < (points[b, 1] - y) * (points[c, 0] - x)


@njit()
@no_type_check
def depth_at(
    picture: int,
    row: int,
    column: int,
    vertices_ndc: Float[np.ndarray, "B V 3"],
    faces: Int[np.ndarray, "F 3"],
    face_index: Int[np.ndarray, "B H W"],
    barycentric: Float[np.ndarray, "B H W 3"],
) -> float:
    """Return the depth that a pixel shows, infinite in the background."""
    face = face_index[picture, row, column]
    if face < 0:
        return np.inf
    depth = 0.0
    for corner in range(3):
        depth += barycentric[picture, row, column, corner] * vertices_ndc[picture, faces[face, corner], 2]
    return depth


@njit()
@no_type_check
def crossing(
    points: Float[np.ndarray, "V 3"], start: int, end: int, sideways: bool, line: int
) -> tuple[float, float, float]:
    """Return where an edge meets a line of pixels: the coordinate across, the portion of the edge and the depth."""
    along, across = (0, 1) if sideways else (1, 0)
    portion = (line - points[start, along]) / (points[end, along] - points[start, along])
    place = points[start, across] + portion * (points[end, across] - points[start, across])
    depth = 1.0 / (points[start, 2] + portion * (points[end, 2] - points[start, 2]))
    return place, portion, depth


@njit()
@no_type_check
def follow_edge(
    picture: int,
    edge: int,
    first_outside: bool,
    points: Float[np.ndarray, "V 3"],
    edges: Int[np.ndarray, "E 2"],
    vertices_ndc: Float[np.ndarray, "B V 3"],
    faces: Int[np.ndarray, "F 3"],
    face_index: Int[np.ndarray, "B H W"],
    barycentric: Float[np.ndarray, "B H W 3"],
    codes: Int[np.ndarray, "B 2 H W"],
    excesses: Float[np.ndarray, "B 2 H W"],
) -> None:
    """Put the visible crossings of one silhouette edge into slots in which none reaches farther."""
    size, start, end = face_index.shape[1], edges[edge, 0], edges[edge, 1]
    rightwards, downwards = points[end, 0] - points[start, 0], points[end, 1] - points[start, 1]
    sideways = abs(rightwards) > abs(downwards)
    # The first face traverses the edge from start to end, so seen from outside it lies to the left.
    inside_first = (rightwards > 0.0 if sideways else downwards < 0.0) == first_outside
    along = 0 if sideways else 1
    first_line = max(np.ceil(min(points[start, along], points[end, along])), 0.0)
    last_line = min(np.ceil(max(points[start, along], points[end, along])), size)
    if not first_line < last_line:  # also where a coordinate is not a number
        return
    for line in range(int(first_line), int(last_line)):
        place, _, depth = crossing(points, start, end, sideways, line)
        if 0.0 <= place < size - 1.0:
            pixel = int(place)
            row, column = (pixel, line) if sideways else (line, pixel)
            mesh = vertices_ndc, faces, face_index, barycentric
            depth_inside = depth_at(picture, row, column, *mesh)
            depth_outside = depth_at(picture, row + sideways, column + (not sideways), *mesh)
            excess = place - pixel - 0.5
            if not inside_first:
                depth_inside, depth_outside, excess = depth_outside, depth_inside, -excess
            slot = picture, int(sideways), row, column
            if depth_outside > max(depth_inside, depth) and (codes[slot] < 0 or excess > excesses[slot]):
                codes[slot], excesses[slot] = 2 * edge + inside_first, excess


@njit(parallel=True)
@no_type_check
def find_crossings(
    vertices_ndc: Float[np.ndarray, "B V 3"],
    faces: Int[np.ndarray, "F 3"],
    edges: Int[np.ndarray, "E 2"],
    edge_faces: Int[np.ndarray, "E 2"],
    face_index: Int[np.ndarray, "B H W"],
    barycentric: Float[np.ndarray, "B H W 3"],
) -> tuple[Int[np.ndarray, "B 2 H W"], Float[np.ndarray, "B 2 H W"]]:
    """Return codes and excesses of the visible crossings; of several that reach equally far one is kept."""
    batch, size = face_index.shape[:2]
    codes = np.full((batch, 2, size, size), -1, np.int32)
    excesses = np.zeros((batch, 2, size, size), vertices_ndc.dtype)
    for picture in prange(batch):
        points = pixel_points(vertices_ndc[picture], size)
        outside = np.zeros(len(faces), np.bool_)
        for face in range(len(faces)):
            outside[face] = seen_from_outside(points, faces, face)
        for edge in range(len(edges)):
            first, second = outside[edge_faces[edge, 0]], outside[edge_faces[edge, 1]]
            if first != second and min(points[edges[edge, 0], 2], points[edges[edge, 1], 2]) > 0.0:
                mesh = vertices_ndc, faces, face_index, barycentric
                follow_edge(picture, edge, first, points, edges, *mesh, codes, excesses)
    return codes, excesses


@njit()
@no_type_check
def blended_pair(
    slot: Int[np.ndarray, " 3"], codes: Int[np.ndarray, "2 H W"], excesses: Float[np.ndarray, "2 H W"]
) -> tuple[tuple[int, int], tuple[int, int], float]:
    """Return row and column of the pixel that a crossing changes and of the one whose color it takes, and how much."""
    sideways, row, column = slot[0], slot[1], slot[2]
    first, second = (row, column), (row + sideways, column + 1 - sideways)
    excess, inside_first = excesses[sideways, row, column], codes[sideways, row, column] % 2 == 1
    if (excess > 0.0) == inside_first:
        return second, first, abs(excess)
    return first, second, abs(excess)


@njit()
@no_type_check
def taken_shares(
    slots: Int[np.ndarray, "N 3"], codes: Int[np.ndarray, "2 H W"], excesses: Float[np.ndarray, "2 H W"]
) -> Float[np.ndarray, "H W"]:
    """Return how much of each pixel the edges around it cut off together."""
    taken = np.zeros(codes.shape[1:])
    for slot in slots:
        target, _, share = blended_pair(slot, codes, excesses)
        taken[target] += share
    return taken


@njit(parallel=True)
@no_type_check
def blend(
    colors: Float[np.ndarray, "B C H W"], codes: Int[np.ndarray, "B 2 H W"], excesses: Float[np.ndarray, "B 2 H W"]
) -> Float[np.ndarray, "B C H W"]:
    """Move pixels towards their neighbours by the shares that edges cut off, of no pixel more than all."""
    blended = np.empty_like(colors)
    for picture in prange(len(colors)):
        put(colors[picture], blended[picture])
        slots = np.argwhere(codes[picture] >= 0)
        taken = taken_shares(slots, codes[picture], excesses[picture])
        for slot in slots:
            target, source, share = blended_pair(slot, codes[picture], excesses[picture])
            share /= max(taken[target], 1.0)
            for channel in range(colors.shape[1]):
                own = colors[picture, channel, target[0], target[1]]
                other = colors[picture, channel, source[0], source[1]]
                blended[picture, channel, target[0], target[1]] += share * (other - own)
    return blended


@njit()
@no_type_check
def move_edge(
    slot: Int[np.ndarray, " 3"],
    code: int,
    slope: float,
    points: Float[np.ndarray, "V 3"],
    edges: Int[np.ndarray, "E 2"],
    size: int,
    vertex_gradient: Float[np.ndarray, "V 3"],
) -> None:
    """Carry the gradient with respect to a crossing's excess to the ends of its edge."""
    start, end, sideways = edges[code // 2, 0], edges[code // 2, 1], slot[0] == 1
    along, across = (0, 1) if sideways else (1, 0)
    _, portion, _ = crossing(points, start, end, sideways, slot[2] if sideways else slot[1])
    tilt = (points[end, across] - points[start, across]) / (points[end, along] - points[start, along])
    # In columns or rows (whose y points up); along its longer axis an end carries the crossing with it.
    slope *= 0.5 * size if code % 2 == 1 else -0.5 * size
    slope_across, slope_along = (-slope, -tilt * slope) if sideways else (slope, tilt * slope)
    vertex_gradient[start, across] += slope_across * (1.0 - portion)
    vertex_gradient[end, across] += slope_across * portion
    vertex_gradient[start, along] += slope_along * (1.0 - portion)
    vertex_gradient[end, along] += slope_along * portion


@njit(parallel=True)
@no_type_check
def blend_backward(
    colors: Float[np.ndarray, "B C H W"],
    codes: Int[np.ndarray, "B 2 H W"],
    excesses: Float[np.ndarray, "B 2 H W"],
    vertices_ndc: Float[np.ndarray, "B V 3"],
    edges: Int[np.ndarray, "E 2"],
    gradient: Float[np.ndarray, "B C H W"],
) -> tuple[Float[np.ndarray, "B C H W"], Float[np.ndarray, "B V 3"]]:
    """Return the gradients with respect to the colors and the vertices."""
    size = colors.shape[2]
    color_gradient, vertex_gradient = np.empty_like(colors), np.zeros_like(vertices_ndc)
    for picture in prange(len(colors)):
        put(gradient[picture], color_gradient[picture])
        slots = np.argwhere(codes[picture] >= 0)
        taken = taken_shares(slots, codes[picture], excesses[picture])
        slopes, weighted = np.zeros(len(slots)), np.zeros((size, size))
        for index, slot in enumerate(slots):
            target, source, share = blended_pair(slot, codes[picture], excesses[picture])
            divisor = max(taken[target], 1.0)
            for channel in range(colors.shape[1]):
                own = colors[picture, channel, target[0], target[1]]
                other = colors[picture, channel, source[0], source[1]]
                upstream = gradient[picture, channel, target[0], target[1]]
                slopes[index] += upstream * (other - own) / divisor
                color_gradient[picture, channel, target[0], target[1]] -= share / divisor * upstream
                color_gradient[picture, channel, source[0], source[1]] += share / divisor * upstream
            weighted[target] += slopes[index] * share
        points, total = pixel_points(vertices_ndc[picture], size), np.zeros(vertices_ndc.shape[1:])
        for index, slot in enumerate(slots):
            target, _, _ = blended_pair(slot, codes[picture], excesses[picture])
            # Where pixels give all of themselves, shares are divided by their sum.
            common = weighted[target] / taken[target] if taken[target] >= 1.0 else 0.0
            slope = (slopes[index] - common) * np.sign(excesses[picture, slot[0], slot[1], slot[2]])
            code = codes[picture, slot[0], slot[1], slot[2]]
            move_edge(slot, code, slope, points, edges, size, total)
        put(total[None], vertex_gradient[picture : picture + 1])
    return color_gradient, vertex_gradient
