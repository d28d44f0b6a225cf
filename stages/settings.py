"""Settings of all stages of a run or baseline: looked at before the first one starts, not hours later."""

from pathlib import Path
from typing import Any

from pipeline.config import entries, load, scalar
from pipeline.evaluation.colmap import ColmapConfig
from pipeline.evaluation.evaluate import EvaluateConfig
from pipeline.export.painting import PaintingConfig
from pipeline.export.report import ReportConfig
from pipeline.export.views import TurntableConfig
from pipeline.launch import resolve_processes
from pipeline.rows.entries import SHARED, require_chosen
from pipeline.rows.options import BASELINES, Options
from pipeline.training.base_shape import BaseShapeConfig
from pipeline.training.features import FeaturesConfig
from pipeline.training.fine_tune import FineTuneConfig
from pipeline.training.full_trainer import FullTrainingConfig
from pipeline.training.hologan import HoloGANTrainingConfig
from stages.evaluate_base_shape import EvaluateBaseShapeConfig
from stages.machine import load_machine
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
_OF_BASELINES: dict[str, dict[str, type[Any]]] = {
    "hologan": {
        "train_features": FeaturesConfig,
        "train_hologan": HoloGANTrainingConfig,
        "evaluate": EvaluateConfig,
    },
    "colmap": {"evaluate_colmap": ColmapConfig},
}
"""What the stages of a baseline read, after its photographs are prepared."""


def require_settings(params: Path, options: Options) -> None:
    """Raise ConfigError where a stage of such a run would, for a setting that is unknown, missing or out of range.

    So it does for a row, size or ablation that does not exist.
    """
    require_chosen(params, options.row, options.size, options.ablation)
    device = load_machine(params).device
    for stage in SHARED:
        resolve_processes(scalar(params, f"processes.{stage}"), device, parts=1)
    configs = CONFIGS | _OF_MESHES if options.baseline is None else _OF_BASELINES[options.baseline]
    for stage, config in configs.items():
        load(params, config, options.sections(stage))


def require_settings_of_all(params: Path) -> None:
    """Raise ConfigError where a stage of a run, base shape or baseline that is on would, as `require_settings` does."""
    for entry in (*entries(params, "base_shapes").values(), *entries(params, "runs").values()):
        require_settings(params, Options(entry["row"], entry["size"], entry["ablation"]))
    any_row = next(iter(entries(params, "rows")))  # which changes no setting of a baseline
    for baseline in BASELINES:
        for entry in entries(params, baseline).values():
            require_settings(params, Options(any_row, entry["size"], baseline=baseline))
