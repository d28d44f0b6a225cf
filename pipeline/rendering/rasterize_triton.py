"""The rasteriser for CUDA devices: the CPU's arithmetic, so the CPU's faces; importing this module imports triton.

What drawing needs of each face is computed once. Then programs go over the samples in the boxes of a few faces: a first
pass finds the greatest inverse depth at each sample, a second one the lowest face that has it. Atomic maxima and minima
do so, whose results depend on no order. Cost follows the samples in the faces' boxes, and there is no list of faces
that could overflow.
"""

from typing import Any, no_type_check

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.autograd.function import once_differentiable

from pipeline.geometry.camera import NEAREST_DEPTH
from pipeline.rendering.triton_compiler import launch, tl, triton

FACES = 8
"""Faces that a program draws."""
BOX_SAMPLES = 32
"""Samples in each face's box that it tests at once; at training's sizes most boxes have fewer."""
SAMPLES = 256
"""Samples that a program of the other kernels works on."""


@triton.jit
@no_type_check
def _corner(vertices, vertex, mask, size: tl.constexpr, nearest_depth: tl.constexpr):
    """Return column, row and inverse depth, 0 behind the camera."""
    x = tl.load(vertices + 3 * vertex, mask, other=0.0).to(tl.float64)
    y = tl.load(vertices + 3 * vertex + 1, mask, other=0.0).to(tl.float64)
    depth = tl.load(vertices + 3 * vertex + 2, mask, other=1.0).to(tl.float64)
    nearness = tl.where(depth >= nearest_depth, 1.0 / depth, 0.0)
    return 0.5 * size * (1.0 + x) - 0.5, 0.5 * size * (1.0 - y) - 0.5, nearness


@triton.jit
@no_type_check
def _corners(vertices, faces, face, mask, size: tl.constexpr, nearest_depth: tl.constexpr):
    """Return the columns, the rows and the inverse depths of faces' three corners."""
    a = tl.load(faces + 3 * face, mask, other=0)
    b = tl.load(faces + 3 * face + 1, mask, other=0)
    c = tl.load(faces + 3 * face + 2, mask, other=0)
    x0, y0, near0 = _corner(vertices, a, mask, size, nearest_depth)
    x1, y1, near1 = _corner(vertices, b, mask, size, nearest_depth)
    x2, y2, near2 = _corner(vertices, c, mask, size, nearest_depth)
    return x0, x1, x2, y0, y1, y2, near0, near1, near2


@triton.jit
@no_type_check
def _extent(a, b, c, size: tl.constexpr):
    """Return the first sample between three coordinates on one axis, and how many there are."""
    first = tl.maximum(tl.ceil(tl.minimum(tl.minimum(a, b), c)), 0.0)
    last = tl.minimum(tl.floor(tl.maximum(tl.maximum(a, b), c)), size - 1.0)
    return first, tl.where(first <= last, last - first + 1.0, 0.0).to(tl.int32)


@triton.jit
@no_type_check
def _opposite_areas(x0, x1, x2, y0, y1, y2):
    """Return twice the areas that the origin spans with the edges opposite to three corners."""
    return x1 * y2 - y1 * x2, x2 * y0 - y2 * x0, x0 * y1 - y0 * x1


@triton.jit
@no_type_check
def _set_up(
    vertices,
    faces,
    outlines,
    boxes,
    vertex_count,
    face_count,
    size: tl.constexpr,
    nearest_depth: tl.constexpr,
    block: tl.constexpr,
):
    """Write what drawing needs of each face: its outline and the box of samples around it, which may be empty.

    An outline is the columns and rows of the corners, their inverse depths over the area, and 1 or, for corners that
    run clockwise, -1; a box its first row and column, its width, and how many samples it has.
    """
    picture = tl.program_id(0).to(tl.int64)
    face = tl.program_id(1) * block + tl.arange(0, block)
    exists = face < face_count
    x0, x1, x2, y0, y1, y2, near0, near1, near2 = _corners(
        vertices + picture * vertex_count * 3, faces, face, exists, size, nearest_depth
    )
    first_row, height = _extent(y0, y1, y2, size)
    first_column, width = _extent(x0, x1, x2, size)
    area = (x1 - x0) * (y2 - y0) - (y1 - y0) * (x2 - x0)
    drawn = exists & (tl.abs(area) > 0.0) & (tl.minimum(tl.minimum(near0, near1), near2) > 0.0)
    turn = tl.where(area > 0.0, 1.0, -1.0)
    area = tl.where(drawn, tl.abs(area), 1.0)
    count = tl.where(drawn, width * height, 0)
    outline = outlines + (picture * face_count + face) * 10
    tl.store(outline, x0, exists)
    tl.store(outline + 1, x1, exists)
    tl.store(outline + 2, x2, exists)
    tl.store(outline + 3, y0, exists)
    tl.store(outline + 4, y1, exists)
    tl.store(outline + 5, y2, exists)
    tl.store(outline + 6, near0 / area, exists)
    tl.store(outline + 7, near1 / area, exists)
    tl.store(outline + 8, near2 / area, exists)
    tl.store(outline + 9, turn, exists)
    box = boxes + (picture * face_count + face) * 4
    tl.store(box, tl.where(count > 0, first_row, 0.0).to(tl.int32), exists)
    tl.store(box + 1, tl.where(count > 0, first_column, 0.0).to(tl.int32), exists)
    tl.store(box + 2, width, exists)
    tl.store(box + 3, count, exists)


