"""Pools of processes end with what started them, however often that is told to stop."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch

from pipeline.launch import divided_threads

SCRIPT = """
import signal, time
from pipeline.errors import in_one_sentence
from pipeline.launch import process_pool

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)
    with in_one_sentence(), process_pool(2, "sleeps") as pool:
        print("started", flush=True)
        list(pool.map(time.sleep, [60] * 9))
"""


@pytest.mark.parametrize("second", [signal.SIGINT, signal.SIGTERM])
def test_a_pool_that_is_told_twice_to_stop_ends_at_once(tmp_path: Path, second: signal.Signals) -> None:
    (tmp_path / "sleep.py").write_text(SCRIPT)
    with subprocess.Popen([sys.executable, "sleep.py"], cwd=tmp_path, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        process.send_signal(signal.SIGINT)
        time.sleep(0.05)
        process.send_signal(second)
        assert process.wait(timeout=30) in (130, -second)  # by the second where it met the very end


def test_threads_are_divided_among_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch, "get_num_threads", lambda: 6)
    before = dict(os.environ)
    for processes, threads in ((2, "3"), (4, "1"), (9, "1")):
        with divided_threads(processes):
            assert {os.environ[f"{name}_NUM_THREADS"] for name in ("OMP", "MKL", "NUMBA")} == {threads}
    assert dict(os.environ) == before
