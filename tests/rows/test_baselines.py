"""Baselines that are turned on beside runs."""

import shutil
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from pipeline.rows.options import Options
from pipeline.rows.turn_on import turn_on


@pytest.mark.parametrize("baseline", ["hologan", "colmap"])
def test_a_baseline_shares_the_settings_of_its_run(params: Path, baseline: str) -> None:
    name = turn_on(params, Options("toybox-car", seed=1))
    assert turn_on(params, Options("toybox-car", seed=1, baseline=baseline)) == name
    document = YAML(typ="safe").load(params)
    assert list(document[baseline]) == ["toybox-car-seed1"]
    run, entry = document["runs"][name], document[baseline][name]
    shared = ("size", "seed", "dataset", "category", *(["features"] if baseline == "hologan" else []))
    assert entry == {key: run[key] for key in shared}
    assert [document[other] for other in ("hologan", "colmap") if other != baseline] == [{}]


def test_a_baseline_can_be_turned_on_again(params: Path) -> None:
    params.write_text(params.read_text().replace("\nhologan: {}", "\nhologan:"))  # its only entry was deleted
    turn_on(params, Options("toybox-car", seed=1, baseline="hologan"))
    assert list(YAML(typ="safe").load(params)["hologan"]) == ["toybox-car-seed1"]


@pytest.mark.parametrize("baseline", ["hologan", "colmap"])
def test_a_baseline_turns_no_run_on(params: Path, photographs: Path, baseline: str) -> None:
    before = YAML(typ="safe").load(params)
    options = Options("toybox-car", dataset="mine", category="van", source=photographs, baseline=baseline)
    assert turn_on(params, options) == "mine-van"
    document = YAML(typ="safe").load(params)
    assert list(document[baseline]) == ["mine-van"]
    assert (document["runs"], document["base_shapes"]) == (before["runs"], before["base_shapes"])
    compares = baseline == "hologan"  # COLMAP has features of its own
    assert ("mine-laptop" in document["features"]) == compares
    assert document[baseline]["mine-van"].get("features") == ("mine-laptop" if compares else None)


def test_a_category_that_a_baseline_is_of_is_not_looked_for_again(params: Path, photographs: Path) -> None:
    options = Options("toybox-car", dataset="mine", category="van", baseline="colmap")
    turn_on(params, options._replace(source=photographs))
    for split in ("train", "test"):
        shutil.rmtree(photographs / split / "van")
    assert turn_on(params, options._replace(seed=1)) == "mine-van-seed1"
