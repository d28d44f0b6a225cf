"""Measure the multi-view consistency of the baseline HoloGAN, and show objects at even steps of azimuth."""

from pathlib import Path

import torch

from pipeline.config import load
from pipeline.evaluation.evaluate import EvaluateConfig
from pipeline.evaluation.multiview import multiview_figures
from pipeline.evaluation.tables import format_figures
from pipeline.export.picture import enlarge, sheet, write_png
from pipeline.files import write_json
from pipeline.networks.feature_extractor import load_feature_extractor
from pipeline.networks.hologan import draw_views, load_hologan
from pipeline.seeding import generator
from stages.command_line import parse, run


def main() -> None:
    """Draw as many objects as are looked at of a run, at the same azimuths; write the figures and the picture."""
    arguments = parse(__doc__, model=Path, features=Path, out=Path, picture=Path)
    config = load(arguments.params, EvaluateConfig, arguments.sections)
    multiview, device = config.multiview, torch.device("cpu")
    network = load_hologan(arguments.model, device)
    latent = network.sample_latent(multiview.objects, generator(config.seed, "evaluate hologan"))
    views = draw_views(network, latent, multiview.azimuths(), multiview.elevation)
    extractor = load_feature_extractor(arguments.features, device, torch.float32)
    figures = {"multiview": multiview_figures(views, extractor, multiview, config.batch_size)}
    write_json(arguments.out, figures)
    examples = enlarge(views[: multiview.examples], 4)
    write_png(arguments.picture, sheet({f"object {number}": row for number, row in enumerate(examples)}))
    print(format_figures(figures))


if __name__ == "__main__":
    run(main)
