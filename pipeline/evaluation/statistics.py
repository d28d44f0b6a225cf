"""Figures: a number together with how many samples it rests on and how far chance may have moved it."""

from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

Columns = dict[str, Tensor]
"""Values by name, one a picture."""
Figure = dict[str, float | int | None]
Figures = dict[str, Any]
"""Figures by name, in sections."""

BOOTSTRAP_DRAWS = 200
ROUNDING = 1e-6
"""Deviation below which float32 values of about 1 say nothing."""


def mean_figure(values: Float[Tensor, " B"] | Bool[Tensor, " B"]) -> Figure:
    """Summarize samples, or how often something holds, by their mean.

    The standard error is the sample standard deviation over the square root of n: 0 where all samples are alike, None
    for a single one, which says nothing of it.
    """
    count = len(values)
    error = values.double().std().item() / count**0.5 if count > 1 else None
    return {"value": values.double().mean().item(), "n": count, "standard_error": error}


def mean_figures(columns: Columns) -> dict[str, Figure]:
    """Summarize each column by its mean."""
    return {name: mean_figure(values) for name, values in columns.items()}


def accuracy_figure(hits: Float[Tensor, " B"] | Bool[Tensor, " B"]) -> Figure:
    """Summarize how often estimates are right: `acc_pi6`, with n and standard error beside it."""
    figure = mean_figure(hits)
    return {"acc_pi6": figure.pop("value"), **figure}


def correlation_figure(first: Float[Tensor, " B"], second: Float[Tensor, " B"]) -> Figure:
    """Summarize how far two quantities vary together by their correlation.

    It is 0 where one is constant, but for rounding, and for one or two samples, which always lie on a line. The
    standard error is that of large samples from a normal distribution.
    """
    one, other = (values.double() - values.double().mean() for values in (first, second))
    varies = len(first) > 2 and min(one.std(correction=0), other.std(correction=0)) > ROUNDING
    correlation = (one @ other / (one.norm() * other.norm())).item() if varies else 0.0
    return {
        "value": correlation,
        "n": len(first),
        "standard_error": max(1 - correlation**2, 0.0) / max(len(first) - 1, 1) ** 0.5,
    }


def median_figure(values: Float[Tensor, " B"], rng: torch.Generator) -> Figure:
    """Summarize samples by their median, with the standard deviation of bootstrapped medians as standard error.

    A single sample has none.
    """
    count = len(values)
    draws = torch.randint(count, (BOOTSTRAP_DRAWS, count), generator=rng)
    medians = values.double()[draws].quantile(0.5, dim=1)
    return {
        "value": values.double().quantile(0.5).item(),
        "n": count,
        "standard_error": medians.std().item() if count > 1 else None,
    }
