"""Turn rows of the paper on in params.yaml."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ruamel.yaml.comments import CommentedMap

from pipeline.config import entries, load, scalar
from pipeline.datasets.prepare import KINDS, load_prepare
from pipeline.datasets.survey import survey
from pipeline.errors import ConfigError
from pipeline.files import atomic_path
from pipeline.naming import is_plain, require_known
from pipeline.networks.pose_coordinates import Framing
from pipeline.networks.seed_choice import BY_SCORE
from pipeline.rows.datasets import EMBEDDED, require_category, turn_on_dataset
from pipeline.rows.entries import NAMES, require_chosen, require_whole_entries
from pipeline.rows.options import BASELINES, Options
from pipeline.rows.params_file import put, round_trip_yaml
from pipeline.rows.requirements import (
    require_base_shape,
    require_change,
    require_parts_of_baseline,
    require_picture_size,
)
from pipeline.training.features import FeaturesConfig

SWITCHES = ("datasets", "features", "base_shapes", "runs", *BASELINES)


def turn_on(path: Path, options: Options) -> str:
    """Add the run or baseline that the options describe to the file, keeping its comments, and return its name.

    The name leaves out what is usual: laptop size, no ablation, seed 0, the row's own photographs, a base shape of its
    own. A run whose ablation leaves base shapes as they are shares the base shape of the run without ablation.

    Raises ConfigError for a row, size, ablation or base shape that does not exist, for a base shape that an ablation
    would change or full training does without, for a negative seed, for an ablation that changes nothing or trains
    less than the size, for a size at which the baseline cannot draw, for what a baseline has no part of, for pictures
    that base shapes cannot be learned from, for names that are not plain, for a dataset whose source is not known or
    gone, that lacks this category or another that is learned from it, or whose pictures have another size, for features
    whose weights are not known or not read, and for a run, a base shape, features or a baseline of that name that are
    on with other settings.
    """
    require_whole_entries(path)
    _require_whole_datasets(path)
    require_chosen(path, options.row, options.size, options.ablation)
    yaml, text = round_trip_yaml(), path.read_text(encoding="utf-8")
    document = yaml.load(text)
    for section in SWITCHES:
        document[section] = document[section] or CommentedMap()  # after the only entry was removed
    if options.seed < 0:
        raise ConfigError(f"SEED is {options.seed}; expected 0 or a greater number")
    require_change(path, document, options)
    require_base_shape(path, document, options)
    size, framing = require_picture_size(path, options)
    require_parts_of_baseline(path, options, size)
    dataset, category = _turn_on_photographs(document, options, size, framing)
    if "features" in NAMES[options.baseline or "runs"]:
        _turn_on_features(path, document, dataset, options)
    subject, entry = _entry(document, dataset, category, options)
    if options.baseline is None:
        name = _turn_on_run(document, subject, entry, options)
    else:
        name = _turn_on_baseline(document, subject, entry, options.baseline)
    if path.read_text(encoding="utf-8") != text:  # an archive takes minutes to look through
        raise ConfigError(f"{path} was changed while this command was at work; run it again")
    with atomic_path(path) as temporary:
        yaml.dump(document, temporary)
    return name


def _require_whole_datasets(path: Path) -> None:
    """Look at the settings of all kinds of data sets, of which a stage reads those of one, and at those that are on."""
    for kind in entries(path, "prepare_data"):
        require_known(kind, KINDS, f"{path}: prepare_data has no")
    for kind, config in KINDS.items():
        load(path, config, [f"prepare_data.{kind}"])
    for name in entries(path, "datasets"):
        load_prepare(path, name)


def _turn_on_photographs(document: CommentedMap, options: Options, size: int, framing: Framing) -> tuple[str, str]:
    """Add the photographs where they are not on, and return the names of data set and category."""
    row = document["rows"][options.row]
    dataset, category = options.dataset or row["dataset"], options.category or row["category"]
    _require_plain("DATASET", dataset)
    _require_plain("CATEGORY", category)
    if dataset == EMBEDDED and options.source is not None:
        raise ConfigError(f"'{EMBEDDED}' is the embedded data set and has no SOURCE=; name yours with DATASET=")
    contents = None if options.source is None else survey(_existing("SOURCE", options.source))
    turn_on_dataset(document, dataset, contents, size, framing)
    require_category(document, dataset, category, contents)
    return dataset, category


def _turn_on_features(path: Path, document: CommentedMap, dataset: str, options: Options) -> None:
    name, size, weights = _features_name(dataset, options), options.size, options.features
    features = document["features"]
    if weights is None:
        if name in features:
            return
        if document["sizes"][size]["train_features"].get("method") == "pretrained":
            raise ConfigError(f"size '{size}' compares pictures by a given network; name its weights with FEATURES=")
    given = scalar(path, "weights") if weights is None else _given_weights(path, weights, options)
    entry = {"dataset": dataset, "size": size, "seed": 0, "weights": given}
    _require_same(features.get(name, entry), entry, f"features.{name}")
    put(document, "features", name, entry)


def _given_weights(path: Path, weights: Path, options: Options) -> str:
    """Return the path of weights that the size's way to features reads."""
    found = str(weights.expanduser())
    if not re.fullmatch(r"[\w./~+-]+", found):
        raise ConfigError(f"FEATURES={found!r} becomes part of a command; give a path without spaces and quotes")
    _existing("FEATURES", weights)
    method = load(path, FeaturesConfig, options.sections("train_features")).method
    if method not in ("pretrained", "transfer"):
        raise ConfigError(f"size '{options.size}' learns its features by {method}; leave FEATURES= out")
    if method == "transfer" and not found.endswith(".safetensors"):
        raise ConfigError(
            f"FEATURES={found} is no .safetensors of a network of this pipeline, which size '{options.size}' starts "
            "from; name one, or choose a SIZE= that takes other networks, such as laptop-imagenet"
        )
    return found


