"""The reconstruction section of a run's metrics: pictures before and after fine-tuning against the photographs."""

from collections.abc import Mapping
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.evaluation.artifacts import STATES
from pipeline.evaluation.image import psnr, ssim
from pipeline.evaluation.statistics import Columns, mean_figure, mean_figures
from pipeline.losses.image_distance import feature_distance
from pipeline.networks.feature_extractor import FeatureExtractor


@torch.no_grad()
def image_columns(
    photographs: Float[Tensor, "B 3 H W"],
    images: Mapping[str, Float[Tensor, "B 3 H W"]],
    extractor: FeatureExtractor,
    batch_size: int,
) -> dict[str, Columns]:
    """Compare images of several origins with photographs: feature distance (eq. 2), PSNR in decibels, SSIM.

    Returns one row a picture for each origin.
    """
    distances: dict[str, list[Float[Tensor, " _"]]] = {origin: [] for origin in images}
    for start in range(0, len(photographs), batch_size):
        batch = slice(start, start + batch_size)
        seen = extractor(photographs[batch])
        for origin, drawn in images.items():
            distances[origin].append(feature_distance(seen, extractor(drawn[batch])))
    return {
        origin: {"feature_distance": torch.cat(distances[origin]), **pixel_columns(photographs, drawn)}
        for origin, drawn in images.items()
    }


def pixel_columns(photographs: Float[Tensor, "B 3 H W"], images: Float[Tensor, "B 3 H W"]) -> Columns:
    """Compare images with photographs without a network, one row a picture: PSNR in decibels, SSIM."""
    return {"psnr": psnr(photographs, images), "ssim": ssim(photographs, images)}


def image_figures(columns: Mapping[str, Columns]) -> dict[str, Any]:
    """Summarize images of each origin, and of how many pictures fine-tuning lowered the feature distance."""
    predicted, tuned = (columns[state]["feature_distance"] for state in STATES)
    means = {origin: mean_figures(group) for origin, group in columns.items()}
    return {**means, "improved": mean_figure(tuned < predicted)}
