"""Settings of all stages of a run: looked at before its first stage starts, not hours later."""

from pathlib import Path
from typing import Any

from pipeline.config import load, scalar
from pipeline.device import resolve_device, resolve_memory, resolve_precision
from pipeline.evaluation.evaluate import EvaluateConfig
from pipeline.export.painting import PaintingConfig
from pipeline.export.report import ReportConfig
from pipeline.export.views import TurntableConfig
from pipeline.launch import resolve_processes
from pipeline.rows.entries import SHARED, require_chosen, settings_of
from pipeline.training.base_shape import BaseShapeConfig
from pipeline.training.features import FeaturesConfig
from pipeline.training.fine_tune import FineTuneConfig
from pipeline.training.full_trainer import FullTrainingConfig
from stages.evaluate_base_shape import EvaluateBaseShapeConfig
from stages.remesh import RemeshConfig

CONFIGS: dict[str, type[Any]] = {
    "train_features": FeaturesConfig,
    "learn_base_shape": BaseShapeConfig,
    "evaluate_base_shape": EvaluateBaseShapeConfig,
    "remesh": RemeshConfig,
    "train_full": FullTrainingConfig,
    "fine_tune": FineTuneConfig,
    "evaluate": EvaluateConfig,
    "report": ReportConfig,
}
"""What the stages of a run, after its photographs are prepared, read of params.yaml."""
_OF_MESHES: dict[str, type[Any]] = {"turntable": TurntableConfig, "paint": PaintingConfig}
"""What `kato3d reconstruct` reads besides."""


def require_settings(params: Path, row: str, size: str, ablation: str) -> None:
    """Raise ConfigError where a stage of such a run would, for a setting that is unknown, missing or out of range.

    So it does for a row, size or ablation that does not exist.
    """
    require_chosen(params, row, size, ablation)
    device = resolve_device(scalar(params, "device"))
    resolve_precision(scalar(params, "precision"), device)
    resolve_memory(scalar(params, "memory"))
    for stage in SHARED:
        resolve_processes(scalar(params, f"processes.{stage}"), device, parts=1)
    for stage, config in CONFIGS.items():
        load(params, config, settings_of(stage, row, size, ablation))
    for section, config in _OF_MESHES.items():
        load(params, config, [section])
