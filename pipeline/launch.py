"""Start processes: those that share a training (see `pipeline.distributed`), and pools that divide single calls."""

import ctypes
import multiprocessing
import os
import platform
import signal
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from datetime import timedelta
from multiprocessing.queues import SimpleQueue
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import torch
import torch.distributed as dist
from torch.multiprocessing.spawn import ProcessContext, ProcessException, ProcessExitedException, spawn

from pipeline.device import prepare_process
from pipeline.errors import ConfigError, ProcessKilled, UserError, lacks_memory

_END_WITH_PARENT = 1
"""PR_SET_PDEATHSIG of `prctl`."""
_ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_GRACE = 5.0
"""Seconds that processes have to end by themselves after another one has failed."""
_PATIENCE = timedelta(days=7)
"""How long a process waits for another, which may have hours of work left; one that died is noticed at once."""


def share_work(processes: int, device: torch.device, function: Callable[..., None], *arguments: object) -> None:
    """Call a function in every process that shares its work.

    With one process it is called here. More of them are started on this machine, each on a GPU of its own where the
    device is one; threads are divided among them, and the function must be importable and its arguments picklable.
    Under torchrun this process is one of the group already, on any number of hosts, and `processes` is not used.

    When any process ends before its work is done, all do. Raises the UserError, OSError or lack of memory of the
    first one that had one, and ProcessKilled where a signal ended one.
    """
    if dist.is_torchelastic_launched():
        _work(int(os.environ["LOCAL_RANK"]), device, {}, function, arguments)
    elif processes == 1:
        function(*arguments)
    else:
        with TemporaryDirectory() as folder, divided_threads(processes):
            _start(processes, device, f"file://{Path(folder) / 'meeting'}", function, arguments)


def resolve_processes(processes: object, device: torch.device, parts: int) -> int:
    """Turn a number or `auto` into the number of processes that share a stage's work.

    `auto` is one for each GPU where the work has independent `parts`, such as seeds; else for as many GPUs as are a
    power of two, by which batches divide. On a CPU two processes pay where there are parts; a shared batch is faster on
    the threads of one (docs/decisions/processes.md).
    Raises ConfigError for anything else, and for more processes than GPUs where these share batches.
    """
    if processes == "auto":
        if device.type == "cuda":
            gpus = torch.cuda.device_count()
            return min(gpus, parts) if parts > 1 else _power_of_two(gpus)
        return min(2, parts, torch.get_num_threads())
    if type(processes) is not int or processes < 1:
        raise ConfigError(f"processes of a stage are {processes!r}; expected auto or a whole number from 1")
    if device.type == "cuda" and parts == 1 and processes > torch.cuda.device_count():
        raise ConfigError(
            f"processes of a stage are {processes}, but its batches are shared by one process a GPU, and there are "
            f"{torch.cuda.device_count()} GPUs; expected at most as many"
        )
    return processes


def _power_of_two(limit: int) -> int:
    return 1 << (limit.bit_length() - 1)


def _start(
    processes: int, device: torch.device, meeting: str, function: Callable[..., None], arguments: tuple[object, ...]
) -> None:
    errors: SimpleQueue[Exception] = multiprocessing.get_context("spawn").SimpleQueue()
    context = spawn(_started, (processes, device, meeting, errors, function, arguments), processes, join=False)
    assert context is not None
    try:
        while not context.join(grace_period=_GRACE):
            pass
    except ProcessException as error:
        if not errors.empty():
            raise errors.get() from None
        killed = _find_killed(error, context)
        if killed is None:
            raise
        rank, number = killed
        how = "killed, perhaps for want of memory" if number == signal.SIGKILL else f"ended by signal {number.name}"
        raise ProcessKilled(
            f"process {rank} of {processes} was {how}, and the others were stopped; run the same command again: it "
            "goes on from the last restart state"
        ) from None
    finally:
        for file in filter(None, context.error_files):  # which PyTorch leaves behind
            Path(file).unlink(missing_ok=True)


