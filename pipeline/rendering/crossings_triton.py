"""Where silhouette edges pass between pixels, found on CUDA devices; importing this module imports triton.

Each picture has two slots for each pixel: the first for the pair with the pixel to the right, the second for the pair
with the pixel below. A slot holds a key of the crossing that reaches farthest, or `NONE`: in its upper half the excess,
in its lower half twice the edge, plus 1 where the object is on the side of the pair's first pixel.
"""

from typing import no_type_check

from jaxtyping import Float, Int
from torch import Tensor

from pipeline.geometry.camera import NEAREST_DEPTH
from pipeline.geometry.topology import Topology
from pipeline.rendering.triton_compiler import launch, tl, triton

EDGES = 64
"""Edges that a program follows."""
NONE = tl.constexpr(-(2**63))


@triton.jit
@no_type_check
def point(vertices, vertex, mask, size: tl.constexpr):
    """Return column, row and depth."""
    x = tl.load(vertices + 3 * vertex, mask, other=0.0)
    y = tl.load(vertices + 3 * vertex + 1, mask, other=0.0)
    depth = tl.load(vertices + 3 * vertex + 2, mask, other=1.0)
    return 0.5 * size * (1.0 + x) - 0.5, 0.5 * size * (1.0 - y) - 0.5, depth


@triton.jit
@no_type_check
def _seen_from_outside(vertices, faces, face, mask):
    """Return whether corners run counter-clockwise in the picture."""
    a = vertices + 3 * tl.load(faces + 3 * face, mask, other=0)
    b = vertices + 3 * tl.load(faces + 3 * face + 1, mask, other=0)
    c = vertices + 3 * tl.load(faces + 3 * face + 2, mask, other=0)
    x, y = tl.load(a, mask, other=0.0), tl.load(a + 1, mask, other=0.0)
    bx, by = tl.load(b, mask, other=0.0) - x, tl.load(b + 1, mask, other=0.0) - y
    cx, cy = tl.load(c, mask, other=0.0) - x, tl.load(c + 1, mask, other=0.0) - y
    return bx * cy > by * cx


@triton.jit
@no_type_check
def _depth_at(vertices, faces, face_index, barycentric, pixel, mask):
    """Return the depth that pixels show, infinite in the background."""
    face = tl.load(face_index + pixel, mask, other=-1)
    covered = face >= 0
    depth = tl.zeros_like(tl.load(barycentric + 3 * pixel, covered, other=0.0))
    for corner in tl.static_range(3):
        vertex = tl.load(faces + 3 * face + corner, covered, other=0)
        weight = tl.load(barycentric + 3 * pixel + corner, covered, other=0.0)
        depth += weight * tl.load(vertices + 3 * vertex + 2, covered, other=0.0)
    return tl.where(covered, depth, float("inf"))


@triton.jit
@no_type_check
def _mix(start, end, portion):
    """Interpolate in the way of torch.lerp, which is exact at both ends."""
    return tl.where(portion < 0.5, start + portion * (end - start), end - (end - start) * (1.0 - portion))


@triton.jit
@no_type_check
def _silhouette(vertices, faces, edges, edge_faces, edge, mask, size: tl.constexpr, nearest_depth: tl.constexpr):
    """Return both ends of edges (across, along, depth) and whether they are silhouettes, sideways, inside first."""
    first = _seen_from_outside(vertices, faces, tl.load(edge_faces + 2 * edge, mask, other=0), mask)
    second = _seen_from_outside(vertices, faces, tl.load(edge_faces + 2 * edge + 1, mask, other=0), mask)
    start_column, start_row, start_depth = point(vertices, tl.load(edges + 2 * edge, mask, other=0), mask, size)
    end_column, end_row, end_depth = point(vertices, tl.load(edges + 2 * edge + 1, mask, other=0), mask, size)
    rightwards, downwards = end_column - start_column, end_row - start_row
    sideways = tl.abs(rightwards) > tl.abs(downwards)
    turning = mask & (first != second) & (tl.minimum(start_depth, end_depth) >= nearest_depth)
    left_is_first = tl.where(sideways, rightwards > 0.0, downwards < 0.0)
    start = tl.where(sideways, start_row, start_column), tl.where(sideways, start_column, start_row), start_depth
    end = tl.where(sideways, end_row, end_column), tl.where(sideways, end_column, end_row), end_depth
    return start, end, turning, sideways, left_is_first == first


