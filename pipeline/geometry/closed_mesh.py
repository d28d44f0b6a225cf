"""What makes a mesh a solid, by the places of its vertices: no holes, and a volume with its outside out."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from pipeline.geometry.normalize import fit_unit_cube


def is_closed(vertices: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"]) -> bool:
    """Tell whether faces leave no hole: each edge is walked as often one way as the other.

    Vertices at one place count as one, for textured meshes have several along their seams. Parts may touch or overlap.
    """
    place = torch.unique(vertices, dim=0, return_inverse=True)[1]
    start, end = place[faces].flatten(), place[faces.roll(-1, dims=1)].flatten()
    edge = torch.minimum(start, end) * len(vertices) + torch.maximum(start, end)
    edges, index = torch.unique(edge, return_inverse=True)
    return not torch.zeros(len(edges), dtype=torch.long).index_add_(0, index, (end - start).sign()).any()


def enclosed_volume(vertices: Float[Tensor, "B V 3"], faces: Int[Tensor, "F 3"]) -> Float[Tensor, " B"]:
    """Measure the volume of closed meshes scaled into the unit cube: negative where they are inside out.

    That of parts that overlap counts for each of them; that of a mesh whose vertices are all at one place is NaN.
    """
    first, second, third = fit_unit_cube(vertices.double())[:, faces].unbind(dim=2)
    return (first * torch.linalg.cross(second, third)).sum((1, 2)) / 6
