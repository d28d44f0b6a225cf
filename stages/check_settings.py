"""Look at the settings of everything that is on in params.yaml, before the first stage of it starts."""

from pathlib import Path

from pipeline.rows.entries import require_whole_entries
from stages.command_line import run
from stages.settings import require_settings_of_all

PARAMS = Path("params.yaml")


def main() -> None:
    """Raise ConfigError for the first setting that a stage, perhaps hours later, would refuse."""
    require_whole_entries(PARAMS)
    require_settings_of_all(PARAMS)


if __name__ == "__main__":
    run(main)
