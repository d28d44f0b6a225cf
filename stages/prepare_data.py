"""Bring a dataset into arrays: its pictures by split and category, and the ground truth where there is one."""

from pathlib import Path

from pipeline.datasets.prepare import load_prepare, prepare
from pipeline.datasets.prepared import write_truth
from pipeline.files import atomic_path
from stages.command_line import parse, run


def main() -> None:
    """Write both outputs once the whole source has been read."""
    arguments = parse(__doc__, dataset=str, out=Path, truth=Path)
    config = load_prepare(arguments.params, arguments.dataset)
    with atomic_path(arguments.out) as folder:
        truth = prepare(config, folder)
        write_truth(arguments.truth, truth)


if __name__ == "__main__":
    run(main)
