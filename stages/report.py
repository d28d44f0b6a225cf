"""Write a run's page and figures, and print its metrics."""

from pathlib import Path

import torch

from pipeline.config import load, scalar
from pipeline.evaluation.artifacts import load_photographs, load_reconstructions
from pipeline.evaluation.tables import format_figures, read_table
from pipeline.export.report import ReportConfig, ReportInputs, write_report
from pipeline.files import read_json
from pipeline.networks.full_model import load_full_model
from pipeline.networks.seed_choice import load_seed
from pipeline.tensor_files import load_tensors
from stages.command_line import parse, run

TRAININGS = ("features", "base_shape", "full")
STAGES = ("features", "base_shape", "remesh", "full", "fine_tune")


def main() -> None:
    """Write the page and the figures; end with a table of metrics and the page's path."""
    arguments = parse(
        __doc__,
        run=str,
        dataset=str,
        test_images=Path,
        base_shape=Path,
        mesh=Path,
        model=Path,
        reconstructions=Path,
        metrics=Path,
        table=Path,
        out=Path,
        figures=Path,
        **{f"{stage}_metrics": Path for stage in STAGES},
        **{f"{stage}_curve": Path for stage in TRAININGS},
    )
    reconstructions = load_reconstructions(arguments.reconstructions)
    base_shape, _ = load_tensors(arguments.base_shape)
    model = load_full_model(arguments.model, torch.device("cpu"))
    inputs = ReportInputs(
        run=arguments.run,
        photographs=load_photographs(arguments.test_images, reconstructions.test_index),
        drawn=scalar(arguments.params, f"datasets.{arguments.dataset}.kind") == "toybox",
        reconstructions=reconstructions,
        seeds=base_shape["seed_vertices"],
        seed_faces=base_shape["faces"],
        seed_scores=base_shape["seed_scores"],
        chosen_seed=load_seed(arguments.mesh),
        base=model.shapes.base().detach() if model.config.two_stage else None,
        camera=model.config.renderer.camera,
        framing=model.config.framing,
        figures=read_json(arguments.metrics),
        stage_figures={stage: read_json(getattr(arguments, f"{stage}_metrics")) for stage in STAGES},
        curves={stage: read_table(getattr(arguments, f"{stage}_curve")) for stage in TRAININGS},
        table=read_table(arguments.table),
    )
    write_report(inputs, load(arguments.params, ReportConfig, arguments.sections), arguments.out, arguments.figures)
    print(format_figures(inputs.figures))
    print(f"\nopen {(arguments.out / 'index.html').resolve()}")


if __name__ == "__main__":
    run(main)
