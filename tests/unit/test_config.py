"""Parameters are read strictly."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import pytest

from pipeline.config import from_json, load, scalar
from pipeline.errors import ConfigError, DataError
from pipeline.ranges import Count, Momentum, Positive


@dataclass(frozen=True)
class Angle:
    low: float
    high: float


@dataclass(frozen=True)
class Interval(Angle):
    def __post_init__(self) -> None:
        if self.low > self.high:
            raise ConfigError(f"low is {self.low} and high is {self.high}")


@dataclass(frozen=True)
class Sector:
    interval: Interval


@dataclass(frozen=True)
class Stage:
    iterations: Count
    rate: Positive
    betas: tuple[Momentum, Momentum]
    steps: tuple[int, ...]
    widths: tuple[int, ...]
    recipe: Literal["labels", "rotation"]
    smooth: bool
    note: str
    limit: float | None
    angle: Angle
    turn: Angle | None


DOCUMENT = """
device: cpu
stage:
  iterations: 10
  rate: 1.0e-4
  betas: [0.5, 0]
  steps: [-1]
  widths: [8, 16, 32]
  recipe: labels
  smooth: true
  note: plain
  limit: null
  angle: {low: -10, high: 10}
  turn: null
sizes:
  laptop: {stage: {iterations: 2, angle: {high: 20}}}
  other: {stage: {limit: 3, turn: {low: 0, high: 1}}}
wrong:
  unknown: {iteration: 3}
  nested: {angle: {hihg: 3}}
  section_of_none: {angel: {low: 1, high: 2}}
  kind: {iterations: 2.5}
  truth: {iterations: true}
  none: {iterations: 0}
  still: {rate: 0}
  full: {betas: [0.5, 1.0]}
  unordered: {rate: .nan}
  endless: {rate: .inf}
  undefined: {limit: .nan}
  quoted: {rate: '1e-4'}
  choice: {recipe: label}
  length: {betas: [0.5]}
  item: {widths: [8, wide]}
  scalar: {angle: 3}
  section: {iterations: {low: 1}}
  absent: {note: null}
