"""Pieces of the report page as HTML text: headline tiles, tables, pictures and the page around them."""

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any, NamedTuple

from pipeline.export.report_style import STYLE

# The browser itself refuses any request: the page holds what it shows.
POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data: blob:; connect-src blob:"
)


class Section(NamedTuple):
    """A part of the page that its table of contents names."""

    anchor: str
    heading: str
    introduction: str
    body: str


class Tile(NamedTuple):
    """A headline figure, its standard error if it has one, and what to compare it to."""

    value: str
    error: str
    label: str
    note: str


def page(title: str, introduction: str, tiles: Sequence[Tile], sections: Sequence[Section]) -> str:
    """Compose a page that needs nothing beside it: style, script and pictures stand inside."""
    links = [f'<a href="#{section.anchor}">{escape(section.heading)}</a>' for section in sections]
    contents = f"<nav>{''.join(links)}</nav>" if len(links) > 1 else ""
    heads = "".join(
        f'<div class="tile"><b>{escape(tile.value)} <i>{escape(tile.error)}</i></b><span>{escape(tile.label)}</span>'
        f"<small>{escape(tile.note)}</small></div>"
        for tile in tiles
    )
    parts = "".join(
        f'<section id="{section.anchor}"><h2>{escape(section.heading)}</h2>'
        f"<p>{escape(section.introduction)}</p>{section.body}</section>"
        for section in sections
    )
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{STYLE}</style></head><body><main>"
        f'<header><h1>{escape(title)}</h1><p class="lead">{escape(introduction)}</p>{contents}</header>'
        f'<div class="tiles">{heads}</div>{parts}</main></body></html>\n'
    )


def table(header: Sequence[str], rows: Sequence[Sequence[str]], baselines: Sequence[str] = ()) -> str:
    """Lay out rows of cells that are already HTML; rows whose first cell is in `baselines` are set apart."""
    head = "".join(f"<th>{escape(name)}</th>" for name in header)
    lines = []
    for row in rows:
        style = ' class="baseline"' if row[0] in baselines else ""
        lines.append(f"<tr{style}>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>")
    whole = f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(lines)}</tbody></table>"
    return f'<div class="scroll" tabindex="0">{whole}</div>'


def figure_cell(figure: Mapping[str, Any] | None, key: str = "value", digits: int = 3) -> str:
    """Write a figure with its standard error, or its deviation over seeds; a dash where there is no figure."""
    if figure is None:
        return "–"
    spread = error_of(figure, digits)
    return f"{figure[key]:.{digits}f}" + (f" <small>{spread}</small>" if spread else "")


def error_of(figure: Mapping[str, Any], digits: int = 3) -> str:
    """Write what a figure's spread is: its standard error, or the deviation of several seeds; nothing where unknown."""
    if "deviation" in figure:
        return f"SD {figure['deviation']:.{digits}f}"
    error = figure["standard_error"]
    return "" if error is None else f"± {error:.{digits}f}"


def image(address: str, description: str, pixels: bool = False) -> str:
    """Show a picture; `pixels` keeps small photographs' pixels square and sharp."""
    style = ' class="pixels"' if pixels else ""
    return f'<img{style} src="{address}" alt="{escape(description, quote=True)}" loading="lazy">'


def card(content: str, caption: str, style: str = "") -> str:
    """Frame pictures with a caption, which is already HTML."""
    return f'<figure class="card {style}">{content}<figcaption>{caption}</figcaption></figure>'


def captioned(content: str, caption: str) -> str:
    """Put a caption, which is already HTML, under content."""
    return f"<figure>{content}<figcaption>{caption}</figcaption></figure>"


def four(addresses: Sequence[str], names: Sequence[str], title: str) -> str:
    """Show four small pictures side by side over their names; `title` says what all of them show."""
    described = zip(addresses, names, strict=True)
    pictures = "".join(image(address, f"{title}, {name}", pixels=True) for address, name in described)
    return f'<div class="four">{pictures}{"".join(f"<span>{escape(name)}</span>" for name in names)}</div>'


def grid(style: str, items: Sequence[str]) -> str:
    """Arrange items in as many columns as fit."""
    return f'<div class="{style}">{"".join(items)}</div>'


def folded(heading: str, content: str) -> str:
    """Hide content behind a heading until it is clicked."""
    return f"<details><summary>{escape(heading)}</summary>{content}</details>"
