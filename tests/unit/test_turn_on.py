"""Rows are turned on without disturbing the parameter file."""

import re
import shutil
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from pipeline.config import entries
from pipeline.datasets.prepare import load_prepare
from pipeline.datasets.survey import Contents, survey
from pipeline.errors import ConfigError, UserError
from pipeline.rows.options import Options
from pipeline.rows.params_file import round_trip_yaml
from pipeline.rows.turn_on import turn_on
from stages import run_row
from stages.settings import require_settings
from tests.fresh_params import write_fresh_params
from tests.pascal3d_tree import release
from tests.picture_trees import tree, write_folder, write_tar

ROOT = Path(__file__).parents[2]


BASE_SHAPE = {
    "row": "toybox-car",
    "size": "laptop",
    "ablation": "none",
    "seed": 1,
    "dataset": "toybox",
    "category": "car",
    "features": "toybox-laptop",
}


@pytest.fixture
def params(tmp_path: Path) -> Path:
    return write_fresh_params(tmp_path / "params.yaml")


def empty_pictures(*categories: str) -> dict[str, bytes]:
    return {f"{split}/{category}/1.jpg": b"" for split in ("train", "test") for category in categories}


@pytest.fixture
def photographs(tmp_path: Path) -> Path:
    """Name pictures of some categories; turning a run on does not read them."""
    categories = ("bus", "car", "cart", "cat", "cat-seed1", "old-car", "stall", "van")
    return write_folder(tmp_path / "photographs", empty_pictures(*categories))


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


@pytest.mark.parametrize("row", ["toybox-aeroplane", "toybox-car", "toybox-chair", "toybox-horse"])
def test_a_run_has_the_photographs_of_its_row(params: Path, row: str) -> None:
    name = turn_on(params, Options(row, seed=3))
    document = YAML(typ="safe").load(params)
    run, settings = document["runs"][name], document["rows"][row]
    assert (run["row"], run["dataset"], run["category"]) == (row, settings["dataset"], settings["category"])
    assert run["dataset"] in document["datasets"]
    assert document["features"][run["features"]]["dataset"] == run["dataset"]


def test_photographs_with_a_table_of_poses_are_a_posed_folder(params: Path, tmp_path: Path) -> None:
    source = write_folder(tmp_path / "cars", {**tree(), "poses.csv": b""})
    options = Options("pascal-car", dataset="stanford", category="car", source=source)
    assert turn_on(params, options) == "stanford-car"
    assert YAML(typ="safe").load(params)["datasets"]["stanford"] == {"kind": "posed_folder", "source": str(source)}


def test_the_release_of_pascal3d_is_known_by_its_annotations(params: Path, tmp_path: Path) -> None:
    for source in (write_folder(tmp_path / "release", release()), write_tar(tmp_path / "release.tar", release())):
        assert turn_on(params, Options("pascal-car", source=source)) == "pascal-car"
        expected = {"kind": "pascal3d", "source": str(source)}
        assert YAML(typ="safe").load(params)["datasets"]["pascal3d"] == expected


def test_photographs_that_were_moved_are_named_again(params: Path, tmp_path: Path) -> None:
    here, there = write_folder(tmp_path / "here", tree()), tmp_path / "there"
    cart = Options("cifar10-automobile", dataset="market", category="car")
    turn_on(params, cart._replace(source=here))
    here.rename(there)
    before = params.read_bytes()
    with pytest.raises(ConfigError, match=f"photographs of 'market' are no longer at {here}; name them again with"):
        turn_on(params, cart._replace(seed=1))
    assert params.read_bytes() == before
    assert turn_on(params, cart._replace(seed=1, source=there)) == "market-car-seed1"


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
    with pytest.raises(ConfigError, match="'sharper' trains for 64 pixels a side, fewer than the 128 of size"):
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


@pytest.mark.parametrize(("row", "own"), [("pascal-car", {"folder": {"fit": "pad"}}), ("cifar10-automobile", {})])
def test_photographs_cut_to_boxes_stay_whole(params: Path, photographs: Path, row: str, own: dict[str, object]) -> None:
    turn_on(params, Options(row, dataset="cars", category="car", source=photographs))
    expected = {"kind": "folder", "source": str(photographs), **own}
    assert YAML(typ="safe").load(params)["datasets"]["cars"] == expected


def test_photographs_that_were_cut_are_no_whole_ones(params: Path, photographs: Path) -> None:
    given = {"dataset": "market", "source": photographs}
    turn_on(params, Options("cifar10-automobile", category="cart", **given))
    before = params.read_bytes()
    with pytest.raises(ConfigError, match="pictures of 'market' are cut to a square, but this row wants them whole"):
        turn_on(params, Options("pascal-car", category="stall", **given))
    assert params.read_bytes() == before


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


@pytest.mark.parametrize(
    ("written", "message"),
    [
        ("sise: 32", r"unknown key 'prepare_data\.folder\.sise'; did you mean 'size'"),
        ("", r"'prepare_data\.folder\.size' is missing; expected a whole number"),
    ],
)
def test_settings_of_new_photographs_are_looked_at_first(
    params: Path, photographs: Path, written: str, message: str
) -> None:
    params.write_text(params.read_text().replace("  folder: {size: 32,", f"  folder: {{{written},".replace("{,", "{")))
    with pytest.raises(ConfigError, match=message):
        turn_on(params, Options("toybox-car", dataset="mine", category="van", source=photographs))


