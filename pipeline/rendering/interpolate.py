"""Interpolation of vertex attributes over the pixels."""

from jaxtyping import Float, Int
from torch import Tensor

from pipeline.rendering.rasterize import Fragments


def interpolate(
    attributes: Float[Tensor, "B V C"], faces: Int[Tensor, "F 3"], fragments: Fragments
) -> Float[Tensor, "B H W C"]:
    """Interpolate attributes of vertices with perspective correction; the background gets 0.

    Gradients flow to the attributes and, through the barycentric coordinates, to the vertices.
    """
    picture, row, column = (fragments.face_index >= 0).nonzero(as_tuple=True)
    corners = attributes[picture[:, None], faces[fragments.face_index[picture, row, column]]]
    values = (fragments.barycentric[picture, row, column][..., None] * corners).sum(dim=1)
    result = attributes.new_zeros(*fragments.face_index.shape, attributes.shape[-1])
    return result.index_put((picture, row, column), values)
