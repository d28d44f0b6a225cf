"""What is written of a reconstructed photograph."""

from collections.abc import Sequence
from typing import NamedTuple

from jaxtyping import Float
from torch import Tensor

from pipeline.cli.photographs import FILES, Target
from pipeline.export.animation import write_gif, write_mp4
from pipeline.export.glb import write_glb
from pipeline.export.obj import write_obj
from pipeline.export.picture import enlarge, write_png
from pipeline.export.seam import Seam
from pipeline.export.views import TurntableConfig, on_white, render_textured
from pipeline.files import write_json
from pipeline.geometry.camera import CameraConfig, Pose
from pipeline.rendering.renderer import Mesh


class Found(NamedTuple):
    """What a model reads off a photograph."""

    vertices: Float[Tensor, "1 V 3"]
    """In the run's own frame, within its cube."""
    texture: Float[Tensor, "3 T T"]
    """Over the sphere of directions, from 0 to 1."""
    pose: Pose
    """Of the vertices."""
    background: Float[Tensor, "1 3 H W"]
    """From 0 to 1."""
    image: Float[Tensor, "3 H W"]
    """The reconstruction, rendered over its background; from 0 to 1."""


def write_outputs(
    target: Target,
    found: Found,
    mesh: Mesh,
    camera: CameraConfig,
    seam: Seam,
    turntable: TurntableConfig,
    outputs: Sequence[str],
) -> None:
    """Write those of the outputs that are made of what was found, each file whole or not at all.

    `mesh` is what was found with its faces, `seam` is where it is cut open.
    """
    vertices, texture = found.vertices[0], found.texture
    if "mesh" in outputs:
        unwrapped = seam.unwrap(vertices, texture.shape[-1])
        write_glb(target.file(".glb"), unwrapped, texture)
        write_obj(target.file(".obj"), unwrapped, texture)
    if "picture" in outputs:
        picture = found.image.clamp(0, 1)
        factor = max(1, turntable.view.size // picture.shape[-1])
        write_png(target.file("_reconstruction.png"), enlarge(picture, factor))
    if "turntable" in outputs or "video" in outputs:
        azimuths = [360 * frame / turntable.frames for frame in range(turntable.frames)]
        turned = render_textured(vertices, mesh.faces, mesh.directions, texture, azimuths, camera, turntable.view)
        turn = on_white(turned)
        for output, write in (("turntable", write_gif), ("video", write_mp4)):
            if output in outputs:
                write(target.file(*FILES[output]), turn, 2400 // turntable.frames)
    if "pose" in outputs:
        write_json(target.file("_pose.json"), _describe(found.pose, camera))


def _describe(pose: Pose, camera: CameraConfig) -> dict[str, float | list[float]]:
    """Return the pose of a single object in degrees and ndc, and the camera that sees it in its picture."""
    return {
        "azimuth_degrees": pose.azimuth.rad2deg().item() % 360,
        "elevation_degrees": pose.elevation.rad2deg().item(),
        "roll_degrees": pose.roll.rad2deg().item(),
        "center": pose.center[0].tolist(),
        "scale": pose.scale.item(),
        "camera_distance": camera.distance,
        "camera_field_of_view_degrees": camera.field_of_view,
    }
