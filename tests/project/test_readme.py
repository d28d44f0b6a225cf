"""The README says what is there: its rows, commands, links and figures."""

import re
from typing import Any

import pytest
from ruamel.yaml import YAML

from pipeline.files import read_json
from tests.project.import_closure import ROOT

README = (ROOT / "README.md").read_text()
PARAMS = YAML(typ="safe").load(ROOT / "params.yaml")
MAKEFILE = (ROOT / "Makefile").read_text()
FIGURE = re.compile(r"^\| `([\w-]+)` \| `([\w.]+)` \| ([-\d.]+)(?: ± ([\d.]+))? \| (\d*) \|$", re.MULTILINE)


def test_every_row_size_and_ablation_is_named() -> None:
    names = [*PARAMS["rows"], *PARAMS["sizes"], *PARAMS["ablations"]]
    assert [name for name in names if name != "none" and not re.search(rf"[`=]{name}\b", README)] == []


def test_every_command_exists() -> None:
    for target in re.findall(r"\bmake (\w+)", README):
        assert re.search(rf"^{target}:", MAKEFILE, re.MULTILINE), target
    for kind, key in (("ROW", "rows"), ("SIZE", "sizes"), ("ABLATION", "ablations")):
        for name in re.findall(rf"{kind}=([\w-]+)", README):
            assert name in PARAMS[key], name


def test_every_example_of_a_parameter_exists() -> None:
    for key in re.findall(r"-S ([\w.]+)=", README):
        section: Any = PARAMS
        *sections, last = key.split(".")
        for name in sections:
            section = section[name]
        assert last in section, key


@pytest.mark.parametrize("page", ["README.md", *(f"docs/{path.name}" for path in ROOT.glob("docs/*.md"))])
def test_every_link_leads_somewhere(page: str) -> None:
    for target in re.findall(r"\]\((?!http)([^)#]+)\)", (ROOT / page).read_text()):
        assert ((ROOT / page).parent / target).exists(), target


def test_every_measured_run_is_shown() -> None:
    measured = {path.stem for path in ROOT.glob("results/metrics/*.json")}
    assert measured == {run for run, *_ in FIGURE.findall(README)}


def test_figures_are_those_of_the_files() -> None:
    for run, figure, value, error, n in FIGURE.findall(README):
        section: Any = None
        measured: Any = read_json(ROOT / "results" / "metrics" / f"{run}.json")
        for name in figure.split("."):
            section, measured = measured, measured[name]
        if not isinstance(measured, dict):  # acc_pi6 stands beside its n and standard error
            measured = {**section, "value": measured}
        decimals = len(value.partition(".")[2])
        assert value == f"{measured['value']:.{decimals}f}", (run, figure)
        assert not error or error == f"{measured['standard_error']:.{decimals}f}", (run, figure)
        assert not n or int(n) == measured["n"], (run, figure)
