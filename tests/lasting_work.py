"""Two processes that share work without an end, started by one that ignores interrupts, as those behind `&` do."""

import os
import signal
import sys
from pathlib import Path

import torch

from pipeline.launch import share_work


def last(folder: Path) -> None:
    """Leave this process's number in a folder, and never end."""
    (folder / str(os.getpid())).touch()
    signal.pause()


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    share_work(2, torch.device("cpu"), last, Path(sys.argv[1]))
