"""Photographs in params.yaml: which data sets are on, what they hold, and what is learned of them."""

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from ruamel.yaml.comments import CommentedMap

from pipeline.config import merge
from pipeline.datasets import cifar10
from pipeline.datasets.survey import Contents, survey
from pipeline.datasets.toybox import toybox
from pipeline.errors import ConfigError
from pipeline.naming import require_known
from pipeline.networks.pose_coordinates import Framing
from pipeline.rows.params_file import put

LEARNED = ("runs", "base_shapes", "hologan", "colmap")
"""Sections whose entries are learned from a category of a data set."""
CIFAR10_SIZE = 32
EMBEDDED = "toybox"


def turn_on_dataset(document: CommentedMap, name: str, contents: Contents | None, size: int, framing: Framing) -> None:
    """Add a data set, or take other photographs for it; of `size` pixels, and cut as renderings are framed.

    Raises ConfigError for a new one without contents, for one whose photographs are gone, for photographs that lack a
    category which is learned from it, and for one whose pictures have another size or cut.
    """
    datasets = document["datasets"]
    is_new = name not in datasets
    entry: dict[str, Any] = dict(datasets.get(name, {}))
    if contents is not None:
        if {entry.get("kind"), contents.kind} == {"folder", "posed_folder"}:
            entry[contents.kind] = _settings(document, entry)  # a table of poses came or went: pictures stay the same
        entry |= {"kind": contents.kind, "source": str(contents.path)}
    elif is_new and name == EMBEDDED:
        entry = {"kind": "toybox", "source": "pipeline/datasets/toybox"}
    elif is_new:
        raise ConfigError(f"no photographs of '{name}' yet; name their folder or archive with SOURCE=")
    elif "source" in entry and not Path(entry["source"]).exists():
        raise ConfigError(f"photographs of '{name}' are no longer at {entry['source']}; name them again with SOURCE=")
    if contents is not None and not is_new and entry != datasets[name]:
        _require_what_is_learned(document, name, entry, contents)
    kind, settings = entry["kind"], _settings(document, entry)
    wanted = {"size": size} | ({"fit": "pad"} if framing == "box" else {})
    if own := {key: value for key, value in wanted.items() if is_new and settings.get(key, value) != value}:
        entry[kind] = own
    if "fit" in settings and framing == "box" and (settings | own)["fit"] != "pad":
        raise ConfigError(
            f"pictures of '{name}' are cut to a square, but this row wants them whole (fit: pad); name a second "
            "dataset with DATASET= and SOURCE="
        )
    found = _picture_size(kind, settings | own)
    if found != size:
        remedy = "name a second dataset with DATASET= and SOURCE="
        if kind == "toybox":
            own = f"toybox: {{photograph: {{size: {size}}}}}"
            remedy = f"add a dataset with `{own}` to params.yaml, and name it by DATASET="
        if kind == "cifar10":
            remedy = "CIFAR-10 has no others: leave SIZE= or ABLATION= out, or name other photographs"
        raise ConfigError(f"pictures of '{name}' are {found} px, but this run compares {size} px; {remedy}")
    put(document, "datasets", name, entry)


def _require_what_is_learned(
    document: CommentedMap, dataset: str, entry: Mapping[str, Any], contents: Contents
) -> None:
    """Refuse to replace a dataset's photographs by others that lack a category which is learned from it."""
    known = _categories(document, entry, contents)
    for section in LEARNED:
        for name, settings in document[section].items():
            if settings["dataset"] == dataset and settings["category"] not in known:
                raise ConfigError(
                    f"{section}.{name} learns '{settings['category']}' of '{dataset}', but SOURCE={contents.path} has "
                    "no such category; name a second dataset with DATASET="
                )


def require_category(document: CommentedMap, dataset: str, category: str, contents: Contents | None) -> None:
    """Raise ConfigError for a category that a data set has not.

    One that is on is not looked for again: archives take a while.
    """
    on = {(entry["dataset"], entry["category"]) for section in LEARNED for entry in document[section].values()}
    if contents is None and (dataset, category) in on:
        return
    known = _categories(document, document["datasets"][dataset], contents)
    require_known(category, known, f"CATEGORY: '{dataset}' has no category")


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
