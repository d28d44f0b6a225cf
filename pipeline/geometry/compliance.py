"""Coordinates of a mesh in which an optimiser's steps are smooth (Nicolet, Jacobson & Jakob 2021)."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from pipeline.geometry.topology import laplacian_matrix


def compliance_matrix(faces: Int[Tensor, "F 3"], stiffness: float) -> Float[Tensor, "V V"]:
    """Return the inverse of I + stiffness L, L the graph Laplacian of a closed mesh.

    Vertices v are this matrix times coordinates (I + stiffness L) v. It carries each coordinate's step on to the
    neighbours, where steps of single vertices would grow into spikes.
    """
    laplacian = laplacian_matrix(faces)
    return torch.linalg.inv(torch.eye(len(laplacian), device=faces.device) + stiffness * laplacian)
