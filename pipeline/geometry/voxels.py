"""Occupancy of closed meshes on a regular grid."""

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

MESHES_AT_ONCE = 64
"""Bounds the working memory to some hundred megabytes."""


def voxelize(vertices: Float[Tensor, "B V 3"], faces: Int[Tensor, "F 3"], resolution: int) -> Bool[Tensor, "B W H D"]:
    """Tell which voxels of the unit cube [-0.5, 0.5]^3 have their centre inside each mesh.

    The grid has `resolution` voxels along x, y and z, in this order of axes. Inside means a winding number other than
    0, so overlapping parts of one orientation count once, whichever it is. The mesh must be closed; it may intersect
    itself. Geometry outside the cube is cut off.
    """
    return torch.cat([_voxelize(chunk, faces, resolution) for chunk in vertices.split(MESHES_AT_ONCE)])


def _voxelize(vertices: Float[Tensor, "B V 3"], faces: Int[Tensor, "F 3"], resolution: int) -> Bool[Tensor, "B W H D"]:
    """Send a ray up the z axis through each column of voxels and count the faces it leaves and enters."""
    batch = len(vertices)
    # In voxels, with centres at whole numbers. Double precision, or rays near an edge could slip between its two faces.
    corners = ((vertices.double() + 0.5) * resolution - 0.5)[:, faces].flatten(0, 1)
    triangle, column_x, column_y = _columns_in_boxes(corners[:, :, :2], resolution)
    mesh = triangle // len(faces)
    corners = corners[triangle]
    areas = _opposite_areas(corners[:, :, :2], torch.stack([column_x, column_y], dim=1).double())
    total = areas.sum(dim=1)
    inside = _inside(areas, corners[:, :, :2]) & (total != 0)
    height = (areas[inside] * corners[inside, :, 2]).sum(dim=1) / total[inside]
    level = height.ceil().clamp(0, resolution).long()
    column = (mesh[inside] * resolution + column_x[inside]) * resolution + column_y[inside]
    crossings = torch.zeros(batch * resolution**2 * (resolution + 1), dtype=torch.int32, device=vertices.device)
    crossings.index_add_(0, column * (resolution + 1) + level, total[inside].sign().int())
    # Crossing number n lies above voxels 0 to n - 1: those see it on their way up.
    above = crossings.view(batch, resolution, resolution, resolution + 1)[..., 1:]
    return above.flip(-1).cumsum(-1).flip(-1) != 0


def _columns_in_boxes(
    corners: Float[Tensor, "triangles 3 2"], resolution: int
) -> tuple[Int[Tensor, " columns"], Int[Tensor, " columns"], Int[Tensor, " columns"]]:
    """List (triangle, x, y) for every column within the bounding box of each triangle."""
    lower = corners.amin(dim=1).ceil().clamp(0, resolution).long()
    upper = corners.amax(dim=1).floor().clamp(-1, resolution - 1).long()
    sizes = (upper - lower + 1).clamp(min=0)
    counts = sizes.prod(dim=1)
    triangle = torch.arange(len(corners), device=corners.device).repeat_interleave(counts)
    first = counts.cumsum(0) - counts
    position = torch.arange(len(triangle), device=corners.device) - first[triangle]
    height = sizes[triangle, 1]
    return triangle, lower[triangle, 0] + position // height, lower[triangle, 1] + position % height


def _opposite_areas(corners: Float[Tensor, "K 3 2"], point: Float[Tensor, "K 2"]) -> Float[Tensor, "K 3"]:
    """Return twice the signed area that a point spans with the edge opposite each corner."""
    start, end = corners.roll(-1, dims=1), corners.roll(-2, dims=1)
    edge, offset = end - start, point[:, None] - start
    return edge[..., 0] * offset[..., 1] - edge[..., 1] * offset[..., 0]


def _inside(areas: Float[Tensor, "K 3"], corners: Float[Tensor, "K 3 2"]) -> Bool[Tensor, " K"]:
    """Decide points on an edge by the edge's direction, so that of two faces sharing it exactly one is hit."""
    edge = corners.roll(-2, dims=1) - corners.roll(-1, dims=1)
    ascending = (edge[..., 1] > 0) | ((edge[..., 1] == 0) & (edge[..., 0] > 0))
    left = (areas > 0) | ((areas == 0) & ascending)
    return left.all(dim=1) | ~left.any(dim=1)
