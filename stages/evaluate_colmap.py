"""Try structure from motion on the photographs of a run, a baseline: COLMAP (paper 4.1)."""

from pathlib import Path
from tempfile import TemporaryDirectory

from pipeline.config import load
from pipeline.datasets.images import load_images
from pipeline.evaluation.colmap import ColmapConfig, run_colmap
from pipeline.evaluation.tables import format_figures
from pipeline.files import write_json, write_text
from stages.command_line import parse, run


def main() -> None:
    """Write the figures and COLMAP's log, and print what it says."""
    arguments = parse(__doc__, images=Path, seed=int, out=Path, log=Path)
    config = load(arguments.params, ColmapConfig, arguments.sections)
    with TemporaryDirectory() as folder:
        figures, log = run_colmap(load_images(arguments.images), config, arguments.seed, Path(folder))
    write_text(arguments.log, log)
    write_json(arguments.out, {"colmap": figures})
    print(format_figures({"colmap": figures}))
    print("\nCOLMAP says: " + "; ".join(figures["says"]))


if __name__ == "__main__":
    run(main)
