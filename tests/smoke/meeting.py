"""Run Python when two processes are at a place; at once where there is no such place.

`python meeting.py PLACE ...` runs `python ...`.
"""

import os
import sys
import time
from pathlib import Path

PATIENCE = 120
"""Seconds, which a machine that is busy may need to start the other process."""


def main() -> None:
    place, deadline = Path(sys.argv[1]), time.monotonic() + PATIENCE
    if place.exists():
        (place / str(os.getpid())).touch()
        while len(list(place.iterdir())) < 2:
            if time.monotonic() > deadline:
                sys.exit(f"nobody else came to {place}")
            time.sleep(0.1)
    os.execv(sys.executable, [sys.executable, *sys.argv[2:]])


if __name__ == "__main__":
    main()
