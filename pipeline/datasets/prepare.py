"""Read a dataset from wherever it comes."""

from dataclasses import dataclass
from typing import Literal

from pipeline.datasets.prepared import Dataset
from pipeline.datasets.toybox.toybox import ToyboxConfig, make_toybox


@dataclass(frozen=True)
class PrepareConfig:
    """Say where pictures come from and what is made of them.

    Attributes:
        kind: what the source is.
        source: path of the source.
        toybox: used by the kind `toybox`, which makes its pictures itself.
    """

    kind: Literal["toybox"]
    source: str
    toybox: ToyboxConfig


def prepare(config: PrepareConfig) -> Dataset:
    """Read the whole dataset. Raises DataError, naming file and remedy, for anything that cannot be used."""
    return make_toybox(config.toybox)
