"""Runs, base shapes and features that are turned on."""

import re
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from pipeline.config import entries
from pipeline.datasets.prepare import load_prepare
from pipeline.errors import ConfigError, UserError
from pipeline.rows.options import Options
from pipeline.rows.params_file import round_trip_yaml
from pipeline.rows.turn_on import turn_on
from tests.picture_trees import empty_pictures, tree, write_folder, write_tar

ROOT = Path(__file__).parents[2]


def test_a_row_brings_its_dataset_features_and_run(params: Path, tmp_path: Path) -> None:
    archive, before = write_tar(tmp_path / "cifar10_jpeg.tar", tree()), params.read_text().splitlines()
    assert turn_on(params, Options("cifar10-horse", source=archive)) == "cifar10-horse"
    document = YAML(typ="safe").load(params)
    assert document["datasets"]["cifar10"] == {"kind": "folder", "source": str(archive)}
    weights = "data/raw/wide_resnet_16_2_cifar10.safetensors"
    expected = {"dataset": "cifar10", "size": "laptop", "seed": 0, "weights": weights}
    assert document["features"]["cifar10-laptop"] == expected
    run = document["runs"]["cifar10-horse"]
    assert (run["dataset"], run["category"], run["features"]) == ("cifar10", "horse", "cifar10-laptop")
    assert document["base_shapes"][run.pop("base_shape")] == run | {"chosen": "score"}
    lines = iter(params.read_text().splitlines())
    assert all(line in lines for line in before), "a line was changed or moved"


def test_a_given_network_gets_pictures_of_the_size_it_needs(params: Path, tmp_path: Path, photographs: Path) -> None:
    weights = tmp_path / "squeezenet.npz"
    weights.touch()
    given = {"dataset": "cars", "category": "car", "source": photographs, "features": weights}
    assert turn_on(params, Options("pascal-car", size="laptop-imagenet", **given)) == "cars-car-laptop-imagenet"
    before = params.read_bytes()
    document = YAML(typ="safe").load(params)
    assert document["datasets"]["cars"] == {
        "kind": "folder",
        "source": str(photographs),
        "folder": {"size": 64, "fit": "pad"},
    }
    assert document["features"]["cars-laptop-imagenet"]["weights"] == str(weights)
    for source in (photographs, None):
        with pytest.raises(ConfigError, match="pictures of 'cars' are 64 px, but this run compares 32 px"):
            turn_on(params, Options("pascal-car", dataset="cars", category="car", source=source))
    assert params.read_bytes() == before


def test_sharper_textures_want_larger_pictures(params: Path, photographs: Path) -> None:
    sharper = Options("pascal-car", ablation="sharper", dataset="cars", category="car", source=photographs)
    assert turn_on(params, sharper) == "cars-car-sharper"
    document = YAML(typ="safe").load(params)
    assert document["datasets"]["cars"]["folder"] == {"size": 64, "fit": "pad"}
    assert document["runs"]["cars-car-sharper"]["base_shape"] == "cars-car"
    assert document["base_shapes"]["cars-car"]["size"] == "laptop"
    with pytest.raises(ConfigError, match="'sharper' trains on pictures of 64 px, less than the 128 of size"):
        turn_on(params, sharper._replace(size="paper-imagenet", dataset="cars128"))


def test_base_shapes_are_learned_from_pictures_that_they_divide(params: Path, photographs: Path) -> None:
    params.write_text(re.sub(r"\bsize: 64", "size: 48", params.read_text()))
    sharper = Options("pascal-car", ablation="sharper", dataset="cars", category="car", source=photographs)
    with pytest.raises(ConfigError, match="compares 48 px, no multiple of the 32 px that base shapes are learned from"):
        turn_on(params, sharper)


def test_a_run_may_be_around_the_base_shape_of_another(params: Path, tmp_path: Path, photographs: Path) -> None:
    weights = tmp_path / "squeezenet.npz"
    weights.touch()
    given = {"dataset": "cars64", "category": "car", "source": photographs, "size": "laptop-imagenet"}
    around = Options("pascal-car", **given, features=weights, base_shape="toybox-car")
    before = YAML(typ="safe").load(params)
    name = turn_on(params, around)
    assert name == "cars64-car-laptop-imagenet-around-toybox-car"
    document = YAML(typ="safe").load(params)
    assert document["runs"][name]["base_shape"] == "toybox-car"
    assert document["runs"][name]["features"] == "cars64-laptop-imagenet"
    assert document["base_shapes"] == before["base_shapes"]
    with pytest.raises(ConfigError, match="base_shapes has no 'toybox-cat'; did you mean 'toybox-car'"):
        turn_on(params, around._replace(base_shape="toybox-cat"))
    with pytest.raises(ConfigError, match=r"'toybox-car' was learned with ablation 'none', but .* with 'no-symmetry'"):
        turn_on(params, around._replace(ablation="no-symmetry"))
    assert turn_on(params, around._replace(ablation="no-ends", seed=2)).endswith("no-ends-seed2-around-toybox-car")
    assert turn_on(params, Options("toybox-car", base_shape="toybox-car")) == "toybox-car"


