"""What is done with each photograph by itself: reading it for the networks, and writing what they have found."""

import errno
import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor
from torch.nn import functional

from pipeline.cli.conversion import to_rgb
from pipeline.cli.outputs import Found, write_outputs
from pipeline.cli.photographs import Task
from pipeline.datasets.decoding import Fit, decode, decode_up_to, reading
from pipeline.errors import DataError
from pipeline.export.painting import PaintingConfig, paint
from pipeline.export.picture import write_png
from pipeline.export.seam import Seam, cut_open
from pipeline.export.views import TurntableConfig
from pipeline.networks.full_model import FullModel
from pipeline.rendering.renderer import Mesh, RendererConfig, render

_OF_ONE_NAME = {errno.EACCES, errno.EISDIR, errno.ENAMETOOLONG, errno.ENOENT}
"""What a file system refuses for a photograph or a name, and may grant for others."""
_SEEN_SIZE = 256
"""Of what is kept of a photograph, in pixels, at most."""


class Picture(NamedTuple):
    """A photograph as the networks see it."""

    task: Task
    content_hash: str
    pixels: UInt8[np.ndarray, "H W 3"]


class Reading(NamedTuple):
    """How photographs are read."""

    size: int
    fit: Fit

    def __call__(self, task: Task) -> Picture | str:
        """Decode a photograph. Returns a sentence where it cannot be read."""
        name = str(task.photograph)
        try:
            content = _content(task.photograph)
            pixels = decode(to_rgb(content, name), name, self.size, self.fit)
        except DataError as error:
            return str(error)
        return Picture(task, hashlib.sha256(content).hexdigest(), pixels)

    def again(self, picture: Picture, most: int) -> Float[Tensor, "3 side side"]:
        """Read the square that the networks saw once more, at its own resolution up to another.

        Raises DataError where the file is another by now.
        """
        path = picture.task.photograph
        content = _content(path)
        if hashlib.sha256(content).hexdigest() != picture.content_hash:
            raise DataError(f"{path} was replaced while it was reconstructed; run the same command again")
        pixels = decode_up_to(to_rgb(content, str(path)), str(path), most, self.size, self.fit)
        return torch.from_numpy(pixels.copy()).permute(2, 0, 1) / 255


def _content(photograph: Path) -> bytes:
    with reading(str(photograph)):
        return photograph.read_bytes()


class Writing(NamedTuple):
    """How what was found is written."""

    reading: Reading
    outputs: Sequence[str]
    turntable: TurntableConfig
    painting: PaintingConfig | None
    """How meshes are painted with their photographs; None where they are not."""
    renderer: RendererConfig
    mirror_texture: bool
    faces: Int[Tensor, "F 3"]
    directions: Float[Tensor, "V 3"]
    seam: Seam
    """Where meshes are cut open."""

    def __call__(self, both: tuple[Picture, Found]) -> str | None:
        """Write the outputs of a photograph. Returns a sentence where they cannot be, and those of others may."""
        picture, found = both
        try:
            self._write(picture, found if self.painting is None else self._painted(picture, found, self.painting))
        except DataError as error:
            return str(error)
        except OSError as error:
            if error.errno not in _OF_ONE_NAME:
                raise
            return f"{picture.task.photograph}: {error}; rename it, or name another folder"
        return None

    def _write(self, picture: Picture, found: Found) -> None:
        seen = self.reading.again(picture, _SEEN_SIZE) if "picture" in self.outputs else None
        picture.task.claim(picture.content_hash)
        mesh = Mesh(found.vertices, self.faces, self.directions)
        write_outputs(picture.task.target, found, mesh, self.renderer.camera, self.seam, self.turntable, self.outputs)
        if seen is not None:
            write_png(picture.task.target.file("_photograph.png"), seen)

    def _painted(self, picture: Picture, found: Found, config: PaintingConfig) -> Found:
        """Paint what is found with its photograph, and render it at the photograph's size."""
        seen = self.reading.again(picture, config.photograph_size)
        mesh = Mesh(found.vertices, self.faces, self.directions)
        renderer = replace(self.renderer, size=seen.shape[-1])
        texture = paint(mesh, found.texture, found.pose, seen, renderer.camera, self.mirror_texture, config)
        background = functional.interpolate(found.background, size=seen.shape[1:], mode="bilinear")
        image = render(mesh, texture[None], found.pose, background, None, renderer).images[0]
        return found._replace(texture=texture, image=image)


def writing(
    model: FullModel,
    reading: Reading,
    outputs: Sequence[str],
    turntable: TurntableConfig,
    painting: PaintingConfig | None,
) -> Writing:
    """Say how what a model finds is written; on the CPU, where it is done."""
    faces, directions, config = model.faces.cpu(), model.directions.cpu(), model.config
    seam = cut_open(faces, directions)
    return Writing(
        reading, outputs, turntable, painting, config.renderer, config.mirror_texture, faces, directions, seam
    )
