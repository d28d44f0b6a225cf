"""The reconstruction section of a run's metrics: pictures before and after fine-tuning against the photographs."""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.evaluation.image import psnr, ssim
from pipeline.evaluation.statistics import Columns, mean_figure
from pipeline.losses.image_distance import feature_distance
from pipeline.networks.feature_extractor import FeatureExtractor


@torch.no_grad()
def image_columns(
    photographs: Float[Tensor, "B 3 H W"],
    images: Float[Tensor, "B 3 H W"],
    extractor: FeatureExtractor,
    batch_size: int,
) -> Columns:
    """Compare images with photographs, one row a picture: feature distance (eq. 2), PSNR in decibels, SSIM."""
    distances = [
        feature_distance(extractor(photograph), extractor(image))
        for photograph, image in zip(photographs.split(batch_size), images.split(batch_size), strict=True)
    ]
    return {"feature_distance": torch.cat(distances), **pixel_columns(photographs, images)}


def pixel_columns(photographs: Float[Tensor, "B 3 H W"], images: Float[Tensor, "B 3 H W"]) -> Columns:
    """Compare images with photographs without a network, one row a picture: PSNR in decibels, SSIM."""
    return {"psnr": psnr(photographs, images), "ssim": ssim(photographs, images)}


def image_figures(predicted: Columns, tuned: Columns, retrieved: Columns) -> dict[str, Any]:
    """Summarize both moments, the baseline, and the fraction of pictures whose feature distance fine-tuning lowered."""
    return {
        "retrieved": {name: mean_figure(values) for name, values in retrieved.items()},
        "predicted": {name: mean_figure(values) for name, values in predicted.items()},
        "tuned": {name: mean_figure(values) for name, values in tuned.items()},
        "improved": mean_figure(tuned["feature_distance"] < predicted["feature_distance"]),
    }
