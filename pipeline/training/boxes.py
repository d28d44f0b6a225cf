"""Pictures cut to the boxes of the objects they show, in which photographs are compared."""

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from pipeline.networks.pose_coordinates import PoseCoordinates


def cut_to_box(
    images: Float[Tensor, "N 3 H W"],
    poses: PoseCoordinates,
    coordinates: Float[Tensor, "N 7"],
    box_size: float,
    roll: Float[Tensor, " N"],
) -> Float[Tensor, "N 3 H W"]:
    """Cut pictures so that the object's box stands in the middle, its longer side `box_size` of the picture's.

    Pictures are turned back by a roll, in radians, about the middle of the box. What lies outside the picture is its
    reflection.
    """
    center, extent = poses.box(coordinates)
    turn = torch.stack([roll.cos(), roll.sin(), -roll.sin(), roll.cos()], 1).view(-1, 2, 2)
    zoom = (extent / box_size)[:, None, None] * turn
    shift = center * center.new_tensor([1.0, -1.0])  # ndc is y up, grids are y down
    grid = functional.affine_grid(torch.cat([zoom, shift[:, :, None]], 2), list(images.shape), align_corners=False)
    return functional.grid_sample(images, grid, padding_mode="reflection", align_corners=False)
