"""Names that users give: which are allowed, which are known, and which one was meant."""

import difflib
import re
from collections.abc import Collection, Iterable

from pipeline.errors import ConfigError


def did_you_mean(name: str, candidates: Iterable[str], prefix: str = "") -> str:
    """Return the end of a sentence that says no such name is known: the one nearest to it, or all of them."""
    names = sorted(map(str, candidates))
    near = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    if near:
        return f"; did you mean '{prefix}{near[0]}'?"
    return f"; expected one of: {', '.join(names)}" if names else ""


def is_plain(name: str) -> bool:
    """Tell whether a name can be a category's or a run's: a part of commands, of keys of params.yaml and of files."""
    return re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_-]*", name) is not None


def require_known(name: str, known: Collection[str], lack: str) -> None:
    """Raise ConfigError where a name is none of those known; `lack` begins its sentence."""
    if name not in known:
        raise ConfigError(f"{lack} '{name}'{did_you_mean(str(name), known)}")
