"""Measure a run's reconstructions, and its viewpoints and shapes where the truth is known."""

from pathlib import Path

import torch

from pipeline.config import load
from pipeline.datasets.images import load_images
from pipeline.evaluation.artifacts import load_photographs, load_reconstructions, load_truth, select
from pipeline.evaluation.evaluate import EvaluateConfig, chain_result, evaluate_images, evaluate_truth
from pipeline.evaluation.multiview import evaluate_views
from pipeline.evaluation.tables import write_table
from pipeline.files import write_json
from pipeline.networks.feature_extractor import load_feature_extractor
from pipeline.networks.full_model import load_full_model
from pipeline.tensor_files import load_tensors
from stages.command_line import parse, run


def main() -> None:
    """Write the figures as JSON and one row a test picture as CSV."""
    arguments = parse(
        __doc__,
        truth=Path,
        category=str,
        train_images=Path,
        test_images=Path,
        features=Path,
        mesh=Path,
        model=Path,
        reconstructions=Path,
        out=Path,
        table=Path,
    )
    config = load(arguments.params, EvaluateConfig, arguments.sections)
    reconstructions = load_reconstructions(arguments.reconstructions)
    photographs = load_photographs(arguments.test_images, reconstructions.test_index)
    features = load_feature_extractor(arguments.features, torch.device("cpu"), torch.float32)
    training_photographs = load_images(arguments.train_images)
    figures, table = evaluate_images(photographs, training_photographs, reconstructions, features, config)
    full_model = load_full_model(arguments.model, torch.device("cpu"))
    if len(photographs) > 1:  # views of an object are compared with those of others
        views = evaluate_views(reconstructions, full_model, features, config.multiview, config.batch_size)
        figures |= {"multiview": views}
    if (truth := load_truth(arguments.truth, arguments.category)) is not None:
        training, test = truth
        (model, _), (mesh, _) = load_tensors(arguments.model), load_tensors(arguments.mesh)
        learned = chain_result(reconstructions, full_model, model, mesh)
        compared, columns = evaluate_truth(learned, training, select(test, reconstructions.test_index), config)
        figures, table = figures | compared, table | columns
    write_json(arguments.out, figures)
    write_table(arguments.table, table)


if __name__ == "__main__":
    run(main)
