"""Read params.yaml into frozen dataclasses, strictly: the only reader of settings; `pipeline.rows` edits the file."""

import json
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, ClassVar, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import yaml

from pipeline.errors import ConfigError, DataError
from pipeline.naming import did_you_mean
from pipeline.ranges import PowersOfTwo, Range

Config = TypeVar("Config")


@dataclass(frozen=True)
class _Leaf:
    """Hold one value of the file and the dotted key it stands under."""

    value: Any
    key: str


class _Loader(yaml.SafeLoader):
    """Read YAML, but refuse a key that stands twice in a section, of which others take the last one.

    Numbers are those that DVC reads and writes: 5e-05 is one, 0100 is 100 and 1:30 is text, as dates are here.
    """

    yaml_implicit_resolvers: ClassVar = {
        first: [(tag, form) for tag, form in resolvers if not tag.endswith((":int", ":float", ":timestamp"))]
        for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise yaml.constructor.ConstructorError(None, None, "a key is not a single value", key.start_mark)
            if key.value in seen:
                raise yaml.constructor.ConstructorError(None, None, f"'{key.value}' stands twice", key.start_mark)
            seen.add(key.value)
        return super().construct_mapping(node, deep)


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(
        r"[-+]?([0-9][0-9_]*\.[0-9_]*|\.[0-9][0-9_]*|([0-9][0-9_]*\.?[0-9_]*|\.[0-9]+)[eE][-+]?[0-9]+|\.(inf|Inf|INF))$"
        r"|\.(nan|NaN|NAN)$"
    ),
    list("-+.0123456789"),
)
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:int",
    re.compile(r"[-+]?([0-9][0-9_]*|0b[01_]+|0o[0-7_]+|0x[0-9a-fA-F_]+)$"),
    list("-+0123456789"),
)
_Loader.add_constructor("tag:yaml.org,2002:int", lambda _, node: _whole_number(node.value.replace("_", "")))


_NO_YAML = (yaml.YAMLError, ValueError, KeyError, AttributeError)
"""What reading raises: PyYAML leaves to Python what is wrong in a number, a truth value or a date that has a tag."""


def _whole_number(text: str) -> int:
    return int(text, 0 if text.lstrip("-+")[:2] in ("0b", "0o", "0x") else 10)


def load(path: Path, config_class: type[Config], sections: Sequence[str]) -> Config:
    """Build a frozen dataclass from the sections of a parameter file.

    Sections are dotted keys such as `sizes.laptop.train_full`. They are merged from left to right: a later section
    replaces the values it names, at any depth, and keeps the others. Fields may be bool, int, float, str, `Literal`,
    numbers within a `Range` or among `PowersOfTwo`, tuples of those, another dataclass, or any of these `| None`.
    Nothing has a default: every field must be given.

    Raises ConfigError for a section or key that does not exist (with the nearest one that does), for a missing key,
    for a value of the wrong type or out of range, and for values that the dataclass itself refuses.
    """
    document = _read(path)
    merged: dict[str, Any] = {}
    for section in sections:
        merged = merge(merged, _mark(_section(document, section, path), section))
    return _build(config_class, merged, sections[0], path)


def from_json(text: str, config_class: type[Config], path: Path) -> Config:
    """Build a frozen dataclass from the JSON text beside the tensors of a file.

    Raises DataError where other code has written it, with other settings than today's.
    """
    try:
        return _build(config_class, _mark(json.loads(text), config_class.__name__), config_class.__name__, path)
    except ConfigError as error:
        lack = str(error).removeprefix(f"{path}: ")
        raise DataError(f"{path} was written by other code ({lack}); `dvc repro` trains it anew") from None


def scalar(path: Path, key: str) -> Any:
    """Read the single value under a dotted key, such as `device`. Raises ConfigError where there is none."""
    return _find(_read(path), key, path)


def entries(path: Path, key: str) -> dict[str, dict[str, Any]]:
    """Read a section of sections, such as `runs`, which may be empty. Raises ConfigError where it is anything else."""
    document = _read(path)
    found = {} if _find(document, key, path) is None else _section(document, key, path)
    return {name: _require_section(entry, f"{key}.{name}", path) for name, entry in found.items()}


def names(path: Path) -> list[str]:
    """Return the names of a file's sections and single values."""
    return list(_read(path))