"""


@pytest.fixture
def params(tmp_path: Path) -> Path:
    path = tmp_path / "params.yaml"
    path.write_text(DOCUMENT)
    return path


def test_values_keep_their_types(params: Path) -> None:
    config = load(params, Stage, ["stage"])
    assert config.rate == 1e-4
    assert config.betas == (0.5, 0.0)
    assert isinstance(config.betas[1], float)
    assert config.widths == (8, 16, 32)
    assert (config.recipe, config.smooth, config.note) == ("labels", True, "plain")
    assert config.limit is None
    assert config.turn is None


@pytest.mark.parametrize("number", ["5e-05", "1E5", "2.e+3", "+.5e3", "1.0e-4", "3"])
def test_numbers_are_those_of_newer_yaml_which_dvc_writes(tmp_path: Path, number: str) -> None:
    path = tmp_path / "params.yaml"
    path.write_text(DOCUMENT.replace("rate: 1.0e-4", f"rate: {number}"))
    assert load(path, Stage, ["stage"]).rate == float(number)
    path.write_text("names: {1e5-cart: '1e5', other: 1e5x}")
    assert scalar(path, "names") == {"1e5-cart": "1e5", "other": "1e5x"}


@pytest.mark.parametrize(
    ("written", "means"),
    [
        ("01200", 1200),
        ("-07", -7),
        ("+3", 3),
        ("0o17", 15),
        ("0x1F", 31),
        ("1:04", "1:04"),
        ("2024-13-45", "2024-13-45"),
        ("1_000", 1000),
        ("-0b11", -3),
    ],
)
def test_whole_numbers_are_those_of_newer_yaml_too(tmp_path: Path, written: str, means: object) -> None:
    (tmp_path / "params.yaml").write_text(f"count: {written}")
    assert scalar(tmp_path / "params.yaml", "count") == means


def test_later_sections_replace_only_what_they_name(params: Path) -> None:
    config = load(params, Stage, ["stage", "sizes.laptop.stage", "sizes.other.stage"])
    assert config.iterations == 2
    assert config.angle == Angle(-10.0, 20.0)
    assert config.limit == 3.0
    assert config.turn == Angle(0.0, 1.0)
    assert config.rate == 1e-4


@pytest.mark.parametrize(
    ("section", "words"),
    [
        ("wrong.unknown", ["unknown key 'wrong.unknown.iteration'", "did you mean 'iterations'?"]),
        ("wrong.section_of_none", ["unknown key 'wrong.section_of_none.angel'", "did you mean 'angle'?"]),
        ("wrong.nested", ["unknown key 'wrong.nested.angle.hihg'", "did you mean 'high'?"]),
        ("wrong.kind", ["'wrong.kind.iterations' is 2.5", "a whole number"]),
        ("wrong.truth", ["'wrong.truth.iterations' is True", "a whole number"]),
        ("wrong.none", ["'wrong.none.iterations' is 0; expected a whole number, at least 1"]),
        ("wrong.still", ["'wrong.still.rate' is 0; expected a number", ", above 0"]),
        (
            "wrong.full",
            ["'wrong.full.betas' is [0.5, 1.0]", "a list of 2 items, each a number", ", at least 0 and below 1"],
        ),
        ("wrong.unordered", ["'wrong.unordered.rate' is nan; expected a number", ", above 0"]),
        ("wrong.endless", ["'wrong.endless.rate' is inf; expected a number", ", above 0"]),
        ("wrong.undefined", ["'wrong.undefined.limit' is nan; expected a number"]),
        ("wrong.quoted", ["'wrong.quoted.rate' is '1e-4'; expected a number"]),
        ("wrong.choice", ["'wrong.choice.recipe' is 'label'", "one of 'labels', 'rotation'"]),
        ("wrong.length", ["'wrong.length.betas' is [0.5]", "a list of 2"]),
        ("wrong.item", ["'wrong.item.widths'", "any number of items, each a whole number"]),
        ("wrong.scalar", ["'wrong.scalar.angle' is 3", "a section with low, high"]),
        ("wrong.section", ["iterations' is a section", "a whole number"]),
        ("wrong.absent", ["'wrong.absent.note' is None", "text"]),
    ],
)
def test_a_wrong_value_is_one_sentence_naming_file_and_key(params: Path, section: str, words: list[str]) -> None:
    with pytest.raises(ConfigError) as caught:
        load(params, Stage, ["stage", section])
    message = str(caught.value)
    assert message.startswith(str(params))
    assert "\n" not in message
    for word in words:
        assert word in message


def test_a_number_too_large_to_compute_with_is_refused(params: Path) -> None:
    params.write_text(DOCUMENT.replace("rate: 1.0e-4", f"rate: {10**400}"))
    with pytest.raises(ConfigError, match=r"'stage\.rate' is 10+; expected a number"):
        load(params, Stage, ["stage"])


def test_a_missing_key_is_named(params: Path) -> None:
    with pytest.raises(ConfigError, match=r"'sizes\.laptop\.stage\.rate' is missing; expected a number"):
        load(params, Stage, ["sizes.laptop.stage"])


@pytest.mark.parametrize(
    ("section", "nearest"),
    [("stag", "'stage'"), ("sizes.lptop.stage", "'sizes.laptop'"), ("sizes.laptop.sage", "'sizes.laptop.stage'")],
)
def test_a_missing_section_names_the_nearest(params: Path, section: str, nearest: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load(params, Stage, [section])
    assert f"has no '{section}'; did you mean {nearest}?" in str(caught.value)


@pytest.mark.parametrize(
    ("text", "lack"), [('{"low": 1}', "'Angle.high' is missing"), ('{"low": 1, "hgih": 2}', "hgih")]
)
def test_settings_in_a_file_of_other_code_say_so(text: str, lack: str) -> None:
    """The file is older or newer than the code: nothing in params.yaml is wrong."""
    with pytest.raises(DataError, match=rf"^models/car\.safetensors was written by other code \(.*{lack}.*dvc repro"):
        from_json(text, Angle, Path("models/car.safetensors"))


def test_a_value_is_no_section(params: Path) -> None:
    with pytest.raises(ConfigError, match="'device' must be a section"):
        load(params, Stage, ["device"])


def test_a_scalar_is_read(params: Path) -> None:
    assert scalar(params, "device") == "cpu"


def test_files_that_are_no_parameters_are_named(tmp_path: Path) -> None:
    contents = {
        "broken": (b"a: [1", "is not valid YAML"),
        "latin": ("a: \u00fc".encode("latin-1"), "is not valid YAML"),
        "twice": (b"a: {b: 1, b: 2}", "is not valid YAML: 'b' stands twice"),
        "list": (b"? [a, b]\n: 1", "is not valid YAML: a key is not a single value"),
        "empty": (b"", "must hold sections"),
        "number": (b"a: 0x_", "is not valid YAML: invalid literal for int"),
        "truth": (b"a: !!bool perhaps", "is not valid YAML: 'perhaps'"),
        "date": (b"a: !!timestamp soon", "is not valid YAML"),
    }
    for name, (content, words) in contents.items():
        (tmp_path / name).write_bytes(content)
        with pytest.raises(ConfigError, match=words):
            scalar(tmp_path / name, "device")
    with pytest.raises(ConfigError, match="does not exist"):
        scalar(tmp_path / "no", "device")


def test_values_that_do_not_go_together_are_named_with_file_and_section(tmp_path: Path) -> None:
    path = tmp_path / "params.yaml"
    path.write_text("sector: {interval: {low: 2, high: 1}}")
    with pytest.raises(ConfigError) as caught:
        load(path, Sector, ["sector"])
    assert str(caught.value) == f"{path}: sector.interval: low is 2.0 and high is 1.0"
