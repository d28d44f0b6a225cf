"""What the stage scripts share: their arguments, and how an error reaches the terminal."""

import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pipeline.errors import in_one_sentence
from pipeline.rows.entries import require_whole_entries


def parse(description: str | None, **arguments: Any) -> Namespace:
    """Parse a stage's arguments: every one is required and named, `out=Path` is `--out PATH`.

    Every stage also takes `--params` (params.yaml) and `--sections`, the dotted sections of it that make up the stage's
    config. Raises ConfigError where the file has entries that nothing reads, or lacks some.
    """
    parser = ArgumentParser(description=description)
    parser.add_argument("--params", type=Path, required=True)
    parser.add_argument("--sections", nargs="+", required=True)
    for name, kind in arguments.items():
        parser.add_argument(f"--{name.replace('_', '-')}", type=kind, required=True)
    parsed = parser.parse_args()
    require_whole_entries(parsed.params)
    return parsed


def run(main: Callable[[], None]) -> None:
    """Run a stage; an error of the user is printed as one sentence, without a traceback, and exits with status 1."""
    with in_one_sentence():
        try:
            main()
        except FileNotFoundError as error:
            sys.exit(f"error: {error.filename} does not exist; run the stage that writes it first")
