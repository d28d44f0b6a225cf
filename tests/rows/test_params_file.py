"""What `make run` leaves of params.yaml as people wrote it, and what it refuses to read."""

from pathlib import Path

import pytest
from ruamel.yaml import YAML

from pipeline.datasets.survey import Contents, survey
from pipeline.errors import ConfigError
from pipeline.rows.options import Options
from pipeline.rows.params_file import round_trip_yaml
from pipeline.rows.turn_on import turn_on
from tests.fresh_params import RUN

ROOT = Path(__file__).parents[2]
BASE_SHAPE = {**RUN, "seed": 1}


def test_the_project_s_own_file_keeps_its_layout(tmp_path: Path) -> None:
    yaml = round_trip_yaml()
    yaml.dump(yaml.load(ROOT / "params.yaml"), tmp_path / "params.yaml")
    assert (tmp_path / "params.yaml").read_text() == (ROOT / "params.yaml").read_text()


def test_what_people_write_stays_where_it_is(params: Path) -> None:
    ours = "# the paper's run\n  # stays as it is\n  toybox-car:\n    row: 'toybox-car'  # quoted\n"
    params.write_text(params.read_text().replace("\nruns:\n  toybox-car:\n    row: toybox-car\n", f"\nruns:\n  {ours}"))
    assert ours in params.read_text()
    turn_on(params, Options("toybox-horse"))
    assert list(YAML(typ="safe").load(params)["runs"]) == ["toybox-horse", "toybox-car"]
    assert ours in params.read_text()


def test_what_is_on_stays_as_it_is(params: Path) -> None:
    before = params.read_bytes()
    assert turn_on(params, Options("toybox-car")) == "toybox-car"
    assert params.read_bytes() == before


def test_what_is_no_parameter_file_is_said(params: Path) -> None:
    text = params.read_text()
    params.write_text(text.replace("\nrows:", "\nrws:"))
    with pytest.raises(ConfigError, match="nothing reads 'rws'; did you mean 'rows'"):
        turn_on(params, Options("toybox-car"))
    params.write_text(text + "\n]")
    with pytest.raises(ConfigError, match="is not valid YAML"):
        turn_on(params, Options("toybox-car"))


@pytest.mark.parametrize(
    ("section", "entry", "message"),
    [
        ("rows", {"mine": {"learn_base_shape": {}, "train_full": {}}}, "has no 'rows.mine.dataset'; write it as"),
        ("ablations", {"mine": {"train_full": {}}}, "has no 'ablations.mine.learn_base_shape'"),
        ("ablations", {"mine": {"train_full": {}, "learn_base_shape": None}}, "must be a section of keys and values"),
        ("sizes", {"mine": {"learn_base_shape": {}}}, "has no 'sizes.mine.train_features'"),
        ("rows", {"mine": {"fine_tune": {}}}, "rows.mine has no 'fine_tune'; "),
        ("runs", {"mine": {"ablaton": "none"}}, "runs.mine has no 'ablaton'; did you mean 'ablation'"),
        ("runs", {"mine": {"chosen": 1}}, "runs.mine has no 'chosen'; "),
        ("runs", {"mine": None}, "'runs.mine' must be a section"),
        ("runs", ["mine"], "'runs' must be a section"),
        ("runs", {"cars.v2": {}}, "runs has the name 'cars.v2'; expected letters, digits, _ and -"),
        ("runs", {2024: {}}, "runs has the name 2024; expected letters"),
        ("base_shapes", {"mine": {**BASE_SHAPE, "chosen": "best"}}, "chosen' must be 'score' or the number of a shape"),
        (
            "rows",
            {"mine": {"dataset": "toybox", "category": 3, "learn_base_shape": {}, "train_full": {}}},
            "'rows.mine.category' must be text, not 3",
        ),
        (
            "colmap",
            {"mine": {"size": "laptop", "seed": 1.5, "dataset": "toybox", "category": "car"}},
            "'colmap.mine.seed' must be a whole number, not 1.5",
        ),
        ("train_full", {"iteration": 3}, "unknown key 'train_full.iteration'; did you mean 'iterations'"),
        ("train_full", None, "'train_full' must be a section of keys and values, not None"),
        ("hologan", {"mine": {"row": "toybox-car"}}, "hologan.mine has no 'row'"),
        ("processes", {"fine_tune": 2}, "processes has no 'fine_tune'; "),
        ("presicion", "float32", "nothing reads 'presicion'; did you mean 'precision'"),
        ("datasets", {"mine": {"source": "photographs"}}, "has no 'datasets.mine.kind'"),
        ("datasets", {"mine": {"kind": "foldr", "source": "photographs"}}, "'foldr'.*folder"),
        (
            "datasets",
            {"mine": {"kind": ["folder"], "source": "photographs"}},
            r"datasets\.mine\.kind is '\['folder'\]'",
        ),
        ("datasets", {"mine": {"kind": "folder", "source": 3}}, r"'datasets\.mine\.source' must be text, not 3"),
        ("datasets", {"mine": {"kind": "folder", "source": "x", "size": 3}}, r"datasets\.mine has no 'size'; expected"),
    ],
)
def test_entries_written_by_hand_are_whole(params: Path, section: str, entry: object, message: str) -> None:
    yaml = YAML(typ="safe")
    document = yaml.load(params)
    document[section] = document[section] | entry if isinstance(entry, dict) else entry
    yaml.dump(document, params)
    before = params.read_bytes()
    with pytest.raises(ConfigError, match=message):
        turn_on(params, Options("toybox-car"))
    assert params.read_bytes() == before


def test_what_is_written_meanwhile_is_not_undone(
    params: Path, photographs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def look_and_edit(source: Path) -> Contents:
        params.write_text(params.read_text().replace("memory: 8 ", "memory: 3 "))
        return survey(source)

    monkeypatch.setattr("pipeline.rows.turn_on.survey", look_and_edit)
    options = Options("cifar10-automobile", source=photographs, dataset="market", category="cart")
    with pytest.raises(ConfigError, match=r"params\.yaml was changed while this command was at work; run it again"):
        turn_on(params, options)
    assert "memory: 3 " in params.read_text()
    assert turn_on(params, options) == "market-cart"
    assert "memory: 3 " in params.read_text()
