"""dvc.yaml says what the stages run, read and write, and nothing else does."""

import re
import shlex
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from pipeline.cli.measured_runs import measured_runs
from pipeline.cli.runs import Run, photographs_file, truth_folder
from pipeline.files import write_json
from pipeline.rows.entries import settings_of
from stages.machine import Machine
from stages.settings import CONFIGS
from tests.project.import_closure import ROOT, TRAINING, code_dependencies, import_closure, stage_bodies

DOCUMENT = YAML(typ="safe").load(ROOT / "dvc.yaml")
PARAMS = YAML(typ="safe").load(ROOT / "params.yaml")
STAGES = stage_bodies(DOCUMENT)
BASELINES = ["train_hologan", "evaluate_hologan", "evaluate_colmap"]
MIDDLE = ["evaluate_base_shape", "remesh"]
CHAIN = ["prepare_data", *TRAINING[:2], *MIDDLE, *TRAINING[2:4], "evaluate", "report", *BASELINES]


def _options(stage: str) -> dict[str, list[str]]:
    options: dict[str, list[str]] = {}
    for word in shlex.split(STAGES[stage]["cmd"].replace("${", "{"))[3:]:
        if word.startswith("--"):
            options[word] = []
        else:
            options[list(options)[-1]].append(word)
    return options


def _outs(stage: str) -> dict[str, dict[str, Any]]:
    outs = STAGES[stage]["outs"]
    return {name: flags for out in outs for name, flags in (out if isinstance(out, dict) else {out: {}}).items()}


def test_the_chain_is_complete() -> None:
    assert list(STAGES) == CHAIN


@pytest.mark.parametrize("stage", CHAIN)
def test_code_dependencies_are_the_import_closure(stage: str) -> None:
    assert code_dependencies(STAGES[stage]) == import_closure(f"stages.{stage}"), "run `make dependencies`"


def test_all_settings_of_a_run_are_looked_at_before_it_starts() -> None:
    assert list(CONFIGS) == [stage for stage in CHAIN if stage not in ("prepare_data", *BASELINES)]
    for stage in CONFIGS:
        sections = settings_of(stage, "{item.row}", "{item.size}", "{item.ablation}")
        assert sections == _options(stage)["--sections"]


@pytest.mark.parametrize("stage", CHAIN)
def test_parameters_are_the_sections_read(stage: str) -> None:
    script = (ROOT / "stages" / f"{stage}.py").read_text()
    scalars = [
        name.replace("{arguments.", "${item.")
        for name in re.findall(r'scalar\(arguments\.params, f?"([\w.{}]+)"\)', script)
    ]
    if "load_machine(arguments.params)" in script:
        scalars += Machine._fields
    sections = [section.replace("{", "${") for section in _options(stage)["--sections"]]
    assert sorted(STAGES[stage]["params"]) == sorted(sections + scalars)


@pytest.mark.parametrize("stage", CHAIN)
def test_every_path_of_a_command_is_a_dependency_an_output_or_restart_state(stage: str) -> None:
    known = [path for path in STAGES[stage]["deps"] if not path.endswith(".py")] + list(_outs(stage))
    for option, values in _options(stage).items():
        for path in (value.replace("{", "${") for value in values if "/" in value):
            declared = any(path == one or path.startswith(f"{one}/") for one in known)
            assert declared or (option == "--checkpoints" and path.startswith(".checkpoints/")), path


@pytest.mark.parametrize("stage", CHAIN)
def test_what_git_keeps_is_not_cached_and_stands_apart(stage: str) -> None:
    for out, flags in _outs(stage).items():
        in_git = re.match(r"results/(metrics|curves|tables|figures)/", out) is not None
        assert in_git == (flags.get("cache", True) is False), out


@pytest.mark.parametrize("stage", CHAIN)
def test_stages_are_described_and_thin(stage: str) -> None:
    assert STAGES[stage]["desc"]
    assert len((ROOT / "stages" / f"{stage}.py").read_text().splitlines()) <= 70


@pytest.mark.parametrize("stage", [*TRAINING, "remesh", "report", "evaluate_colmap"])
def test_what_does_not_measure_never_reads_the_truth(stage: str) -> None:
    assert "truth" not in STAGES[stage]["cmd"]
    assert not any("truth" in dependency for dependency in STAGES[stage]["deps"])


def test_what_runs_name_is_on() -> None:
    for name, run in PARAMS["runs"].items():
        assert run["row"] in PARAMS["rows"], name
        assert run["dataset"] in PARAMS["datasets"], name
        assert PARAMS["features"][run["features"]]["dataset"] == run["dataset"], name
        base_shape = PARAMS["base_shapes"][run["base_shape"]]
        own = {"ablation": run["ablation"], "base_shape": run["base_shape"]}
        if "-around-" not in name:  # another run's base shape
            assert base_shape | own == run | {"chosen": base_shape["chosen"]}, name


def test_no_artifact_path_stands_in_the_code() -> None:
    pattern = re.compile(r"""["'](data|models|results)/|/ ["'](data|models|results)["']""")
    known = {ROOT / "pipeline/cli/runs.py", ROOT / "pipeline/cli/measured_runs.py"}
    files = {*ROOT.glob("pipeline/**/*.py"), *ROOT.glob("stages/*.py")} - known
    colmap = ["pipeline/evaluation/colmap.py"]  # names folders of its own
    assert [file.relative_to(ROOT).as_posix() for file in files if pattern.search(file.read_text())] == colmap


def test_the_command_looks_where_stages_write(tmp_path: Path) -> None:
    run = Run(tmp_path, "${key}", "laptop", "toybox", "${key}")
    for stage, artifact, file in (
        ("train_full", "model", "models/full/${key}.safetensors"),
        ("train_features", "features", "models/features/${key}.safetensors"),
        ("report", "page", "results/report/${key}/index.html"),
    ):
        path = tmp_path / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
        assert getattr(run, artifact) == path
        assert file.removesuffix("/index.html") in _outs(stage)
    (tmp_path / "data/truth/${key}").mkdir(parents=True)
    assert truth_folder(tmp_path, "${key}").relative_to(tmp_path).as_posix() in _outs("prepare_data")
    file = photographs_file(tmp_path, "${item.dataset}", "test", "${item.category}")
    assert file.relative_to(tmp_path).as_posix() in STAGES["evaluate"]["deps"]
    assert "results/metrics/${key}.json" in _outs("evaluate")
    write_json(tmp_path / "results/metrics/car.json", {"reconstruction": {}})
    write_json(tmp_path / "results/metrics/car-colmap.json", {"multiview": {}})
    assert [measured.name for measured in measured_runs(tmp_path)] == ["car"]


def test_the_closure_follows_imports_inside_functions_and_takes_named_scripts(tmp_path: Path) -> None:
    (tmp_path / "stages").mkdir()
    (tmp_path / "pipeline" / "inner").mkdir(parents=True)
    (tmp_path / "stages" / "work.py").write_text("import os\nfrom pipeline import first\n")
    (tmp_path / "pipeline" / "first.py").write_text("def late():\n    from pipeline.inner.second import thing\n")
    for script in ("page.js", "other.js"):
        (tmp_path / "pipeline" / "inner" / script).touch()
    (tmp_path / "pipeline" / "inner" / "second.py").write_text('import pipeline.first\nSCRIPT = "page.js"\n')
    (tmp_path / "pipeline" / "inner" / "unused.py").touch()
    expected = ["pipeline/first.py", "pipeline/inner/page.js", "pipeline/inner/second.py", "stages/work.py"]
    assert import_closure("stages.work", tmp_path) == expected
