"""Compiled interpolation for the CPU, parallel over pictures; importing this module imports numba."""

from typing import no_type_check

import numpy as np
from jaxtyping import Float, Int

from pipeline.rendering.compiled import njit, prange


@njit(parallel=True)
@no_type_check
def interpolate(
    attributes: Float[np.ndarray, "B V C"],
    faces: Int[np.ndarray, "F 3"],
    face_index: Int[np.ndarray, "B H W"],
    barycentric: Float[np.ndarray, "B H W 3"],
) -> Float[np.ndarray, "B H W C"]:
    """Return interpolated attributes, 0 in the background."""
    batch, height, width = face_index.shape
    channels = attributes.shape[2]
    values = np.zeros((batch, height, width, channels), attributes.dtype)
    for picture in prange(batch):
        for row in range(height):
            for column in range(width):
                face = face_index[picture, row, column]
                if face >= 0:
                    a, b, c = faces[face]
                    weight = barycentric[picture, row, column]
                    for channel in range(channels):
                        values[picture, row, column, channel] = (
                            weight[0] * attributes[picture, a, channel]
                            + weight[1] * attributes[picture, b, channel]
                            + weight[2] * attributes[picture, c, channel]
                        )
    return values


@njit(parallel=True)
@no_type_check
def interpolate_backward(
    attributes: Float[np.ndarray, "B V C"],
    faces: Int[np.ndarray, "F 3"],
    face_index: Int[np.ndarray, "B H W"],
    barycentric: Float[np.ndarray, "B H W 3"],
    gradient: Float[np.ndarray, "B H W C"],
) -> tuple[Float[np.ndarray, "B V C"], Float[np.ndarray, "B H W 3"]]:
    """Return the gradients with respect to attributes and barycentric coordinates."""
    batch, height, width = face_index.shape
    attribute_gradient = np.zeros_like(attributes)
    barycentric_gradient = np.zeros_like(barycentric)
    for picture in prange(batch):
        for row in range(height):
            for column in range(width):
                face = face_index[picture, row, column]
                if face >= 0:
                    for corner in range(3):
                        vertex = faces[face, corner]
                        weight = barycentric[picture, row, column, corner]
                        slope = 0.0
                        for channel in range(attributes.shape[2]):
                            upstream = gradient[picture, row, column, channel]
                            attribute_gradient[picture, vertex, channel] += weight * upstream
                            slope += upstream * attributes[picture, vertex, channel]
                        barycentric_gradient[picture, row, column, corner] = slope
    return attribute_gradient, barycentric_gradient
