"""What the stage scripts share: their arguments, and how an error reaches the terminal."""

import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pipeline.errors import in_one_sentence


def parse(description: str | None, **arguments: Any) -> Namespace:
    """Parse a stage's arguments: every one is required and named, `out=Path` is `--out PATH`.

    Every stage also takes `--params` (params.yaml) and `--sections`, the dotted sections of it that make up the stage's
    config.
    """
    parser = ArgumentParser(description=description)
    parser.add_argument("--params", type=Path, required=True)
    parser.add_argument("--sections", nargs="+", required=True)
    for name, kind in arguments.items():
        parser.add_argument(f"--{name.replace('_', '-')}", type=kind, required=True)
    return parser.parse_args()


def run(main: Callable[[], None]) -> None:
    """Run a stage; an error of the user is printed as one sentence, without a traceback, and exits with status 1."""
    with in_one_sentence():
        try:
            main()
        except FileNotFoundError as error:
            sys.exit(f"error: {error.filename} does not exist; run the stage that writes it first")
