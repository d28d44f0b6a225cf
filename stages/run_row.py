"""Turn a row of the paper on in params.yaml, then run its chain to the report."""

import os
import re
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap
from ruamel.yaml.nodes import ScalarNode as RoundTripNode
from ruamel.yaml.representer import RoundTripRepresenter
from yaml.nodes import ScalarNode
from yaml.resolver import Resolver

from pipeline.config import load, merge, nearest, scalar
from pipeline.datasets import cifar10
from pipeline.datasets.prepared import is_plain
from pipeline.datasets.survey import Contents, survey
from pipeline.datasets.toybox import toybox
from pipeline.errors import ConfigError
from pipeline.files import atomic_path
from pipeline.networks.seed_choice import BY_SCORE
from pipeline.training.base_shape import BaseShapeConfig
from stages.command_line import run

PARAMS = Path("params.yaml")
BASELINES = ("hologan", "colmap")
SWITCHES = ("datasets", "features", "base_shapes", "runs", *BASELINES)
CIFAR10_SIZE = 32
EMBEDDED = "toybox"


def main() -> None:
    """Add the run and what it needs to params.yaml; `dvc repro` does the rest."""
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--row", required=True, help="an entry of `rows`: viewpoints, dimensions, colours")
    parser.add_argument("--size", default="laptop", help="an entry of `sizes`")
    parser.add_argument("--ablation", default="none", help="an entry of `ablations`")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--source", type=Path, help="folder or archive of the photographs, if not on yet")
    parser.add_argument("--features", type=Path, help="weights of the network that compares pictures, if not on yet")
    parser.add_argument("--dataset", help="a name for photographs of your own; else the row's")
    parser.add_argument("--category", help="the category among them; else the row's")
    parser.add_argument("--baseline", choices=BASELINES, help="measure this on the same photographs instead")
    options = parser.parse_args()
    name, stage = turn_on(PARAMS, options), "report"
    if options.baseline:
        stage = f"evaluate_{options.baseline}"
        turn_on_baseline(PARAMS, options.baseline, name)
    # In this process's place, so that Ctrl-C reaches DVC alone, which waits for its stage and releases its lock.
    os.execv(sys.executable, [sys.executable, "-m", "dvc", "repro", f"{stage}@{name}"])


def turn_on(path: Path, options: Namespace) -> str:
    """Add the run that the options describe to the file, keeping its comments, and return the run's name.

    The name leaves out what is usual: laptop size, no ablation, seed 0, the row's own photographs. A run whose ablation
    leaves base shapes as they are shares the base shape of the run without ablation.

    Raises ConfigError for a row, size or ablation that does not exist, for an ablation that would shorten the size's
    training, for a size at which the baseline cannot draw, for names that are not plain, for a dataset whose source is
    not known, that lacks this category or another that is learned from it, or whose pictures have another size, for
    features whose weights are not known, and for a run, a base shape or features of that name that are on with other
    settings.
    """
    for section in (*SWITCHES, "rows", "sizes", "ablations"):
        scalar(path, section)
    yaml = round_trip_yaml()
    document = yaml.load(path)
    for section in SWITCHES:
        document[section] = document[section] or CommentedMap()  # after the only entry was removed
    for kind, name in (("rows", options.row), ("sizes", options.size), ("ablations", options.ablation)):
        _require(name, document[kind], f"{path}: {kind} has no")
    _require_no_shorter(document, options)
    row = document["rows"][options.row]
    dataset, category = options.dataset or row["dataset"], options.category or row["category"]
    _require_plain("DATASET", dataset)
    _require_plain("CATEGORY", category)
    if dataset == EMBEDDED and options.source is not None:
        raise ConfigError(f"'{EMBEDDED}' is the embedded data set and has no SOURCE=; name yours with DATASET=")
    sections = ("learn_base_shape", f"rows.{options.row}.learn_base_shape", f"sizes.{options.size}.learn_base_shape")
    config = load(path, BaseShapeConfig, sections)
    if options.baseline == "hologan":
        _require_that_hologan_draws(document, options.size, config.renderer.size)
    contents = None if options.source is None else survey(_existing("SOURCE", options.source))
    _turn_on_dataset(document, dataset, contents, config)
    _require_category(document, dataset, category, contents)
    features = f"{dataset}-{options.size}"
    _turn_on_features(document, features, {"dataset": dataset, "size": options.size, "seed": 0}, options.features)
    own = (dataset, category) != (row["dataset"], row["category"])
    subject = f"{dataset}-{category}" if own else options.row
    entry = {"row": options.row, "size": options.size, "ablation": options.ablation, "seed": options.seed}
    entry |= {"dataset": dataset, "category": category, "features": features}
    name = _name(subject, entry)
    changes_base_shape = bool(document["ablations"][options.ablation]["learn_base_shape"])
    base_shape = entry | {"ablation": options.ablation if changes_base_shape else "none"}
    for section, its_name, its_entry, additions in (
        ("base_shapes", _name(subject, base_shape), base_shape, {"chosen": BY_SCORE}),
        ("runs", name, entry | {"base_shape": _name(subject, base_shape)}, {}),
    ):
        known = document[section].get(its_name, its_entry | additions)
        _require_same(known, its_entry, f"{section}.{its_name}")
        _put(document[section], its_name, known)
    with atomic_path(path) as temporary:
        yaml.dump(document, temporary)
    return name