@triton.jit
@no_type_check
def _draw(
    outlines,
    boxes,
    nearest,
    face_index,
    face_count,
    size: tl.constexpr,
    first_pass: tl.constexpr,
    box_block: tl.constexpr,
    block: tl.constexpr,
):
    """Draw faces of one picture: their inverse depths in the first pass, those that are nearest in the second."""
    picture = tl.program_id(0).to(tl.int64)
    face = tl.program_id(1) * block + tl.arange(0, block)[:, None]
    exists = face < face_count
    box = boxes + (picture * face_count + face) * 4
    count = tl.load(box + 3, exists, other=0)
    drawn = count > 0
    first_row, first_column = tl.load(box, drawn, other=0), tl.load(box + 1, drawn, other=0)
    width = tl.load(box + 2, drawn, other=1)
    outline = outlines + (picture * face_count + face) * 10
    x0 = tl.load(outline, drawn, other=0.0)
    x1 = tl.load(outline + 1, drawn, other=0.0)
    x2 = tl.load(outline + 2, drawn, other=0.0)
    y0 = tl.load(outline + 3, drawn, other=0.0)
    y1 = tl.load(outline + 4, drawn, other=0.0)
    y2 = tl.load(outline + 5, drawn, other=0.0)
    near0 = tl.load(outline + 6, drawn, other=0.0)
    near1 = tl.load(outline + 7, drawn, other=0.0)
    near2 = tl.load(outline + 8, drawn, other=0.0)
    turn = tl.load(outline + 9, drawn, other=1.0)
    for start in range(0, tl.max(count), box_block):
        position = start + tl.arange(0, box_block)[None, :]
        row, column = first_row + position // width, first_column + position % width
        weight0, weight1, weight2 = _opposite_areas(
            x0 - column, x1 - column, x2 - column, turn * (y0 - row), turn * (y1 - row), turn * (y2 - row)
        )
        near = weight0 * near0 + weight1 * near1 + weight2 * near2
        hit = (position < count) & (tl.minimum(tl.minimum(weight0, weight1), weight2) >= 0.0) & (near > 0.0)
        sample = (picture * size + row) * size + column
        bits = near.to(tl.int64, bitcast=True)  # positive floating-point numbers compare like their bits
        if first_pass:
            tl.atomic_max(nearest + sample, bits, mask=hit, sem="relaxed")
        else:
            front = hit & (tl.load(nearest + sample, mask=hit, other=0) == bits)
            tl.atomic_min(face_index + sample, face.to(tl.int64) + tl.zeros_like(bits), mask=front, sem="relaxed")


@triton.jit
@no_type_check
def _weigh_corners(
    vertices,
    faces,
    face_index,
    barycentric,
    vertex_count,
    face_count,
    size: tl.constexpr,
    nearest_depth: tl.constexpr,
    block: tl.constexpr,
):
    """Write perspective-correct barycentric coordinates, and -1 where no face was drawn."""
    picture = tl.program_id(0).to(tl.int64)
    sample = tl.program_id(1) * block + tl.arange(0, block)
    within = sample < size * size
    place = picture * size * size + sample
    face = tl.load(face_index + place, within, other=face_count)
    covered = face < face_count
    tl.store(face_index + place, tl.where(covered, face, -1), within)
    x0, x1, x2, y0, y1, y2, near0, near1, near2 = _corners(
        vertices + picture * vertex_count * 3, faces, face, covered, size, nearest_depth
    )
    row, column = sample // size, sample % size
    weight0, weight1, weight2 = _opposite_areas(x0 - column, x1 - column, x2 - column, y0 - row, y1 - row, y2 - row)
    weight0, weight1, weight2 = weight0 * near0, weight1 * near1, weight2 * near2
    total = tl.where(covered, weight0 + weight1 + weight2, 1.0)
    tl.store(barycentric + 3 * place, tl.where(covered, weight0 / total, 0.0), within)
    tl.store(barycentric + 3 * place + 1, tl.where(covered, weight1 / total, 0.0), within)
    tl.store(barycentric + 3 * place + 2, tl.where(covered, weight2 / total, 0.0), within)


@triton.jit
@no_type_check
def _add(target, mask, x, y, z):
    """Add a vector to one in memory that other programs add to as well."""
    tl.atomic_add(target, x.to(tl.float32), mask=mask, sem="relaxed")
    tl.atomic_add(target + 1, y.to(tl.float32), mask=mask, sem="relaxed")
    tl.atomic_add(target + 2, z.to(tl.float32), mask=mask, sem="relaxed")


