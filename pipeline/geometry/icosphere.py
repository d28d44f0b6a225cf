"""The icosphere: the sphere that base shapes start from."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

GOLDEN_RATIO = (1 + 5**0.5) / 2


def icosahedron() -> tuple[Float[Tensor, "12 3"], Int[Tensor, "20 3"]]:
    """Return the regular icosahedron on the unit sphere, mirror-symmetric about x = 0, faces counter-clockwise."""
    short_and_long = [(short, long) for short in (-1.0, 1.0) for long in (-GOLDEN_RATIO, GOLDEN_RATIO)]
    corners = [(0.0, short, long) for short, long in short_and_long]
    corners += [(short, long, 0.0) for short, long in short_and_long]
    corners += [(long, 0.0, short) for short, long in short_and_long]
    vertices = torch.tensor(corners, dtype=torch.float64)
    distance = torch.cdist(vertices, vertices)
    touching = (distance > 0) & (distance < 2.1)  # every edge of this icosahedron is 2 long
    triples = torch.combinations(torch.arange(12), 3)
    first, second, third = triples.unbind(1)
    faces = triples[touching[first, second] & touching[second, third] & touching[third, first]]
    corner_vertices = vertices[faces]
    outward = torch.linalg.det(corner_vertices) > 0
    faces = torch.where(outward[:, None], faces, faces.flip(1))
    return vertices / vertices.norm(dim=1, keepdim=True), faces


def subdivide(
    vertices: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"]
) -> tuple[Float[Tensor, "new_vertices 3"], Int[Tensor, "new_faces 3"]]:
    """Split every face in four at the midpoints of its edges and push the midpoints to the unit sphere."""
    edges = torch.stack((faces, faces.roll(-1, dims=1)), dim=2).sort(dim=2).values  # edge k joins corners k and k + 1
    unique_edges, edge_index = edges.reshape(-1, 2).unique(dim=0, return_inverse=True)
    midpoints = vertices[unique_edges].sum(dim=1)
    midpoints = midpoints / midpoints.norm(dim=1, keepdim=True)
    middle = edge_index.reshape(-1, 3) + len(vertices)
    corner_faces = [torch.stack((faces[:, k], middle[:, k], middle[:, k - 1]), dim=1) for k in range(3)]
    return torch.cat((vertices, midpoints)), torch.cat((*corner_faces, middle))


def icosphere(subdivisions: int) -> tuple[Float[Tensor, "V 3"], Int[Tensor, "F 3"]]:
    """Return a unit icosphere with 10 * 4**subdivisions + 2 vertices, exactly mirror-symmetric about x = 0.

    Vertices are float32, faces int64 and counter-clockwise seen from outside. Base shapes have three
    subdivisions (642 vertices, 1280 faces).
    """
    vertices, faces = icosahedron()
    for _ in range(subdivisions):
        vertices, faces = subdivide(vertices, faces)
    return vertices.float(), faces