def _entry(document: CommentedMap, dataset: str, category: str, options: Options) -> tuple[str, dict[str, Any]]:
    """Return what a run is of, which its name begins with, and what it shares with its base shape and baselines."""
    row = document["rows"][options.row]
    own = (dataset, category) != (row["dataset"], row["category"])
    subject = f"{dataset}-{category}" if own else options.row
    if own and subject in document["rows"]:
        subject = f"{subject}-as-{options.row}"  # the other row's results have that name
    entry = {"row": options.row, "size": options.size, "ablation": options.ablation, "seed": options.seed}
    return subject, entry | {"dataset": dataset, "category": category, "features": _features_name(dataset, options)}


def _turn_on_baseline(document: CommentedMap, subject: str, entry: Mapping[str, Any], baseline: str) -> str:
    """Add the baseline, called as the run of the same options; return its name."""
    document[baseline].fa.set_block_style()
    name = _name(subject, entry)
    _put_same(document, baseline, name, {key: entry[key] for key in NAMES[baseline]}, {})
    return name


def _turn_on_run(document: CommentedMap, subject: str, entry: dict[str, Any], options: Options) -> str:
    """Add the run, and its base shape where no other run has it; return the run's name."""
    base_shape = entry | {"ablation": options.base_shape_ablation(document)}
    own_base_shape = _name(subject, base_shape)
    if options.base_shape not in (None, own_base_shape):
        name = f"{_name(subject, entry)}-around-{options.base_shape}"
        _put_same(document, "runs", name, entry | {"base_shape": options.base_shape}, {})
        return name
    _put_same(document, "base_shapes", own_base_shape, base_shape, {"chosen": BY_SCORE})
    _put_same(document, "runs", _name(subject, entry), entry | {"base_shape": own_base_shape}, {})
    return _name(subject, entry)


def _put_same(
    document: CommentedMap, section: str, name: str, entry: Mapping[str, Any], additions: Mapping[str, Any]
) -> None:
    """Add an entry, with additions where it is new."""
    known = document[section].get(name, {**entry, **additions})
    _require_same(known, entry, f"{section}.{name}")
    put(document, section, name, known)


def _features_name(dataset: str, options: Options) -> str:
    return f"{dataset}-{options.size}"


def _name(subject: str, entry: Mapping[str, Any]) -> str:
    unusual = [subject] + [entry["size"]] * (entry["size"] != "laptop")
    unusual += [entry["ablation"]] * (entry["ablation"] != "none") + [f"seed{entry['seed']}"] * (entry["seed"] != 0)
    return "-".join(unusual)


def _require_same(entry: Mapping[str, Any], wanted: Mapping[str, Any], key: str) -> None:
    for name, value in wanted.items():
        if entry.get(name) != value:
            raise ConfigError(
                f"{key} is on with {name} {entry.get(name)}, not {value}; name the same photographs differently with "
                f"DATASET= and SOURCE=, or remove {key} from params.yaml"
            )


def _existing(option: str, path: Path) -> Path:
    path = path.expanduser()
    if not path.exists():
        raise ConfigError(f"{option}={path} does not exist; name a file or a folder that does")
    return path


def _require_plain(option: str, name: str) -> None:
    if not is_plain(name):
        raise ConfigError(f"{option}={name!r} has other characters than letters, digits, _ and -; use those alone")