@triton.jit
@no_type_check
def _key(excess, edge, inside_first):
    """Pack a crossing; keys are in the order of the excesses."""
    bits = excess.to(tl.int32, bitcast=True)
    order = bits ^ ((bits >> 31) & 0x7FFFFFFF)
    return (order.to(tl.int64) << 32) | (2 * edge + inside_first.to(tl.int32)).to(tl.int64)


@triton.jit
@no_type_check
def unpack(key):
    """Return excess, edge and whether the object is on the first pixel's side, and whether there is a crossing."""
    order, code, found = (key >> 32).to(tl.int32), key.to(tl.int32), key != NONE
    excess = (order ^ ((order >> 31) & 0x7FFFFFFF)).to(tl.float32, bitcast=True)
    return tl.where(found, excess, 0.0), tl.where(found, code >> 1, 0), (code & 1) == 1, found


@triton.jit
@no_type_check
def _find_crossings(
    vertices,
    faces,
    edges,
    edge_faces,
    face_index,
    barycentric,
    crossings,
    vertex_count,
    edge_count,
    size: tl.constexpr,
    nearest_depth: tl.constexpr,
    block: tl.constexpr,
):
    """Keep the visible crossing that reaches farthest between each two pixels."""
    picture = tl.program_id(0).to(tl.int64)
    edge = tl.program_id(1) * block + tl.arange(0, block)
    vertices += picture * vertex_count * 3
    face_index += picture * size * size
    barycentric += picture * size * size * 3
    start, end, turning, sideways, inside_first = _silhouette(
        vertices, faces, edges, edge_faces, edge, edge < edge_count, size, nearest_depth
    )
    first_line = tl.maximum(tl.ceil(tl.minimum(start[1], end[1])), 0.0)
    last_line = tl.minimum(tl.ceil(tl.maximum(start[1], end[1])), size + 0.0)
    count = tl.where(turning & (first_line < last_line), last_line - first_line, 0.0).to(tl.int32)
    length = tl.where(count > 0, end[1] - start[1], 1.0)
    step = tl.where(sideways, size, 1)
    for position in range(tl.max(count)):
        line = first_line + position
        portion = (line - start[1]) / length
        across = _mix(start[0], end[0], portion)
        depth = 1.0 / _mix(1.0 / start[2], 1.0 / end[2], portion)
        pixel = tl.floor(across)
        within = (position < count) & (pixel >= 0.0) & (pixel < size - 1.0)
        excess = tl.where(inside_first, across - pixel - 0.5, 0.5 + pixel - across)
        before = tl.where(within, tl.where(sideways, line + pixel * size, line * size + pixel), 0.0).to(tl.int32)
        inside, outside = before + tl.where(inside_first, 0, step), before + tl.where(inside_first, step, 0)
        depth_inside = _depth_at(vertices, faces, face_index, barycentric, inside, within)
        depth_outside = _depth_at(vertices, faces, face_index, barycentric, outside, within)
        visible = within & (depth_outside > tl.maximum(depth_inside, depth))
        slot = crossings + (2 * picture + sideways.to(tl.int32)) * size * size + before
        tl.atomic_max(slot, _key(excess, edge, inside_first), mask=visible, sem="relaxed")


def find_crossings(
    face_index: Int[Tensor, "B H W"],
    barycentric: Float[Tensor, "B H W 3"],
    vertices_ndc: Float[Tensor, "B V 3"],
    faces: Int[Tensor, "F 3"],
    topology: Topology,
) -> Int[Tensor, "B 2 H W"]:
    """Return the keys of the visible crossings; of several that reach equally far one is kept."""
    batch, size, _ = face_index.shape
    vertex_count, edge_count = vertices_ndc.shape[1], len(topology.edges)
    crossings = face_index.new_full((batch, 2, size, size), NONE.value)
    inputs = (vertices_ndc, faces, topology.edges, topology.edge_faces, face_index, barycentric)
    arguments = (*inputs, crossings, vertex_count, edge_count, size, NEAREST_DEPTH)
    launch(_find_crossings, batch, edge_count, EDGES, *arguments)
    return crossings