def _find_killed(error: ProcessException, context: ProcessContext) -> tuple[int, signal.Signals] | None:
    """Return the rank of a process that a signal has ended, and the signal; None where there is none.

    Others notice that one is gone, and their error may be met first. Those that are stopped for it end by SIGTERM.
    """
    if isinstance(error, ProcessExitedException) and error.exit_code < 0:
        return error.error_index, signal.Signals(-error.exit_code)
    for rank, process in enumerate(context.processes):
        if process.exitcode < 0 and process.exitcode != -signal.SIGTERM:
            return rank, signal.Signals(-process.exitcode)
    return None


def _started(
    rank: int,
    processes: int,
    device: torch.device,
    meeting: str,
    errors: "SimpleQueue[Exception]",
    function: Callable[..., None],
    arguments: tuple[object, ...],
) -> None:
    end_with_parent()  # PyTorch asks for an interrupt, which processes behind `&` ignore
    group = {"init_method": meeting, "rank": rank, "world_size": processes}
    try:
        _work(rank, device, group, function, arguments)
    except (UserError, OSError) as error:
        errors.put(error)
        sys.exit(1)
    except (MemoryError, RuntimeError) as error:
        if not lacks_memory(error):
            raise
        errors.put(MemoryError(str(error)))
        sys.exit(1)


def _work(
    local_rank: int,
    device: torch.device,
    group: dict[str, Any],
    function: Callable[..., None],
    arguments: tuple[object, ...],
) -> None:
    """Join the group, take the GPU of this process, and work."""
    prepare_process()
    if device.type == "cuda":
        torch.cuda.set_device(local_rank % torch.cuda.device_count())
    dist.init_process_group("cpu:gloo,cuda:nccl" if device.type == "cuda" else "gloo", timeout=_PATIENCE, **group)
    function(*arguments)
    dist.destroy_process_group()


def end_with_parent() -> None:
    """Let the system end this process when the one that started it ends, however that happens; on Linux alone.

    It ends at once where that one has ended already.
    """
    if platform.system() == "Linux":
        ctypes.CDLL(None).prctl(_END_WITH_PARENT, signal.SIGTERM)
    parent = multiprocessing.parent_process()
    if parent and not parent.is_alive():
        sys.exit(1)


@contextmanager
def process_pool(processes: int, purpose: str) -> Iterator[ProcessPoolExecutor]:
    """Start processes among which calls are divided, with equal parts of this one's threads.

    They end with the block, and where an exception leaves it, Ctrl-C for instance, in the middle of their calls. Raises
    ProcessKilled where one was killed; `purpose` says in its sentence what they do.
    """
    pool = ProcessPoolExecutor(processes, multiprocessing.get_context("spawn"), _begin)
    try:
        with _ignored(signal.SIGINT), divided_threads(processes):
            for _ in range(processes):
                pool.submit(int)  # starts one, which leaves Ctrl-C to this process from its first moment on
        yield pool
        pool.shutdown()
    except BaseException as error:
        with _ignored(*_ENDING):  # a second one would leave the pool half ended, and this process waiting for it
            for process in multiprocessing.active_children():
                process.terminate()
            pool.shutdown(cancel_futures=True)
        if isinstance(error, BrokenProcessPool):
            raise ProcessKilled(
                f"a process that {purpose} was killed, perhaps for want of memory; run the same command again"
            ) from None
        raise


def _begin() -> None:
    end_with_parent()
    prepare_process()


@contextmanager
def _ignored(*signals: signal.Signals) -> Iterator[None]:
    """Ignore signals inside the block, and let processes that are started there ignore them from then on."""
    before = {number: signal.signal(number, signal.SIG_IGN) for number in signals}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def divided_threads(processes: int) -> Iterator[None]:
    """Let the processes started inside the block have equal parts of this one's threads."""
    threads = str(max(1, torch.get_num_threads() // processes))
    before = dict(os.environ)
    os.environ.update(OMP_NUM_THREADS=threads, MKL_NUM_THREADS=threads, NUMBA_NUM_THREADS=threads)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)
