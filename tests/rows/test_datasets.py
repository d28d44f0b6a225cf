"""Photographs that rows bring, and those that are named."""

import shutil
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from pipeline.errors import ConfigError
from pipeline.rows.options import Options
from pipeline.rows.turn_on import turn_on
from tests.pascal3d_tree import release
from tests.picture_trees import tree, write_folder, write_tar


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


def test_some_settings_of_a_toybox_may_be_its_own(params: Path) -> None:
    own = "\n  toybox:\n    toybox: {photograph: {supersampling: 4}}"
    params.write_text(params.read_text().replace("\n  toybox:", own, 1))
    assert turn_on(params, Options("toybox-car", seed=1)) == "toybox-car-seed1"


def test_the_official_archive_is_known_by_its_name(params: Path, tmp_path: Path) -> None:
    archive = tmp_path / "cifar-10-python.tar.gz"
    archive.touch()
    turn_on(params, Options("cifar10-automobile", source=archive))
    assert YAML(typ="safe").load(params)["datasets"]["cifar10"]["kind"] == "cifar10"


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