def _name(subject: str, entry: dict[str, Any]) -> str:
    unusual = [subject] + [entry["size"]] * (entry["size"] != "laptop")
    unusual += [entry["ablation"]] * (entry["ablation"] != "none") + [f"seed{entry['seed']}"] * (entry["seed"] != 0)
    return "-".join(unusual)


def _require_same(entry: dict[str, Any], wanted: dict[str, Any], key: str) -> None:
    for name, value in wanted.items():
        if entry.get(name) != value:
            raise ConfigError(
                f"{key} is on with {name} {entry.get(name)}, not {value}; name the same photographs differently with "
                f"DATASET= and SOURCE=, or remove {key} from params.yaml"
            )


def _require_no_shorter(document: CommentedMap, options: Namespace) -> None:
    """Refuse an ablation with a number of iterations that a larger size's training exceeds."""
    usual = merge(document["train_full"], document["sizes"][options.size]["train_full"])["iterations"]
    iterations = document["ablations"][options.ablation]["train_full"].get("iterations", usual)
    if iterations < usual:
        raise ConfigError(
            f"ablation '{options.ablation}' trains for {iterations} iterations, fewer than the {usual} of size "
            f"'{options.size}'; leave one of the two out"
        )


def _require_that_hologan_draws(document: CommentedMap, size: str, picture_size: int) -> None:
    """Refuse a size whose pictures are larger than those that HoloGAN draws at it."""
    drawn = merge(document["train_hologan"], document["sizes"][size]["train_hologan"])["network"]["image_size"]
    if drawn != picture_size:
        raise ConfigError(
            f"HoloGAN draws {drawn} px, but pictures of size '{size}' have {picture_size} px; choose another SIZE="
        )


def turn_on_baseline(path: Path, baseline: str, run: str) -> None:
    """Add the baseline beside a run that is on, with the settings of the run that it shares."""
    yaml = round_trip_yaml()
    document = yaml.load(path)
    settings = ("size", "seed", "dataset", "category", "features")
    document[baseline].fa.set_block_style()
    _put(document[baseline], run, {name: document["runs"][run][name] for name in settings})
    with atomic_path(path) as temporary:
        yaml.dump(document, temporary)


def round_trip_yaml() -> YAML:
    """Return a reader and writer of params.yaml that keeps comments, order and layout."""
    yaml = YAML()
    yaml.width = 4096  # no line is broken
    yaml.representer.add_representer(str, _represent_text)
    yaml.representer.add_representer(
        type(None), lambda representer, _: representer.represent_scalar("tag:yaml.org,2002:null", "null")
    )
    return yaml


def _represent_text(representer: RoundTripRepresenter, text: str) -> RoundTripNode:
    """Quote what YAML 1.1, which `pipeline.config` reads, takes for something else than text, such as `on`."""
    tag = Resolver().resolve(ScalarNode, text, (True, False))
    return representer.represent_scalar("tag:yaml.org,2002:str", text, style=None if tag.endswith(":str") else "'")


def _put(entries: CommentedMap, name: str, entry: dict[str, Any]) -> None:
    """Replace an entry, or put it first: the comment that follows a section belongs to the section's last line."""
    if name in entries:
        entries[name].update(entry)
    else:
        entries.insert(0, name, entry)


