"""The viewer of the report page: one WebGL canvas that shows one mesh at a time, turned by pointer, touch or keys."""

import base64
import zipfile
from collections.abc import Sequence
from html import escape
from importlib.metadata import distribution
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

from pipeline.errors import DataError
from pipeline.export.report_page import Section, image
from pipeline.geometry.camera import CameraConfig

BEHAVIOUR = Path(__file__).with_name("viewer.js")
TEMPLATE = "trimesh/resources/templates/viewer.zip"
"""Found without importing trimesh, which takes longer than a photograph's way to a mesh."""
LIBRARY_END = "THREE.GLTFLoader=GLTFLoader;})();"
SURFACES = ("texture", "clay", "polygons")
INTRODUCTION = (
    "Every mesh as it is exported. Choose one, then drag it, move the sliders, or press arrow keys while it has the "
    "focus; a finger turns it sideways, the slider tilts it. A reconstruction is first seen from the viewpoint "
    "estimated for its photograph; reset view goes back there. At azimuth 0° the camera faces what the model calls the "
    "front, which may be either end."
)


class Exhibit(NamedTuple):
    """A mesh to look at."""

    key: str
    """Names the mesh within the page; `turn_link` leads to it."""
    group: str
    """Heading it is listed under; neighbours in a sequence share it."""
    name: str
    glb: bytes
    """Content of a .glb file."""
    textured: bool
    """Whether the mesh has colours of its own; else it is shown as clay."""
    azimuth: float
    """Of the first view, in degrees."""
    elevation: float
    """Of the first view, in degrees."""
    thumbnail: str
    """Address of a picture to choose it by."""
    beside: str
    """HTML shown beside the mesh."""


def viewer_section(exhibits: Sequence[Exhibit], camera: CameraConfig) -> Section:
    """Show exhibits, the first one at first; its pictures stand beside it and a list to choose from below."""
    beside = "".join(
        f'<div class="beside" data-key="{escape(one.key, quote=True)}" hidden>{one.beside}</div>' for one in exhibits
    )
    lists = "".join(
        f'<fieldset class="shelf"><legend>{escape(group)}</legend>{"".join(map(_choice, members))}</fieldset>'
        for group, members in groupby(exhibits, lambda one: one.group)
    )
    canvas = (
        '<div class="stage"><canvas tabindex="0" role="application" aria-label="mesh in 3D, arrow keys turn it">'
        '</canvas><p class="problem" role="alert" hidden></p></div>'
    )
    body = (
        f'<div class="viewer" data-field-of-view="{camera.field_of_view:g}">'
        f'<div class="look">{canvas}<div class="panel"><p class="shown" aria-live="polite"></p>{beside}{_controls()}'
        f"</div></div>{lists}</div><script>{three_js()}</script><script>{BEHAVIOUR.read_text('utf-8')}</script>"
    )
    return Section("meshes", "Meshes to turn", INTRODUCTION, body)


def turn_link(key: str) -> str:
    """Link to the viewer, showing the exhibit of this key."""
    return f'<a href="#meshes" data-exhibit="{escape(key, quote=True)}">turn it in 3D</a>'


def three_js() -> str:
    """Return three.js and its reader of glTF, a script that defines THREE, from the page in which trimesh shows scenes.

    Raises DataError where the installed trimesh has another page.
    """
    with zipfile.ZipFile(str(distribution("trimesh").locate_file(TEMPLATE))) as archive:
        page = archive.read("viewer.html.template").decode("utf-8")
    library, found, _ = page.partition("<script>")[2].partition(LIBRARY_END)
    if not found:
        raise DataError("the installed trimesh brings no three.js with a glTF reader; install that of constraints.txt")
    return library + found


def _choice(one: Exhibit) -> str:
    values = {
        "value": one.key,
        "data-name": one.name,
        "data-glb": base64.b64encode(one.glb).decode(),
        "data-textured": "yes" if one.textured else "",
        "data-azimuth": f"{one.azimuth:.1f}",
        "data-elevation": f"{one.elevation:.1f}",
    }
    attributes = " ".join(f'{name}="{escape(value, quote=True)}"' for name, value in values.items())
    return (
        f'<label class="choice"><input type="radio" name="exhibit" {attributes}>'
        f"{image(one.thumbnail, '')}<span>{escape(one.name)}</span></label>"
    )


def _controls() -> str:
    sliders = "".join(
        f'<div class="slider"><label>{name}<input type="range" name="{name}" min="{low}" max="{high}" step="1"></label>'
        '<output aria-hidden="true"></output></div>'
        for name, low, high in (("azimuth", -180, 180), ("elevation", -80, 80))
    )
    surfaces = "".join(f'<label><input type="radio" name="surface" value="{name}">{name}</label>' for name in SURFACES)
    buttons = '<button type="button" name="home">reset view</button><button type="button" name="spin">spin</button>'
    return (
        f'<div class="controls">{sliders}<fieldset class="surfaces"><legend>surface</legend>{surfaces}</fieldset>'
        f'<div class="buttons">{buttons}</div></div>'
    )