@triton.jit
@no_type_check
def _weigh_corners_backward(
    vertices,
    faces,
    face_index,
    gradient,
    vertex_gradient,
    vertex_count,
    size: tl.constexpr,
    nearest_depth: tl.constexpr,
    block: tl.constexpr,
):
    """Carry the gradient from barycentric coordinates to the corners of their faces."""
    picture = tl.program_id(0).to(tl.int64)
    sample = tl.program_id(1) * block + tl.arange(0, block)
    place = picture * size * size + sample
    face = tl.load(face_index + place, sample < size * size, other=-1)
    covered = face >= 0
    x0, x1, x2, y0, y1, y2, near0, near1, near2 = _corners(
        vertices + picture * vertex_count * 3, faces, face, covered, size, nearest_depth
    )
    row, column = sample // size, sample % size
    x0, x1, x2, y0, y1, y2 = x0 - column, x1 - column, x2 - column, y0 - row, y1 - row, y2 - row
    area0, area1, area2 = _opposite_areas(x0, x1, x2, y0, y1, y2)
    weight0, weight1, weight2 = area0 * near0, area1 * near1, area2 * near2
    total = tl.where(covered, weight0 + weight1 + weight2, 1.0)
    upstream0 = tl.load(gradient + 3 * place, covered, other=0.0)
    upstream1 = tl.load(gradient + 3 * place + 1, covered, other=0.0)
    upstream2 = tl.load(gradient + 3 * place + 2, covered, other=0.0)
    mean = (upstream0 * weight0 + upstream1 * weight1 + upstream2 * weight2) / total
    slope0, slope1, slope2 = (upstream0 - mean) / total, (upstream1 - mean) / total, (upstream2 - mean) / total
    vertex_gradient += picture * vertex_count * 3
    a = vertex_gradient + 3 * tl.load(faces + 3 * face, covered, other=0)
    b = vertex_gradient + 3 * tl.load(faces + 3 * face + 1, covered, other=0)
    c = vertex_gradient + 3 * tl.load(faces + 3 * face + 2, covered, other=0)
    step = 0.5 * size  # samples per unit of ndc, whose y points up
    slope0, slope1, slope2 = slope0 * near0, slope1 * near1, slope2 * near2
    _add(a, covered, step * (slope2 * y1 - slope1 * y2), -step * (slope1 * x2 - slope2 * x1), -slope0 * weight0)
    _add(b, covered, step * (slope0 * y2 - slope2 * y0), -step * (slope2 * x0 - slope0 * x2), -slope1 * weight1)
    _add(c, covered, step * (slope1 * y0 - slope0 * y1), -step * (slope0 * x1 - slope1 * x0), -slope2 * weight2)


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, vertices_ndc: Tensor, faces: Tensor, size: int) -> tuple[Tensor, Tensor]:
        vertices, faces = vertices_ndc.detach().contiguous(), faces.contiguous()
        batch, vertex_count, _ = vertices.shape
        nearest = vertices.new_zeros((batch, size, size), dtype=torch.int64)
        face_index = torch.full_like(nearest, len(faces))
        outlines = vertices.new_empty((batch, len(faces), 10), dtype=torch.float64)
        boxes = vertices.new_empty((batch, len(faces), 4), dtype=torch.int32)
        arguments = (vertices, faces, outlines, boxes, vertex_count, len(faces), size, NEAREST_DEPTH)
        launch(_set_up, batch, len(faces), SAMPLES, *arguments)
        for first_pass in (True, False):
            arguments = (outlines, boxes, nearest, face_index, len(faces), size, first_pass, BOX_SAMPLES)
            launch(_draw, batch, len(faces), FACES, *arguments)
        barycentric = torch.empty((batch, size, size, 3), dtype=vertices.dtype, device=vertices.device)
        arguments = (vertices, faces, face_index, barycentric, vertex_count, len(faces), size, NEAREST_DEPTH)
        launch(_weigh_corners, batch, size * size, SAMPLES, *arguments)
        ctx.save_for_backward(vertices, faces, face_index)
        ctx.mark_non_differentiable(face_index)
        return face_index, barycentric

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None, None]:  # pyright: ignore[reportIncompatibleMethodOverride]
        vertices, faces, face_index = ctx.saved_tensors
        (batch, vertex_count, _), size = vertices.shape, face_index.shape[1]
        vertex_gradient = torch.zeros_like(vertices)
        arguments = (vertices, faces, face_index, gradients[1].contiguous(), vertex_gradient, vertex_count)
        launch(_weigh_corners_backward, batch, size * size, SAMPLES, *arguments, size, NEAREST_DEPTH)
        return vertex_gradient, None, None


def rasterize(
    vertices_ndc: Float[Tensor, "B V 3"], faces: Int[Tensor, "F 3"], size: int
) -> tuple[Int[Tensor, "B H W"], Float[Tensor, "B H W 3"]]:
    """Return the nearest face at every sample's centre and its barycentric coordinates, as `rasterize.rasterize`."""
    return _Rasterize.apply(vertices_ndc, faces, size)
