"""A page on which reconstructed meshes turn beside their photographs."""

from collections.abc import Sequence
from pathlib import Path

from pipeline.cli.photographs import Target
from pipeline.errors import DataError
from pipeline.export.picture import png_uri
from pipeline.export.report_page import captioned, grid, image, page
from pipeline.export.viewer import Exhibit, viewer_section
from pipeline.files import read_json, write_text
from pipeline.geometry.camera import CameraConfig

SHOWN = 100
"""Meshes on a page, at most: browsers load all of them at once."""
ANGLES = ("azimuth_degrees", "elevation_degrees")
"""What the page reads of a pose."""


def write_gallery(path: Path, targets: Sequence[Target], camera: CameraConfig, made_by: str) -> list[str]:
    """Write the page of the first of the targets, whose meshes, pictures and poses are there, atomically.

    They are called by their paths within the page's folder, which says what they were made by. Returns a sentence for
    each that is damaged, which the page leaves out; where none is left, there is no page.
    """
    exhibits, damaged = [], []
    for target in targets:
        try:
            exhibits.append(_exhibit(target, path.parent))
        except DataError as error:
            damaged.append(str(error))
        if len(exhibits) == SHOWN:
            break
    if not exhibits:
        path.unlink(missing_ok=True)  # of an earlier call, whose outputs are gone
        return damaged
    count = f"{len(exhibits)} of {len(targets)} reconstructed photographs"
    introduction = f"{count} whose mesh, picture and pose are here, by {made_by}."
    text = page("Reconstructions", introduction, [], [viewer_section(exhibits, camera)])
    write_text(path, text, errors="backslashreplace")  # names of files may hold bytes that are no text
    return damaged


def _exhibit(target: Target, folder: Path) -> Exhibit:
    pictures = {kind: png_uri(target.file(f"_{kind}.png").read_bytes()) for kind in ("photograph", "reconstruction")}
    pose = _read_pose(target.file("_pose.json"))
    name = target.path.relative_to(folder).as_posix()
    return Exhibit(
        key=name,
        group="Photographs",
        name=name,
        glb=target.file(".glb").read_bytes(),
        textured=True,
        azimuth=pose["azimuth_degrees"],
        elevation=pose["elevation_degrees"],
        thumbnail=pictures["photograph"],
        beside=grid("pair", [captioned(image(uri, kind, pixels=True), kind) for kind, uri in pictures.items()]),
    )


def _read_pose(path: Path) -> dict[str, float]:
    pose = read_json(path)
    if not isinstance(pose, dict) or not all(isinstance(pose.get(key), int | float) for key in ANGLES):
        raise DataError(
            f"{path} is damaged: it holds no {' and '.join(ANGLES)}; remove it, and run again what writes it"
        )
    return pose
