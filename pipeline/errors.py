"""Errors whose message is written for the person at the terminal."""


class UserError(Exception):
    """Report something the user can put right.

    The message is one clear sentence: what is wrong, where, what was expected and what to do. Stage scripts print
    it without a traceback and exit with status 1.
    """


class ConfigError(UserError):
    """Report a parameter that is unknown, missing or of the wrong type."""


class DataError(UserError):
    """Report input data that cannot be used: unreadable, incomplete, of the wrong size or from the wrong place."""


class MeshError(UserError):
    """Report a mesh that is not what the pipeline needs: closed, of genus 0 and mirror-symmetric."""


class ProcessKilled(UserError):
    """Report that one of the processes that share a training was killed from outside."""


class TrainingDiverged(UserError):
    """Report a loss that is no longer finite; what was saved before it is kept."""


class DeviceError(UserError):
    """Report a machine that cannot do what it was asked to: a GPU without the compiler of its kernels."""
