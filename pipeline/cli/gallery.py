"""A page on which reconstructed meshes turn beside their photographs."""

from collections.abc import Sequence
from pathlib import Path

from pipeline.cli.photographs import Target
from pipeline.export.picture import png_uri
from pipeline.export.report_page import captioned, grid, image, page
from pipeline.export.viewer import Exhibit, viewer_section
from pipeline.files import read_json, write_text
from pipeline.geometry.camera import CameraConfig

SHOWN = 100
"""Meshes on a page, at most: browsers load all of them at once."""


def write_gallery(path: Path, targets: Sequence[Target], camera: CameraConfig) -> None:
    """Write the page of the first of the targets, whose meshes, pictures and poses are there, atomically.

    They are called by their paths within the page's folder.
    """
    shown = targets[:SHOWN]
    introduction = f"{len(shown)} of {len(targets)} reconstructed photographs whose mesh, picture and pose are here."
    section = viewer_section([_exhibit(target, path.parent) for target in shown], camera)
    text = page("Reconstructions", introduction, [], [section])
    write_text(path, text, errors="backslashreplace")  # names of files may hold bytes that are no text


def _exhibit(target: Target, folder: Path) -> Exhibit:
    pictures = {kind: png_uri(target.file(f"_{kind}.png").read_bytes()) for kind in ("photograph", "reconstruction")}
    pose = read_json(target.file("_pose.json"))
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
