"""Bring a dataset into arrays: its pictures by split and category, and the ground truth where there is one."""

from pathlib import Path

from pipeline.config import load
from pipeline.datasets.prepare import PrepareConfig, prepare
from pipeline.datasets.prepared import write_images, write_truth
from stages.command_line import parse, run


def main() -> None:
    """Read the whole source before anything is written."""
    arguments = parse(__doc__, out=Path, truth=Path)
    dataset = prepare(load(arguments.params, PrepareConfig, arguments.sections))
    write_images(arguments.out, dataset)
    write_truth(arguments.truth, dataset)


if __name__ == "__main__":
    run(main)
