"""Run a stage that is killed in the middle of writing a restart state.

`python dying_stage.py COUNT MODULE ...` runs `python -m MODULE ...` from the current folder. When a restart state is
written for the COUNT-th time, half of it reaches the disk. Of processes that torchrun started the second one dies.
"""

import os
import runpy
import signal
import sys
from pathlib import Path
from unittest.mock import patch


def main() -> None:
    left, sys.argv[:] = int(sys.argv[1]), sys.argv[2:]
    write = Path.write_bytes

    def deadly(path: Path, data: bytes) -> int:
        nonlocal left
        left -= "state" in path.name
        if left == 0 and os.environ.get("RANK") != "0":
            write(path, data[: len(data) // 2])
            os.kill(os.getpid(), signal.SIGKILL)
        return write(path, data)

    sys.path[0] = str(Path.cwd())
    with patch.object(Path, "write_bytes", deadly):
        runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
