"""Settings of all stages are looked at before the first one starts."""

import re
from functools import reduce
from operator import getitem
from pathlib import Path

import pytest
import yaml

from pipeline.config import load
from pipeline.errors import ConfigError
from pipeline.rows.entries import require_whole_entries
from pipeline.rows.options import Options
from pipeline.training.base_shape import BaseShapeConfig
from stages import check_settings, run_row
from stages.settings import require_settings, require_settings_of_all


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("voxel_resolution: 32", "voxel_resolutions: 32", "did you mean"),
        ("score_batches: 32", "score_batches: 0", "learn_base_shape.score_batches"),
        ("texture_size: 64", "texture_size: 48", "texture_size' is 48; expected a whole number, a power of two from 4"),
        ("device: auto", "device: gpu", "device is 'gpu'; expected auto, cpu or cuda"),
        ("precision: auto", "precision: float16", "precision is 'float16'; expected auto, float32 or bfloat16"),
        ("memory: 8", "memory: -8", "memory is -8; expected a number of GiB above 0"),
        ("train_full: auto", "train_full: 0", "processes of a stage are 0; expected auto or a whole number from 1"),
        ("frames: 24", "frames: 0", "turntable.frames' is 0; expected a whole number"),
        ("photograph_size: 128", "photograph_sizes: 128", "paint.photograph_sizes'; did you mean 'photograph_size'"),
    ],
)
def test_settings_of_late_stages_are_looked_at_early(params: Path, old: str, new: str, message: str) -> None:
    usual = Options("toybox-car")
    require_settings(params, usual)
    text = params.read_text(encoding="utf-8")
    assert old in text
    params.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(ConfigError, match=message):
        require_settings(params, usual)


@pytest.mark.parametrize(
    ("baseline", "old", "message"),
    [
        ("colmap", "enlargement", "evaluate_colmap.enlargements'; did you mean 'enlargement'"),
        ("hologan", "generator_steps", "train_hologan.generator_stepss'; did you mean 'generator_steps'"),
    ],
)
def test_of_settings_a_baseline_needs_its_own(params: Path, baseline: str, old: str, message: str) -> None:
    text = params.read_text(encoding="utf-8").replace("\nfine_tune:\n", "\nfine_tune:\n  step: 3\n")
    params.write_text(text, encoding="utf-8")
    require_settings(params, Options("toybox-car", baseline=baseline))
    params.write_text(text.replace(f"{old}:", f"{old}s:"), encoding="utf-8")
    with pytest.raises(ConfigError, match=message):
        require_settings(params, Options("toybox-car", baseline=baseline))


def test_the_row_that_is_shown_to_newcomers_is_one(params: Path) -> None:
    page = (Path(__file__).parents[2] / "docs/your-own-photos.md").read_text(encoding="utf-8")
    (row,) = re.findall(r"```yaml\n(  (my-[a-z]+):.*?)```", page, re.DOTALL)
    text, name = row
    params.write_text(params.read_text(encoding="utf-8").replace("\nrows:\n", f"\nrows:\n{text}"), encoding="utf-8")
    require_whole_entries(params)
    require_settings(params, Options(name))
    config = load(params, BaseShapeConfig, Options(name).sections("learn_base_shape"))
    assert max(config.initial_dimensions) == 1  # as it says there


def _turn_on(params: Path, section: str, **entry: str) -> None:
    document = yaml.safe_load(params.read_text(encoding="utf-8"))
    document[section]["another"] = {"size": "laptop", "ablation": "none"} | entry
    params.write_text(yaml.safe_dump(document), encoding="utf-8")


@pytest.mark.parametrize(
    ("section", "entry", "stage", "old", "new"),
    [
        ("base_shapes", {"row": "toybox-horse"}, "rows.toybox-horse.learn_base_shape", "colors", "colours"),
        ("runs", {"row": "toybox-car", "ablation": "longer"}, "ablations.longer.train_full", "iterations", "iteration"),
        ("hologan", {}, "train_hologan", "generator_steps", "generator_step"),
        ("colmap", {}, "evaluate_colmap", "enlargement", "enlargements"),
    ],
)
def test_settings_of_all_that_is_on_are_looked_at(
    params: Path, section: str, entry: dict[str, str], stage: str, old: str, new: str
) -> None:
    document = yaml.safe_load(params.read_text(encoding="utf-8"))
    settings = reduce(getitem, stage.split("."), document)
    settings[new] = settings.pop(old)
    params.write_text(yaml.safe_dump(document), encoding="utf-8")
    require_settings_of_all(params)
    _turn_on(params, section, **entry)
    with pytest.raises(ConfigError, match=f"{new}'; did you mean '{old}'"):
        require_settings_of_all(params)


def test_a_wrong_setting_of_a_run_that_is_on_ends_make_repro_before_dvc_starts(
    params: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(params.parent)
    check_settings.main()
    params.write_text(params.read_text(encoding="utf-8").replace("\nfine_tune:\n", "\nfine_tune:\n  step: 3\n"))
    with pytest.raises(ConfigError, match=r"unknown key 'fine_tune\.step'"):
        check_settings.main()


def test_a_run_that_cannot_end_is_not_turned_on(params: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    params.write_text(params.read_text(encoding="utf-8").replace("\nfine_tune:\n", "\nfine_tune:\n  step: 3\n"))
    before = params.read_bytes()
    monkeypatch.chdir(params.parent)
    monkeypatch.setattr("sys.argv", ["run_row", "--row", "toybox-horse"])
    with pytest.raises(ConfigError, match=r"unknown key 'fine_tune\.step'"):
        run_row.main()
    assert params.read_bytes() == before
