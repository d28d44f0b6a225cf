"""Reading and writing params.yaml without losing what people wrote in it."""

from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap
from ruamel.yaml.nodes import ScalarNode as RoundTripNode
from ruamel.yaml.representer import RoundTripRepresenter
from yaml.nodes import ScalarNode
from yaml.resolver import Resolver

_ABOVE_KEY, _ABOVE_VALUE = 1, 3
"""Where ruamel.yaml keeps the comment lines above a key, and those between a key and the lines of its value."""


def round_trip_yaml() -> YAML:
    """Return a reader and writer of params.yaml that keeps comments, order and layout."""
    yaml = YAML()
    yaml.width = 4096  # no line is broken
    yaml.preserve_quotes = True
    yaml.representer.add_representer(str, _represent_text)
    yaml.representer.add_representer(
        type(None), lambda representer, _: representer.represent_scalar("tag:yaml.org,2002:null", "null")
    )
    return yaml


def put(document: CommentedMap, section: str, name: str, entry: dict[str, Any]) -> None:
    """Replace an entry, or put it first: the comment that follows a section belongs to the section's last line.

    What stands above the entry that was first stays above it, unless the section's own line ends in a comment.
    """
    entries = document[section]
    if name in entries:
        entries[name].update(entry)
        return
    above = document.ca.items.get(section)
    if entries and above and above[_ABOVE_VALUE]:
        entries.ca.items.setdefault(next(iter(entries)), [None] * 4)[_ABOVE_KEY] = above[_ABOVE_VALUE]
        above[_ABOVE_VALUE] = None
    entries.insert(0, name, entry)


def _represent_text(representer: RoundTripRepresenter, text: str) -> RoundTripNode:
    """Quote what YAML 1.1, whose words `pipeline.config` reads, takes for something else than text, such as `on`."""
    tag = Resolver().resolve(ScalarNode, text, (True, False))
    return representer.represent_scalar("tag:yaml.org,2002:str", text, style=None if tag.endswith(":str") else "'")
