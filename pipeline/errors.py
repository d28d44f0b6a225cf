"""Errors whose message is written for the person at the terminal, and how they get there."""

import errno
import os
import select
import sys
from collections.abc import Iterator
from contextlib import contextmanager

_OUTSIDE = {
    errno.EACCES,
    errno.EDQUOT,
    errno.EEXIST,
    errno.EIO,
    errno.EISDIR,
    errno.ELOOP,
    errno.ENAMETOOLONG,
    errno.ENOENT,
    errno.ENOSPC,
    errno.ENOTDIR,
    errno.EPERM,
    errno.EROFS,
}
"""What a file system refuses for reasons that lie outside of the program."""
STOPPED = "stopped; the same command goes on where it can\n"
"""What a program that is stopped from outside says."""
_INTERRUPTED = 130
"""Status of a program that was stopped by Ctrl-C."""
_UNREAD = 141
"""Status of a program whose output nobody reads any more, as after `| head`."""


class UserError(Exception):
    """Report something the user can put right.

    The message is one clear sentence: what is wrong, where, what was expected and what to do. Stage scripts print
    it without a traceback and exit with status 1.
    """


class ConfigError(UserError):
    """Report a parameter that is unknown, missing, of the wrong type or out of range."""


class DataError(UserError):
    """Report input data that cannot be used: unreadable, incomplete, of the wrong size or from the wrong place."""


class MeshError(UserError):
    """Report a mesh that is not what the pipeline needs: closed, of genus 0 and mirror-symmetric."""


class ProcessKilled(UserError):
    """Report that one of the processes that share some work was ended by a signal."""


class TrainingDiverged(UserError):
    """Report a loss that is no longer finite; what was saved before it is kept."""


class DeviceError(UserError):
    """Report a machine that cannot do what it was asked to: a GPU without the compiler of its kernels."""


@contextmanager
def in_one_sentence() -> Iterator[None]:
    """End the program with one sentence and status 1, without a traceback, for what the user can put right.

    That is any UserError, files that cannot be read or written, and memory that does not suffice. Ctrl-C ends it with
    status 130, a closed pipe with 141.
    """
    try:
        with _unwrapped():
            yield
        _flush()
    except UserError as error:
        sys.exit(f"error: {error}")
    except BrokenPipeError:
        if not _is_unread(sys.stdout.fileno()):
            raise
        # What is still to be printed, which Python tries once more at its end, goes nowhere.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(_UNREAD)
    except (OSError, MemoryError, RuntimeError) as error:
        if lacks_memory(error):
            reason = str(error).partition("\n")[0]
            sys.exit(
                f"error: there is not enough memory ({reason}); lower `memory` or this stage's batch_size in "
                "params.yaml"
            )
        if not isinstance(error, OSError) or error.errno not in _OUTSIDE:
            raise
        where = f"{error.filename}: " if error.filename else ""
        sys.exit(f"error: {where}{error.strerror}; look at the path, its permissions and the space that is left")
    except KeyboardInterrupt:
        sys.stderr.write(STOPPED)
        sys.exit(_INTERRUPTED)


@contextmanager
def _unwrapped() -> Iterator[None]:
    """Raise what was raised inside of a kernel of numba, as by Ctrl-C, which arrives as the cause of SystemErrors."""
    try:
        yield
    except SystemError as error:
        inner: BaseException = error
        while isinstance(inner, SystemError) and inner.__cause__ is not None:
            inner = inner.__cause__
        raise inner from None


def _flush() -> None:
    if sys.stdout is not None:  # as it is after `>&-`
        sys.stdout.flush()


def _is_unread(stream: int) -> bool:
    """Tell whether the other end of a pipe is closed."""
    poll = select.poll()
    poll.register(stream, 0)
    return any(event & select.POLLERR for _, event in poll.poll(0))


def lacks_memory(error: Exception) -> bool:
    """Tell whether NumPy, the system, PyTorch on a CPU or PyTorch on a GPU could not allocate."""
    if isinstance(error, OSError):
        return error.errno == errno.ENOMEM
    return isinstance(error, MemoryError) or any(
        words in str(error) for words in ("can't allocate memory", "CUDA out of memory")
    )
