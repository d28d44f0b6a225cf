"""Turn a row of the paper on in params.yaml, then run its chain to the report."""

import os
import sys
from argparse import ArgumentParser
from pathlib import Path

from pipeline.errors import ConfigError
from pipeline.rows.options import BASELINES, Options
from pipeline.rows.turn_on import turn_on
from stages.command_line import run
from stages.settings import require_settings

PARAMS = Path("params.yaml")


def main() -> None:
    """Add the run and what it needs to params.yaml; `dvc repro` does the rest."""
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--row", required=True, help="an entry of `rows`: viewpoints, dimensions, colours")
    parser.add_argument("--size", default="laptop", help="an entry of `sizes`")
    parser.add_argument("--ablation", default="none", help="an entry of `ablations`")
    parser.add_argument("--seed", type=_seed, default=0)
    parser.add_argument("--source", type=Path, help="folder or archive of the photographs, if not on yet")
    parser.add_argument("--features", type=Path, help="weights of the network that compares pictures, if not on yet")
    parser.add_argument("--dataset", help="a name for photographs of your own; else the row's")
    parser.add_argument("--category", help="the category among them; else the row's")
    parser.add_argument("--base_shape", help="another run's base shape to train around, an entry of `base_shapes`")
    parser.add_argument("--baseline", choices=BASELINES, help="measure this on the same photographs instead")
    options = Options(**vars(parser.parse_args()))
    require_settings(PARAMS, options)
    name = turn_on(PARAMS, options)
    stage = f"evaluate_{options.baseline}" if options.baseline else "report"
    # In this process's place, so that Ctrl-C reaches DVC alone, which waits for its stage and releases its lock.
    os.execv(sys.executable, [sys.executable, "-m", "dvc", "repro", f"{stage}@{name}"])


def _seed(text: str) -> int:
    if not text.isdecimal():
        raise ConfigError(f"SEED is '{text}'; expected 0 or a greater number")
    return int(text)


if __name__ == "__main__":
    run(main)