def _turn_on_dataset(document: CommentedMap, name: str, contents: Contents | None, config: BaseShapeConfig) -> None:
    datasets = document["datasets"]
    is_new, entry = name not in datasets, dict(datasets.get(name, {}))
    if contents is not None:
        entry |= {"kind": contents.kind, "source": str(contents.path)}
    elif is_new:
        raise ConfigError(f"no photographs of '{name}' yet; name their folder or archive with SOURCE=")
    if contents is not None and not is_new and entry != datasets[name]:
        _require_what_is_learned(document, name, entry, contents)
    kind, size = entry["kind"], config.renderer.size
    settings = _settings(document, entry)
    wanted = {"size": size} | ({"fit": "pad"} if config.framing == "box" else {})
    if own := {key: value for key, value in wanted.items() if is_new and settings.get(key, value) != value}:
        entry[kind] = own
    if "fit" in settings and config.framing == "box" and (settings | own)["fit"] != "pad":
        raise ConfigError(
            f"pictures of '{name}' are cut to a square, but this row wants them whole (fit: pad); name a second "
            "dataset with DATASET= and SOURCE="
        )
    found = _picture_size(kind, settings | own)
    if found != size:
        remedy = "name a second dataset with DATASET= and SOURCE="
        if kind == "toybox":
            own = f"toybox: {{photograph: {{size: {size}}}}}"
            remedy = f"add a dataset with `{own}` to {PARAMS}, and name it by DATASET="
        raise ConfigError(f"pictures of '{name}' are {found} px, but this run compares {size} px; {remedy}")
    _put(datasets, name, entry)


def _require_what_is_learned(
    document: CommentedMap, dataset: str, entry: Mapping[str, Any], contents: Contents
) -> None:
    """Refuse to replace a dataset's photographs by others that lack a category which is learned from it."""
    known = _categories(document, entry, contents)
    for section in ("runs", "base_shapes", *BASELINES):
        for name, settings in document[section].items():
            if settings["dataset"] == dataset and settings["category"] not in known:
                raise ConfigError(
                    f"{section}.{name} learns '{settings['category']}' of '{dataset}', but SOURCE={contents.path} has "
                    "no such category; name a second dataset with DATASET="
                )


def _require_category(document: CommentedMap, dataset: str, category: str, contents: Contents | None) -> None:
    """Refuse a category that a dataset has not. One that is on is not looked for again: archives take a while."""
    on = {(run["dataset"], run["category"]) for run in document["runs"].values()}
    if contents is None and (dataset, category) in on:
        return
    known = _categories(document, document["datasets"][dataset], contents)
    _require(category, known, f"'{dataset}' has no category")


def _categories(document: CommentedMap, entry: Mapping[str, Any], contents: Contents | None) -> Collection[str]:
    match entry["kind"]:
        case "toybox":
            return toybox.CATEGORIES
        case "cifar10":
            return cifar10.CATEGORIES
        case "pascal3d":
            return _settings(document, entry)["categories"]
        case _:
            return (contents or survey(Path(entry["source"]))).categories


def _settings(document: CommentedMap, entry: Mapping[str, Any]) -> dict[str, Any]:
    """Return what becomes of a dataset's pictures."""
    return merge(document["prepare_data"][entry["kind"]], entry.get(entry["kind"], {}))


def _picture_size(kind: str, settings: dict[str, Any]) -> int:
    if kind == "cifar10":
        return CIFAR10_SIZE
    return (settings["photograph"] if kind == "toybox" else settings)["size"]


def _turn_on_features(document: CommentedMap, name: str, entry: dict[str, Any], weights: Path | None) -> None:
    features, size = document["features"], entry["size"]
    if weights is None:
        if name in features:
            return
        if document["sizes"][size]["train_features"].get("method") == "pretrained":
            raise ConfigError(f"size '{size}' compares pictures by a given network; name its weights with FEATURES=")
    if weights is not None and not re.fullmatch(r"[\w./~+-]+", str(weights)):
        raise ConfigError(f"FEATURES={str(weights)!r} becomes part of a command; give a path without spaces and quotes")
    given = document["weights"] if weights is None else str(_existing("FEATURES", weights))
    entry = {**entry, "weights": given}
    _require_same(features.get(name, entry), entry, f"features.{name}")
    _put(features, name, entry)


def _existing(option: str, path: Path) -> Path:
    path = path.expanduser()
    if not path.exists():
        raise ConfigError(f"{option}={path} does not exist; name a file or a folder that does")
    return path


def _require_plain(option: str, name: str) -> None:
    if not is_plain(name):
        raise ConfigError(f"{option}={name!r} has other characters than letters, digits, _ and -; use those alone")


def _require(name: str, known: Collection[str], lack: str) -> None:
    if name not in known:
        raise ConfigError(f"{lack} '{name}'{nearest(name, known)}")


if __name__ == "__main__":
    run(main)
