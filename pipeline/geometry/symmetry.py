"""Mirror symmetry about the plane x = 0."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from pipeline.device import constant
from pipeline.errors import MeshError

PARTNER_TOLERANCE = 1e-6
"""How far a vertex may lie from the image of its partner, in world units: rounding of coordinates."""

SHAPE_TOLERANCE = 1e-4
"""How far vertices of a symmetric shape may lie from their partners' images: rounding of trained coordinates."""


def mirror_index(vertices: Float[Tensor, "V 3"]) -> Int[Tensor, " V"]:
    """Find the mirror image of every vertex.

    Entry i is the index of the vertex at (-x, y, z) of vertex i, within rounding; vertices on the plane map to
    themselves. Raises MeshError when some vertex has no partner or two vertices share one.
    """
    distances = torch.cdist(reflect(vertices).double(), vertices.double(), compute_mode="donot_use_mm_for_euclid_dist")
    distance, index = distances.min(dim=1)
    identity = torch.arange(len(vertices), device=vertices.device)
    if distance.max() > PARTNER_TOLERANCE:
        raise MeshError(
            f"the mesh is not mirror-symmetric about x = 0: a vertex is {distance.max():.2g} away from its image, "
            f"expected at most {PARTNER_TOLERANCE:.2g}; symmetrise the mesh first"
        )
    if not torch.equal(index[index], identity):
        raise MeshError("the mesh has vertices in one place, so that two share a mirror image; merge them first")
    return index


def is_symmetric(vertices: Float[Tensor, "V 3"], mirror: Int[Tensor, " V"]) -> bool:
    """Tell whether each vertex is the reflection of its mirror partner within rounding."""
    return bool((vertices[mirror] - reflect(vertices)).abs().max() <= SHAPE_TOLERANCE)


def reflect(vectors: Float[Tensor, "... 3"]) -> Float[Tensor, "... 3"]:
    """Negate the x coordinate."""
    return vectors * constant((-1.0, 1.0, 1.0), vectors)


def symmetrize(offsets: Float[Tensor, "*B V 3"], mirror: Int[Tensor, " V"]) -> Float[Tensor, "*B V 3"]:
    """Average each vector with the reflection of its mirror partner's.

    The result is symmetric to the last bit: partners differ only in the sign of x, which is 0 on the plane. Gradients
    flow to `offsets`. Paper 3.1.1, symmetry of objects.
    """
    return (offsets + reflect(offsets.index_select(-2, mirror))) / 2
