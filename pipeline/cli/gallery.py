"""A page on which reconstructed meshes turn beside their photographs."""

import base64
from collections.abc import Sequence
from pathlib import Path

import torch

from pipeline.cli.photographs import Task
from pipeline.datasets.decoding import Fit, decode_up_to
from pipeline.export.picture import data_uri
from pipeline.export.report_page import captioned, grid, image, page
from pipeline.export.viewer import Exhibit, viewer_section
from pipeline.files import atomic_path, read_json
from pipeline.geometry.camera import CameraConfig

SHOWN = 100
"""Meshes on a page, at most: browsers load all of them at once."""
_PHOTOGRAPH_SIZE = 256


def write_gallery(path: Path, tasks: Sequence[Task], fit: Fit, camera: CameraConfig) -> None:
    """Write the page of the first of the tasks whose meshes, pictures and poses are there, atomically."""
    shown = tasks[:SHOWN]
    introduction = f"{len(shown)} of {len(tasks)} reconstructed photographs."
    section = viewer_section([_exhibit(task, fit) for task in shown], camera)
    text = page("Reconstructions", introduction, [], [section])
    with atomic_path(path) as temporary:
        # Names of files may hold bytes that are no text.
        temporary.write_text(text, encoding="utf-8", errors="backslashreplace", newline="\n")


def _exhibit(task: Task, fit: Fit) -> Exhibit:
    pixels = decode_up_to(task.photograph.read_bytes(), str(task.photograph), _PHOTOGRAPH_SIZE, fit)
    photograph = data_uri(torch.from_numpy(pixels.copy()).permute(2, 0, 1) / 255)
    picture = base64.b64encode(task.file("_reconstruction.png").read_bytes()).decode()
    pictures = {"photograph": photograph, "reconstruction": f"data:image/png;base64,{picture}"}
    pose = read_json(task.file("_pose.json"))
    return Exhibit(
        key=task.target.as_posix(),
        group="Photographs",
        name=task.photograph.name,
        glb=task.file(".glb").read_bytes(),
        textured=True,
        azimuth=pose["azimuth_degrees"],
        elevation=pose["elevation_degrees"],
        thumbnail=photograph,
        beside=grid("pair", [captioned(image(address, name, pixels=True), name) for name, address in pictures.items()]),
    )