def test_names_say_what_is_unusual(params: Path, photographs: Path) -> None:
    unusual = {"size": "paper", "ablation": "no-symmetry", "seed": 2}
    assert turn_on(params, Options("toybox-car", **unusual)) == "toybox-car-paper-no-symmetry-seed2"
    own = {"source": photographs, "dataset": "market", "category": "cart"}
    assert turn_on(params, Options("cifar10-automobile", **own)) == "market-cart"
    document = YAML(typ="safe").load(params)
    assert document["runs"]["market-cart"]["row"] == "cifar10-automobile"
    assert document["datasets"]["market"]["source"] == str(photographs)


def test_a_run_by_a_row_has_no_other_row_s_name(params: Path) -> None:
    assert turn_on(params, Options("toybox-car", category="chair", seed=1)) == "toybox-chair-as-toybox-car-seed1"
    assert turn_on(params, Options("toybox-chair", seed=1)) == "toybox-chair-seed1"
    runs, rows = (entries(params, section) for section in ("runs", "base_shapes"))
    for section in (runs, rows):
        assert section["toybox-chair-as-toybox-car-seed1"]["row"] == "toybox-car"


def test_a_base_shape_that_was_chosen_stays_chosen(params: Path) -> None:
    turn_on(params, Options("toybox-chair"))
    document = round_trip_yaml().load(params)
    document["base_shapes"]["toybox-chair"]["chosen"] = 2
    round_trip_yaml().dump(document, params)
    for ablation in ("none", "longer"):
        name = turn_on(params, Options("toybox-chair", ablation=ablation))
        document = YAML(typ="safe").load(params)
        assert document["base_shapes"][document["runs"][name]["base_shape"]]["chosen"] == 2


def test_a_second_row_for_the_same_photographs_is_refused(params: Path, photographs: Path) -> None:
    own = {"source": photographs, "dataset": "mine", "category": "cat"}
    turn_on(params, Options("toybox-horse", **own))
    before = params.read_bytes()
    with pytest.raises(ConfigError, match=r"base_shapes\.mine-cat is on with row toybox-horse, not toybox-chair;"):
        turn_on(params, Options("toybox-chair", **own))
    assert params.read_bytes() == before


@pytest.mark.parametrize(
    ("first", "second", "difference"),
    [
        ({"category": "cat", "seed": 1}, {"category": "cat-seed1"}, "seed 1, not 0"),
        ({"dataset": "my-old"}, {"dataset": "my", "category": "old-car"}, "dataset my-old, not my"),
    ],
)
def test_two_runs_of_one_name_are_refused(
    params: Path, photographs: Path, first: dict[str, object], second: dict[str, object], difference: str
) -> None:
    usual = {"source": photographs, "dataset": "mine", "category": "car"}
    turn_on(params, Options("toybox-car", **{**usual, **first}))
    before = params.read_bytes()
    with pytest.raises(ConfigError, match=f"is on with {difference}; name the same photographs differently"):
        turn_on(params, Options("toybox-car", **{**usual, **second}))
    assert params.read_bytes() == before


def test_other_weights_for_features_that_are_on_are_refused(params: Path, tmp_path: Path, photographs: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / f"{name}.npz").touch()
    given = {"dataset": "cars", "source": photographs, "size": "laptop-imagenet"}
    turn_on(params, Options("pascal-car", category="van", features=tmp_path / "a.npz", **given))
    before = params.read_bytes()
    with pytest.raises(ConfigError, match=r"features\.cars-laptop-imagenet is on with weights .*a\.npz, not .*b\.npz"):
        turn_on(params, Options("pascal-car", category="bus", features=tmp_path / "b.npz", **given))
    assert params.read_bytes() == before