def test_the_embedded_data_set_comes_back(params: Path) -> None:
    document = YAML(typ="safe").load(params)
    known = document["datasets"]["toybox"]
    YAML().dump(document | dict.fromkeys(("datasets", "features", "base_shapes", "runs")), params)
    assert turn_on(params, Options("toybox-car")) == "toybox-car"
    assert YAML(typ="safe").load(params)["datasets"] == {"toybox": known}


def test_a_category_that_is_on_is_not_looked_for_again(params: Path, photographs: Path) -> None:
    cart = Options("cifar10-automobile", dataset="market", category="cart")
    turn_on(params, cart._replace(source=photographs))
    for split in ("train", "test"):
        shutil.rmtree(photographs / split / "cart")
    assert turn_on(params, cart._replace(seed=1)) == "market-cart-seed1"
    turn_on(params, cart._replace(category="stall"))
    with pytest.raises(ConfigError, match="'market' has no category 'stalls'; did you mean 'stall'"):
        turn_on(params, cart._replace(category="stalls"))


def test_photographs_of_which_something_is_learned_stay(params: Path, tmp_path: Path, photographs: Path) -> None:
    given = {"dataset": "market", "source": photographs}
    turn_on(params, Options("cifar10-automobile", category="cart", **given))
    before = params.read_bytes()
    given["source"] = write_folder(tmp_path / "others", {"train/bus/1.jpg": b"", "test/bus/1.jpg": b""})
    words = (
        r"runs\.market-cart learns 'cart' of 'market', but SOURCE=.*others has no such category; name a second dataset"
    )
    with pytest.raises(ConfigError, match=words):
        turn_on(params, Options("cifar10-automobile", category="bus", **given))
    assert params.read_bytes() == before
    photographs = photographs.rename(tmp_path / "moved")
    turn_on(params, Options("cifar10-automobile", category="bus", dataset="market", source=photographs))
    assert YAML(typ="safe").load(params)["datasets"]["market"]["source"] == str(photographs)


def test_longer_training_is_no_shorter(params: Path) -> None:
    before = params.read_bytes()
    words = "ablation 'longer' trains for 2400 iterations, fewer than the 10000 of size 'paper'"
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


def test_some_settings_of_a_toybox_may_be_its_own(params: Path) -> None:
    own = "\n  toybox:\n    toybox: {photograph: {supersampling: 4}}"
    params.write_text(params.read_text().replace("\n  toybox:", own, 1))
    assert turn_on(params, Options("toybox-car", seed=1)) == "toybox-car-seed1"


def test_the_official_archive_is_known_by_its_name(params: Path, tmp_path: Path) -> None:
    archive = tmp_path / "cifar-10-python.tar.gz"
    archive.touch()
    turn_on(params, Options("cifar10-automobile", source=archive))
    assert YAML(typ="safe").load(params)["datasets"]["cifar10"]["kind"] == "cifar10"


def test_what_is_no_parameter_file_is_said(params: Path) -> None:
    text = params.read_text()
    params.write_text(text.replace("\nrows:", "\nrws:"))
    with pytest.raises(ConfigError, match="nothing reads 'rws'; did you mean 'rows'"):
        turn_on(params, Options("toybox-car"))
    params.write_text(text + "\n]")
    with pytest.raises(ConfigError, match="is not valid YAML"):
        turn_on(params, Options("toybox-car"))


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


def test_a_table_of_poses_that_comes_later_keeps_the_size(params: Path, tmp_path: Path) -> None:
    source = write_folder(tmp_path / "cars", tree())
    options = Options("cifar10-automobile", dataset="cars", category="car", source=source)
    turn_on(params, options)
    document = YAML(typ="safe").load(params)
    document["datasets"]["cars"]["folder"] = {"size": 32, "fit": "pad"}
    YAML(typ="safe").dump(document, params)
    (source / "poses.csv").touch()
    assert turn_on(params, options) == "cars-car"
    found = YAML(typ="safe").load(params)["datasets"]["cars"]
    assert (found["kind"], found["posed_folder"]) == ("posed_folder", {"size": 32, "fit": "pad"})


def test_features_by_a_given_network_need_its_weights(params: Path, photographs: Path) -> None:
    before = params.read_bytes()
    with pytest.raises(ConfigError, match="by a given network; name its weights with FEATURES="):
        turn_on(params, Options("pascal-car", size="laptop-imagenet", dataset="cars", source=photographs))
    assert params.read_bytes() == before


@pytest.mark.parametrize(("source", "known"), [("folder", "horse"), ("tar", "horse"), ("cifar10", "truck")])
def test_a_category_that_the_photographs_have_not_changes_nothing(
    params: Path, tmp_path: Path, source: str, known: str
) -> None:
    before = params.read_bytes()
    match source:
        case "folder":
            path = write_folder(tmp_path / "photographs", tree())
        case "tar":
            path = write_tar(tmp_path / "photographs.tar", tree())
        case _:
            path = tmp_path / "cifar-10-python.tar.gz"
            path.touch()
    with pytest.raises(ConfigError, match=f"'cifar10' has no category '{known}s'; did you mean '{known}'"):
        turn_on(params, Options("cifar10-horse", category=f"{known}s", source=path))
    assert params.read_bytes() == before


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


def test_a_run_that_cannot_end_is_not_turned_on(params: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    params.write_text(params.read_text(encoding="utf-8").replace("\nfine_tune:\n", "\nfine_tune:\n  step: 3\n"))
    before = params.read_bytes()
    monkeypatch.chdir(params.parent)
    monkeypatch.setattr("sys.argv", ["run_row", "--row", "toybox-horse"])
    with pytest.raises(ConfigError, match=r"unknown key 'fine_tune\.step'"):
        run_row.main()
    assert params.read_bytes() == before