def _read(path: Path) -> dict[str, Any]:
    try:
        document = _parse(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ConfigError(f"{path} does not exist; run this in the project's folder or name it: --project") from None
    except _NO_YAML as error:
        raise ConfigError(f"{path} is not valid YAML: {' '.join(str(error).split())}") from None
    if not isinstance(document, dict):
        raise ConfigError(f"{path} must hold sections of keys and values")
    return document


@cache
def _parse(text: str) -> Any:
    """Parse a text once: a stage reads the same file for each of its sections."""
    return yaml.load(text, _Loader)


def _find(document: dict[str, Any], dotted: str, path: Path) -> Any:
    found: Any = document
    walked: list[str] = []
    for key in dotted.split("."):
        if not isinstance(found, dict) or key not in found:
            siblings = found if isinstance(found, dict) else ()
            known = did_you_mean(key, siblings, prefix=".".join([*walked, ""]))
            raise ConfigError(f"{path} has no '{dotted}'{known}")
        found = found[key]
        walked.append(key)
    return found


def _section(document: dict[str, Any], dotted: str, path: Path) -> dict[str, Any]:
    return _require_section(_find(document, dotted, path), dotted, path)


def _require_section(found: Any, dotted: str, path: Path) -> dict[str, Any]:
    if not isinstance(found, dict):
        raise ConfigError(f"{path}: '{dotted}' must be a section of keys and values, not {found!r}")
    return found


def _mark(value: Any, key: str) -> Any:
    if isinstance(value, dict):
        return {name: _mark(inner, f"{key}.{name}") for name, inner in value.items()}
    return _Leaf(value, key)


def merge(base: Mapping[str, Any], overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Return a section with the values that another names, at any depth, replaced by its."""
    merged = dict(base)
    for name, value in overrides.items():
        both_sections = isinstance(value, dict) and isinstance(base.get(name), dict)
        merged[name] = merge(base[name], value) if both_sections else value
    return merged


def _build(config_class: type[Config], values: dict[str, Any], section: str, path: Path) -> Config:
    hints = get_type_hints(config_class, include_extras=True)
    names = [field.name for field in fields(config_class)]  # pyright: ignore[reportArgumentType]
    for name, value in values.items():
        if name not in names:
            raise ConfigError(
                f"{path}: unknown key '{_key(value, f'{section}.{name}')}'{did_you_mean(str(name), names)}"
            )
    for name in names:
        if name not in values:
            raise ConfigError(f"{path}: '{section}.{name}' is missing; expected {_describe(hints[name])}")
    converted = {name: _convert(hints[name], values[name], f"{section}.{name}", path) for name in names}
    try:
        return config_class(**converted)
    except ConfigError as error:  # of values that do not go together
        raise ConfigError(f"{path}: {section}: {error}") from None


def _convert(hint: Any, value: Any, section: str, path: Path) -> Any:
    if get_origin(hint) in (Union, UnionType):
        if isinstance(value, _Leaf) and value.value is None and NoneType in get_args(hint):
            return None
        (hint,) = (option for option in get_args(hint) if option is not NoneType)
    if is_dataclass(hint) and isinstance(hint, type) and isinstance(value, dict):
        return _build(hint, value, section, path)
    if isinstance(value, _Leaf) and _fits(hint, value.value):
        return _cast(hint, value.value)
    given = "a section" if isinstance(value, dict) else repr(value.value)
    raise ConfigError(f"{path}: '{_key(value, section)}' is {given}; expected {_describe(hint)}")


def _fits(hint: Any, value: Any) -> bool:
    if get_origin(hint) is Annotated:
        kind, bounds = _bounded(hint)
        return _fits(kind, value) and value in bounds
    if get_origin(hint) is Literal:
        return any(value == option and type(value) is type(option) for option in get_args(hint))
    if get_origin(hint) is tuple:
        return (
            isinstance(value, list)
            and len(value) == len(_items(hint, value))
            and all(_fits(item, inner) for item, inner in zip(_items(hint, value), value, strict=True))
        )
    if hint is float:
        return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= sys.float_info.max
    return type(value) is hint


def _cast(hint: Any, value: Any) -> Any:
    if get_origin(hint) is Annotated:
        return _cast(_bounded(hint)[0], value)
    if get_origin(hint) is tuple:
        return tuple(_cast(item, inner) for item, inner in zip(_items(hint, value), value, strict=True))
    return float(value) if hint is float else value


def _bounded(hint: Any) -> tuple[Any, Range | PowersOfTwo]:
    """Take an annotated number apart."""
    kind, bounds = get_args(hint)
    return kind, bounds


def _items(hint: Any, value: list[Any]) -> list[Any]:
    """Spell out one type per item: `tuple[float, ...]` takes any number of items, `tuple[float, float]` two."""
    items = list(get_args(hint))
    return items[:1] * len(value) if items[1:] == [Ellipsis] else items


def _key(value: Any, otherwise: str) -> str:
    """Return where a value stands in the file; a section stands above the first of its values."""
    depth = 0
    while isinstance(value, dict) and value:
        value, depth = next(iter(value.values())), depth + 1
    return value.key.rsplit(".", depth)[0] if isinstance(value, _Leaf) else otherwise


def _describe(hint: Any) -> str:
    if get_origin(hint) is Literal:
        return "one of " + ", ".join(map(repr, get_args(hint)))
    if get_origin(hint) is Annotated:
        kind, bounds = _bounded(hint)
        return f"{_describe(kind)}, {bounds}"
    if get_origin(hint) is tuple:
        items = get_args(hint)
        counted = "any number of" if items[1:] == (Ellipsis,) else str(len(items))
        return f"a list of {counted} items, each {_describe(items[0])}"
    if get_origin(hint) in (Union, UnionType):
        return " or ".join("null" if option is NoneType else _describe(option) for option in get_args(hint))
    if is_dataclass(hint) and isinstance(hint, type):
        return "a section with " + ", ".join(field.name for field in fields(hint))
    names = {float: "a number", int: "a whole number", str: "text"}
    return names.get(hint, "true or false")
