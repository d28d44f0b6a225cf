"""The README says what is there: its rows, commands, links and figures."""

import hashlib
import os
import re
import shlex
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from pipeline.cli.__main__ import _parser
from pipeline.export.runs_page import MeasuredRun
from pipeline.files import read_json, write_json
from pipeline.rows.options import BASELINES
from tests.project.import_closure import ROOT
from tests.project.result_tables import (
    MARKED,
    PAGES,
    TABLES,
    Confusion,
    Table,
    render,
    unpack_staged,
    with_tables,
)

README = (ROOT / "README.md").read_text()
PARAMS = YAML(typ="safe").load(ROOT / "params.yaml")
MAKEFILE = (ROOT / "Makefile").read_text()


@pytest.fixture(autouse=True)
def without_outer_make(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let `make` see its own words alone, not those of the `make test` around it, and take itself for the first."""
    for name in ("MAKEFLAGS", "MAKELEVEL"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture(scope="module")
def committed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Unpack pages and figures as git would commit them now."""
    folder = tmp_path_factory.mktemp("committed")
    results = (f"results/{part}" for part in ("metrics", "tables", "curves", "figures/base_shapes"))
    unpack_staged(folder, "README.md", "data/README.md", "docs", "dvc.lock", *results)
    return folder


def test_every_row_size_and_ablation_is_named() -> None:
    names = {*PARAMS["rows"], *PARAMS["sizes"], *PARAMS["ablations"]} - {"none"}
    shipped = [name for name in names if not name.startswith("my-")]  # as those of users are called
    assert [name for name in shipped if not re.search(rf"[`=]{name}(?![\w-])", README)] == []


def test_every_command_line_is_understood() -> None:
    text = "\n".join(re.sub(r"\\\n", " ", (ROOT / page).read_text()) for page in PAGES)
    lines = re.findall(r"^(?:\.venv/bin/)?kato3d (.*)$", text, re.MULTILINE)
    commands = {_parser().parse_args(shlex.split(line, comments=True)).command.__name__ for line in lines}
    assert commands == {"_arrange", "_reconstruct", "_view", "_runs", "_benchmark", "_doctor"}


def test_every_command_exists() -> None:
    for target in re.findall(r"\bmake (\w+)", README):
        assert re.search(rf"^{target}:", MAKEFILE, re.MULTILINE), target
    for kind, key in (("ROW", "rows"), ("SIZE", "sizes"), ("ABLATION", "ablations")):
        for name in re.findall(rf"{kind}=([\w-]+)", README):
            assert name in PARAMS[key], name


def test_options_are_words_after_make_alone() -> None:
    environment = os.environ | {"SEED": "7", "CATEGORY": "plane", "BASELINE": "colmap"}
    words = ["make", "--dry-run", "--no-print-directory", "run", "ROW=toybox-car", "SEED=", "SIZE=paper"]
    made = subprocess.run(words, cwd=ROOT, env=environment, check=True, stdout=subprocess.PIPE, text=True).stdout
    assert made.splitlines()[-2:] == [
        'python -m stages.run_row --row="$ROW" --size="$SIZE"',
        "kato3d runs > /dev/null",
    ]


def test_what_make_does_alone_begins_with_new_settings_and_ends_with_the_table_of_all_runs() -> None:
    words = ["make", "--dry-run", "--no-print-directory", "--what-if=params.yaml", "repro"]
    made = subprocess.run(words, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True).stdout
    assert made.splitlines()[-4:] == [
        "python -m stages.check_settings",
        "touch .venv/.settings_checked",
        "dvc repro",
        "kato3d runs > /dev/null",
    ]


def test_baselines_alone_are_installed_for() -> None:
    assert f"$(filter-out {' '.join(BASELINES)}," in MAKEFILE
    for baseline in ("hologram", "hologan colmap"):
        words = ["make", "--dry-run", "run", "ROW=toybox-car", f"BASELINE={baseline}"]
        made = subprocess.run(words, cwd=ROOT, stderr=subprocess.PIPE, text=True, check=False)
        assert made.returncode == 2
        assert f"BASELINE is {baseline}; expected hologan or colmap" in made.stderr


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["ROW=toybox-car", "SORCE=x", "PYTHON=python3"], "SORCE is no option of make run; expected: ROW SIZE SOURCE"),
        (["SEED=3"], "name a row: make run ROW=toybox-car"),
    ],
)
def test_wrong_words_after_make_run_are_told_before_the_installation(
    words: list[str], sentence: str, tmp_path: Path
) -> None:
    shutil.copy(ROOT / "Makefile", tmp_path)
    made = subprocess.run(["make", "run", *words], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert made.returncode == 2
    assert sentence in made.stderr
    assert made.stdout == ""


def test_options_of_make_run_are_errors_elsewhere() -> None:
    words = ["make", "--dry-run", "repro", "ROW=toybox-horse", "SEED=3"]
    made = subprocess.run(words, cwd=ROOT, stderr=subprocess.PIPE, text=True, check=False)
    assert made.returncode == 2
    assert "ROW is an option of make run: make run ROW=toybox-horse SEED=3" in made.stderr


def test_an_interpreter_that_is_too_old_is_named(tmp_path: Path) -> None:
    old = tmp_path / "python3.10"
    old.write_text("#!/bin/sh\nexit 1\n")
    old.chmod(0o755)
    for name in ("Makefile", "constraints.txt", "pyproject.toml"):
        shutil.copy(ROOT / name, tmp_path)
    words = ["make", "install", f"PYTHON={old}"]
    made = subprocess.run(words, cwd=tmp_path, stderr=subprocess.PIPE, text=True, check=False)
    assert "Python 3.11 to 3.13 is needed; name one, such as PYTHON=python3.12" in made.stderr
    assert not (tmp_path / ".venv").exists()


@pytest.mark.parametrize("moved", [False, True])
def test_an_environment_that_was_moved_is_set_up_anew(tmp_path: Path, moved: bool) -> None:
    for name in ("Makefile", "constraints.txt", "pyproject.toml"):
        shutil.copy(ROOT / name, tmp_path)
    (tmp_path / ".venv").mkdir()
    (tmp_path / ".venv/.installed").write_text(f"{tmp_path / 'before' if moved else tmp_path}\n")
    subprocess.run(["make", "help"], cwd=tmp_path, check=True, stdout=subprocess.PIPE)
    assert (tmp_path / ".venv").exists()
    words = ["make", "install", "PYTHON=false"]
    made = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert made.returncode == (2 if moved else 0)
    assert (tmp_path / ".venv").exists() != moved


@pytest.mark.parametrize("page", PAGES)
def test_every_example_of_a_parameter_exists(page: str) -> None:
    for key in re.findall(r"-S\s+'?([\w.-]+)=", (ROOT / page).read_text()):
        section: Any = PARAMS | {"rows": PARAMS["rows"] | {"my-row": PARAMS["rows"]["cifar10-automobile"]}}
        *sections, last = key.split(".")
        for name in sections:
            section = section[name]
        assert last in section, key


@pytest.mark.parametrize("page", PAGES)
def test_every_link_leads_somewhere(page: str) -> None:
    for target, anchor in re.findall(r"\]\((?!http)([^)#]*)#?([^)]*)\)", (ROOT / page).read_text()):
        path = (ROOT / page).parent / target if target else ROOT / page
        assert path.exists(), target
        assert not anchor or anchor in anchors(path), f"{target}#{anchor}"


def pages(folder: Path) -> list[Path]:
    """List the unpacked pages."""
    return sorted(folder.rglob("*.md"))


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_every_measured_run_is_shown(committed: Path) -> None:
    results = committed / "results"
    measured = {MeasuredRun(path.stem, None, {}).experiment for path in results.glob("metrics/*.json")}
    shown = "".join(found[0] for page in pages(committed) for found in MARKED.finditer(page.read_text()))
    assert measured
    assert {name for name in measured if f"| `{name}` |" not in shown} == set()


def test_tables_are_those_of_the_files(committed: Path) -> None:
    assert len(pages(committed)) > 10
    for page in pages(committed):
        text = page.read_text()
        assert text == with_tables(text, committed / "results"), f"run `make tables` and commit {page.name}"


@pytest.mark.parametrize(
    ("run", "key"),
    [
        ("toybox-car", "pose.test.acc_pi6"),
        ("toybox-car", "shape.final_base.voxel_iou"),
        ("stanford-car", "pose.test.acc_pi6"),
        ("stanford-car", "pose.train.acc_pi6"),
        ("toybox-horse", "pose.test.acc_pi6"),
    ],
)
def test_the_text_says_the_figures_of_the_files(run: str, key: str, committed: Path) -> None:
    files = [committed / f"results/metrics/{run}{seed}.json" for seed in ("", "-seed1", "-seed2")]
    seeds = [MeasuredRun(run, None, read_json(file)).by_name()[key]["value"] for file in files]
    *each, mean = (f"{value:.3f}".removeprefix("0") for value in (*seeds, sum(seeds) / 3))
    text = " ".join((committed / "README.md").read_text().split())
    assert f"{mean} ({', '.join(each)})" in text


def test_the_lock_knows_the_files(committed: Path) -> None:
    lock = YAML(typ="safe").load(committed / "dvc.lock")
    known = {out["path"]: out for stage in lock["stages"].values() for out in stage["outs"] if "nfiles" not in out}
    files = {path: out for path, out in known.items() if (committed / path).is_file()}
    assert "results/metrics/toybox-car.json" in files
    for path, out in files.items():
        data = (committed / path).read_bytes()
        assert hashlib.md5(data, usedforsecurity=False).hexdigest() == out["md5"], path


def test_a_table_shows_the_mean_over_seeds(tmp_path: Path) -> None:
    for name, value in (("car", 0.5), ("car-seed1", 0.7), ("horse", 0.25)):
        section = {
            "acc_pi6": value,
            "n": 40,
            "standard_error": 0.1,
            "other": {"value": 3.0, "n": 40, "standard_error": 1.0},
        }
        write_json(tmp_path / "metrics" / f"{name}.json", {"pose": section})
    write_json(tmp_path / "metrics" / "ship.json", {"shape": {}})
    write_json(tmp_path / "metrics" / "tram.json", {"pose": {"acc_pi6": 0.5, "n": 40, "standard_error": 0.1}})
    table = Table("", ".*", {"accuracy": "pose.acc_pi6", "distance": "pose.other"})
    assert render(table, tmp_path).splitlines()[2:] == [
        "| `car` | 2 | 40 | 0.600 ± 0.141 | 3.0 ± 0.0 |",
        "| `horse` | 1 | 40 | 0.250 ± 0.100 | 3.0 ± 1.0 |",
        "| `tram` | 1 | 40 | 0.500 ± 0.100 | – |",
    ]


@pytest.mark.parametrize("table", [table for table in TABLES.values() if isinstance(table, Table)])
def test_every_column_of_a_table_is_measured_somewhere(table: Table, committed: Path) -> None:
    paths = (committed / "results/metrics" / table.folder).glob("*.json")
    measured = {key for path in paths for key in MeasuredRun(path.stem, None, read_json(path)).by_name()}
    assert set(table.columns.values()) <= measured


def test_a_confusion_counts_the_sides_of_all_seeds(tmp_path: Path) -> None:
    (tmp_path / "tables").mkdir()
    for name, read in (("car", (-10, 170)), ("car-seed1", (44, 95)), ("car-other", (180, 180))):
        rows = "".join(f"{true},{azimuth}\n" for true, azimuth in zip((10, 350), read, strict=True))
        (tmp_path / "tables" / f"{name}.csv").write_text(f"truth_azimuth,azimuth_tuned\n{rows}")
    table = render(Confusion("car", "azimuth_tuned"), tmp_path)
    assert "| front | 4 | 0.50 | 0.25 | 0.25 | 0.00 |\n" in table
    assert "| rear | 0 | 0.00 | 0.00 | 0.00 | 0.00 |\n" in table
