"""Another method's predictions for a category's pictures, measured as a run is."""

import os
from pathlib import Path
from typing import Any

from pipeline.cli.runs import photographs_file, truth_folder
from pipeline.config import load
from pipeline.datasets.images import load_images
from pipeline.errors import ConfigError, DataError
from pipeline.evaluation.artifacts import load_truth
from pipeline.evaluation.benchmark import benchmark_figures
from pipeline.evaluation.evaluate import EvaluateConfig
from pipeline.evaluation.predictions import Counts, read_predictions
from pipeline.files import read_json, write_json
from pipeline.naming import did_you_mean, is_plain


def benchmark(predictions: Path, project: Path, dataset: str, category: str, out: Path) -> dict[str, Any]:
    """Write the figures of a file of predictions as JSON, and return them.

    Raises ConfigError for a dataset that is no name or a category whose truth is not known, and DataError for an `out`
    that cannot be written or is no name of a JSON file, a dataset that is not prepared, and predictions that cannot be
    measured.
    """
    _require_writable(out)
    if not is_plain(dataset):
        raise ConfigError(f"the dataset is '{dataset}'; expected an entry of `datasets` in params.yaml")
    config = load(project / "params.yaml", EvaluateConfig, ["evaluate"])
    folder = truth_folder(project, dataset)
    if (truth := load_truth(folder, category)) is None:
        raise ConfigError(
            f"{folder} has no category '{category}'{did_you_mean(category, read_json(folder / 'index.json'))}"
        )
    photographs = load_images(photographs_file(project, dataset, "test", category))
    counts = Counts(len(truth[0].pose.azimuth), len(photographs), photographs.shape[-1])
    figures = benchmark_figures(read_predictions(predictions, counts), *truth, photographs, config)
    write_json(out, figures)
    return figures


def _require_writable(out: Path) -> None:
    if out.suffix != ".json" or out.is_dir():
        raise DataError(f"{out} cannot be written; name a file that ends in .json")
    folder = next(path for path in out.absolute().parents if path.exists())
    if not (folder.is_dir() and os.access(folder, os.W_OK)):
        raise DataError(f"{out} cannot be written; look at {folder}, or name a file in another folder")
