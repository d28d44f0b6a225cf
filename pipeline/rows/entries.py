"""Names in params.yaml that no stage's settings hold: what is on, and what rows, sizes and ablations change."""

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pipeline.config import entries, names, scalar
from pipeline.errors import ConfigError
from pipeline.naming import is_plain, require_known

_TOP = ("device", "precision", "memory", "processes", "weights", "datasets")
"""Names at the top of the file, besides those of entries and of stages."""
_SETTINGS = (
    *("prepare_data", "train_features", "learn_base_shape", "evaluate_base_shape", "remesh", "train_full", "fine_tune"),
    *("evaluate", "report", "turntable", "paint", "train_hologan", "evaluate_colmap"),
)
"""Sections of stages' settings, and of those of `kato3d reconstruct`."""
SHARED = ("train_features", "learn_base_shape", "train_full")
"""Stages whose work several processes can share."""
_LEARNED = ("size", "seed", "dataset", "category", "features")
NAMES: Mapping[str, tuple[str, ...]] = {
    "features": ("dataset", "size", "seed", "weights"),
    "base_shapes": ("row", "ablation", "chosen", *_LEARNED),
    "runs": ("row", "ablation", "base_shape", *_LEARNED),
    "hologan": _LEARNED,
    "colmap": ("size", "seed", "dataset", "category"),
    "rows": ("dataset", "category"),
    "sizes": (),
    "ablations": (),
    "pretrained": ("model", "features", "size", "fit"),
}
"""Values of the entries of each section."""
_STAGES: Mapping[str, tuple[str, ...]] = {
    "rows": ("learn_base_shape", "train_full"),
    "sizes": ("train_features", "learn_base_shape", "train_full", "fine_tune", "train_hologan"),
    "ablations": ("learn_base_shape", "train_full"),
}
"""Stages whose settings the entries of a section change."""


_Kind = tuple[Callable[[Any], bool], str]
"""Whether a value is of the kind, and what a sentence calls it."""
_SECTION: _Kind = (lambda value: isinstance(value, dict), "a section of keys and values, {} where it changes nothing")
_NAME: _Kind = (lambda value: isinstance(value, str), "text")
_VALUES: Mapping[str, _Kind] = {
    "seed": (lambda value: type(value) is int, "a whole number"),
    "chosen": (lambda value: re.fullmatch(r"score|\d+", str(value)) is not None, "'score' or the number of a shape"),
}
"""Kinds of the values that are no names."""


def settings_of(stage: str, row: str, size: str, ablation: str) -> list[str]:
    """Name the sections that a stage's settings are merged from: its own, then what row, size and ablation change."""
    chosen = {"rows": row, "sizes": size, "ablations": ablation}
    return [stage, *(f"{section}.{name}.{stage}" for section, name in chosen.items() if stage in _STAGES[section])]


def require_chosen(path: Path, row: str, size: str, ablation: str) -> None:
    """Raise ConfigError, with the nearest name, for a row, size or ablation that the file does not have."""
    for section, name in (("rows", row), ("sizes", size), ("ablations", ablation)):
        require_known(name, entries(path, section), f"{path}: {section} has no")


def require_whole_entries(path: Path) -> None:
    """Raise ConfigError for a name that nothing reads, with the nearest one, and for an entry that lacks a key.

    What stages' settings hold is looked at by the stages.
    """
    for name in names(path):
        require_known(name, (*_TOP, *_SETTINGS, *NAMES), f"{path}: nothing reads")
    processes = scalar(path, "processes") if "processes" in names(path) else None
    for name in processes if isinstance(processes, dict) else ():
        require_known(name, SHARED, f"{path}: processes has no")
    for section, values in NAMES.items():
        stages = _STAGES.get(section, ())
        for name, entry in entries(path, section).items():
            if not (isinstance(name, str) and is_plain(name)):
                raise ConfigError(f"{path}: {section} has the name {name!r}; expected letters, digits, _ and -")
            for key in entry:
                require_known(key, (*values, *stages), f"{path}: {section}.{name} has no")
            for key in (*values, *stages):
                if key not in entry:
                    raise ConfigError(f"{path} has no '{section}.{name}.{key}'; write it as its neighbours have it")
                fits, words = _SECTION if key in stages else _VALUES.get(key, _NAME)
                if not fits(entry[key]):
                    raise ConfigError(f"{path}: '{section}.{name}.{key}' must be {words}, not {entry[key]!r}")
