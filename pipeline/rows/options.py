"""What a user asks to be run, and the settings it has."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from pipeline.config import load
from pipeline.rows.entries import settings_of
from pipeline.training.full_trainer import FullTrainingConfig

BASELINES = ("hologan", "colmap")


class Options(NamedTuple):
    """What is to be run."""

    row: str
    """An entry of `rows`."""
    size: str = "laptop"
    """An entry of `sizes`."""
    ablation: str = "none"
    """An entry of `ablations`."""
    seed: int = 0
    source: Path | None = None
    """Folder or archive of the photographs; None where they are on."""
    features: Path | None = None
    """Weights of the network that compares pictures; None for those of its size."""
    dataset: str | None = None
    """A name for the photographs; None for the row's."""
    category: str | None = None
    """The one among them; None for the row's."""
    base_shape: str | None = None
    """An entry of `base_shapes` to train around; None for one that is learned from the same photographs."""
    baseline: str | None = None
    """What is measured on the photographs instead."""

    def sections(self, stage: str) -> list[str]:
        """Name the sections that a stage's settings are merged from."""
        return settings_of(stage, self.row, self.size, self.ablation)

    def full_training(self, path: Path) -> FullTrainingConfig:
        """Load the settings of full training."""
        return load(path, FullTrainingConfig, self.sections("train_full"))

    def base_shape_ablation(self, document: Mapping[str, Any]) -> str:
        """Return the ablation with which the base shape is learned: none where it does not change that."""
        return self.ablation if document["ablations"][self.ablation]["learn_base_shape"] else "none"