@pytest.mark.parametrize(
    ("ablation", "base_shape"),
    [("no-symmetry", "toybox-car-no-symmetry-seed1"), ("no-view-prior", "toybox-car-seed1")],
)
def test_a_base_shape_is_shared_where_the_ablation_leaves_it(params: Path, ablation: str, base_shape: str) -> None:
    name = turn_on(params, Options("toybox-car", ablation=ablation, seed=1))
    document = YAML(typ="safe").load(params)
    assert document["runs"][name]["base_shape"] == base_shape
    assert document["runs"][name]["ablation"] == ablation
    assert document["base_shapes"][base_shape]["ablation"] == ("none" if ablation not in base_shape else ablation)


def test_longer_training_is_no_shorter(params: Path) -> None:
    before = params.read_bytes()
    words = "ablation 'longer' trains for 2400 iterations, less than the 10000 of size 'paper'"
    with pytest.raises(ConfigError, match=words):
        turn_on(params, Options("toybox-car", size="paper", ablation="longer"))
    assert params.read_bytes() == before
    assert turn_on(params, Options("toybox-car", ablation="longer")) == "toybox-car-longer"


@pytest.mark.parametrize("name", ["on", "No", "null", "2026", "1_0", "true"])
def test_names_stay_names(params: Path, tmp_path: Path, name: str) -> None:
    source = write_folder(tmp_path / "photographs", empty_pictures(name))
    turn_on(params, Options("cifar10-automobile", dataset=name, category=name, source=source))
    config = load_prepare(params, name)
    assert (config.kind, config.source) == ("folder", source)
    assert entries(params, "runs")[f"{name}-{name}"]["category"] == name


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (Options("cifar10-hors"), "did you mean 'cifar10-horse'"),
        (Options("toybox-car", size="labtop"), "did you mean 'laptop'"),
        (Options("toybox-car", ablation="no-symetry"), "did you mean 'no-symmetry'"),
        (
            Options("toybox-car", size="paper-imagenet", features=ROOT / "params.yaml", baseline="hologan"),
            "HoloGAN draws 32 px at size 'paper-imagenet', but this run's pictures have 128 px; choose another SIZE=",
        ),
        (Options("toybox-car", baseline="colmap", ablation="no-ends"), "colmap has nothing that 'no-ends' changes"),
        (Options("toybox-car", baseline="hologan", base_shape="toybox-car"), "hologan has no base shape; leave"),
        (Options("toybox-horse", size="paper", features=ROOT / "params.yaml"), "learns its features by classification"),
        (
            Options("toybox-car", seed=1, features=ROOT / "params.yaml"),
            r"is no \.safetensors of a network",
        ),
        (Options("toybox-car", seed=-1), "SEED is -1; expected 0 or a greater number"),
        (Options("pascal-chair"), "no photographs of 'pascal3d' yet"),
        (Options("cifar10-horse", source=Path("nowhere.tar")), "SOURCE=nowhere.tar does not exist"),
        (Options("toybox-car", seed=1, size="paper", features=Path("no.npz")), "FEATURES=no.npz does not exist"),
        (Options("toybox-car", features=Path("my net.npz")), "FEATURES='my net.npz' becomes part of a command"),
        (Options("toybox-car", category="sports car"), "CATEGORY='sports car' has other characters than letters"),
        (Options("xyz"), "rows has no 'xyz'; expected one of: cifar10-automobile, cifar10-horse"),
        (Options("toybox-car", category="plane"), "'toybox' has no category 'plane'; did you mean 'aeroplane'"),
        (Options("toybox-car", source=ROOT), "the embedded data set and has no SOURCE="),
        (
            Options("toybox-car", size="laptop-imagenet", features=ROOT / "params.yaml"),
            "pictures of 'toybox' are 32 px, but this run compares 64 px",
        ),
        (Options("toybox-car", dataset="my.v2"), "DATASET='my.v2' has other characters than letters"),
        (
            Options("toybox-horse", ablation="no-ends"),
            "'no-ends' changes nothing of row 'toybox-horse' at size 'laptop'",
        ),
        (Options("toybox-car", ablation="single-stage", base_shape="toybox-car"), "trains without a base shape"),
        (Options("cifar10-horse", source=ROOT / "docs"), "has no pictures at train/<category>/ and test/<category>/"),
    ],
)
def test_a_wrong_name_changes_nothing(params: Path, options: Options, words: str) -> None:
    before = params.read_bytes()
    with pytest.raises(UserError, match=words):
        turn_on(params, options)
    assert params.read_bytes() == before


def test_features_by_a_given_network_need_its_weights(params: Path, photographs: Path) -> None:
    before = params.read_bytes()
    with pytest.raises(ConfigError, match="by a given network; name its weights with FEATURES="):
        turn_on(params, Options("pascal-car", size="laptop-imagenet", dataset="cars", source=photographs))
    assert params.read_bytes() == before
