"""Entries of params.yaml: what is on, and what rows, sizes and ablations change."""

from collections.abc import Mapping
from pathlib import Path

from pipeline.config import entries, require_known
from pipeline.errors import ConfigError

_LEARNED = ("size", "seed", "dataset", "category", "features")
NAMES: Mapping[str, tuple[str, ...]] = {
    "features": ("dataset", "size", "seed", "weights"),
    "base_shapes": ("row", "ablation", "chosen", *_LEARNED),
    "runs": ("row", "ablation", "base_shape", *_LEARNED),
    "hologan": _LEARNED,
    "colmap": _LEARNED,
    "rows": ("dataset", "category"),
    "sizes": (),
    "ablations": (),
}
"""Values of the entries of each section."""
_STAGES: Mapping[str, tuple[str, ...]] = {
    "rows": ("learn_base_shape", "train_full"),
    "sizes": ("train_features", "learn_base_shape", "train_full", "fine_tune", "train_hologan"),
    "ablations": ("learn_base_shape", "train_full"),
}
"""Stages whose settings the entries of a section change."""


def require_whole_entries(path: Path) -> None:
    """Raise ConfigError for an entry that lacks a key or has one that nothing reads, with the nearest one.

    What stages' settings hold is looked at by the stages.
    """
    for section, names in NAMES.items():
        stages = _STAGES.get(section, ())
        for name, entry in entries(path, section).items():
            for key in entry:
                require_known(key, (*names, *stages), f"{path}: {section}.{name} has no")
            for key in (*names, *stages):
                if key not in entry:
                    raise ConfigError(f"{path} has no '{section}.{name}.{key}'; write it as its neighbours have it")
                if isinstance(entry[key], dict) != (key in stages):
                    kind = "a section of keys and values, {} where it changes nothing" if key in stages else "one value"
                    raise ConfigError(f"{path}: '{section}.{name}.{key}' must be {kind}, not {entry[key]!r}")
