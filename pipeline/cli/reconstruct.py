"""Photographs to textured meshes, with the model of a run."""

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import torch
from jaxtyping import Float, UInt8
from PIL import Image
from torch import Tensor
from tqdm import tqdm

from pipeline.cli.runs import Run
from pipeline.config import load
from pipeline.datasets.decoding import decode
from pipeline.datasets.folder import FolderConfig
from pipeline.errors import DataError
from pipeline.export.glb import write_glb
from pipeline.export.obj import write_obj
from pipeline.export.picture import enlarge, write_png
from pipeline.export.report import ReportConfig
from pipeline.export.seam import unwrap
from pipeline.export.views import on_white, render_textured
from pipeline.files import atomic_path, write_json
from pipeline.geometry.camera import Pose, pose_from_tensor
from pipeline.networks.feature_extractor import load_feature_extractor
from pipeline.networks.full_model import FullModel, load_full_model
from pipeline.training.checkpoint import Checkpoint
from pipeline.training.fine_tune import FineTuneConfig, fine_tune


class Found(NamedTuple):
    """What a model reads off photographs."""

    vertices: Float[Tensor, "B V 3"]
    textures: Float[Tensor, "B 3 T T"]
    pose: Pose
    images: Float[Tensor, "B 3 H W"]
    """The reconstructions, rendered over their backgrounds."""


def reconstruct(paths: Sequence[Path], run: Run, out: Path, tuned: bool, device: torch.device) -> None:
    """Write the mesh of each photograph (GLB, OBJ), its turntable, its reconstruction and its pose.

    Files are named after the photograph. Raises DataError where a photograph cannot be read, or two share a name.
    """
    _require_different_names(paths)
    model = load_full_model(run.model, device)
    folder = load(run.params, FolderConfig, ["prepare_data.folder"])
    pictures = [decode(_bytes(path), str(path), model.config.renderer.size, folder.fit) for path in paths]
    images = torch.stack([torch.from_numpy(picture.copy()).permute(2, 0, 1) for picture in pictures]).to(device)
    found = _fine_tuned(images, model, run) if tuned else _inferred(images, model)
    report = load(run.params, ReportConfig, ["report"])
    for index, path in enumerate(tqdm(paths, "writing meshes", disable=None)):
        _write(out, path.stem, index, found, model, report)


@torch.no_grad()
def _inferred(images: UInt8[Tensor, "B 3 H W"], model: FullModel) -> Found:
    scene = model.infer(images.float() / 255)
    return Found(scene.vertices.cpu(), scene.texture_maps.cpu(), _cpu(scene.pose), model.render(scene).cpu())


def _fine_tuned(images: UInt8[Tensor, "B 3 H W"], model: FullModel, run: Run) -> Found:
    config = load(run.params, FineTuneConfig, ["fine_tune", f"sizes.{run.size}.fine_tune"])
    extractor = load_feature_extractor(run.features, images.device)
    with tempfile.TemporaryDirectory() as folder:
        results = fine_tune(config, images, model, extractor, Checkpoint(Path(folder), "reconstruct"))
    pose = pose_from_tensor(results["pose_tuned"])
    return Found(results["vertices_tuned"], results["textures"], pose, results["images_tuned"].float() / 255)


def _write(out: Path, name: str, index: int, found: Found, model: FullModel, report: ReportConfig) -> None:
    vertices, texture = found.vertices[index], found.textures[index]
    faces, directions = model.faces.cpu(), model.directions.cpu()
    mesh = unwrap(vertices, faces, directions, texture.shape[-1])
    write_glb(out / f"{name}.glb", mesh, texture)
    write_obj(out / f"{name}.obj", mesh, texture)
    picture = found.images[index].clamp(0, 1)
    write_png(out / f"{name}_reconstruction.png", enlarge(picture, max(1, report.view.size // picture.shape[-1])))
    azimuths = [360 * frame / report.frames for frame in range(report.frames)]
    camera = model.config.renderer.camera
    turn = on_white(render_textured(vertices, faces, directions, texture, azimuths, camera, report.view))
    write_gif(out / f"{name}_turntable.gif", turn, milliseconds=2400 // report.frames)
    write_json(out / f"{name}_pose.json", describe(found.pose, index))


def describe(pose: Pose, index: int) -> dict[str, float | list[float]]:
    """Return one pose in degrees and ndc."""
    return {
        "azimuth_degrees": pose.azimuth[index].rad2deg().item() % 360,
        "elevation_degrees": pose.elevation[index].rad2deg().item(),
        "roll_degrees": pose.roll[index].rad2deg().item(),
        "center": pose.center[index].tolist(),
        "scale": pose.scale[index].item(),
    }


def write_gif(path: Path, frames: Float[Tensor, "K 3 H W"], milliseconds: int) -> None:
    """Write an endless animation, atomically."""
    pixels = (frames.clamp(0, 1) * 255).round().byte().permute(0, 2, 3, 1).numpy()
    first, *others = [Image.fromarray(frame) for frame in pixels]
    with atomic_path(path) as temporary:
        first.save(temporary, "GIF", save_all=True, append_images=others, duration=milliseconds, loop=0)


def _bytes(path: Path) -> bytes:
    if not path.is_file():
        raise DataError(f"{path} does not exist; give the path of a photograph")
    return path.read_bytes()


def _require_different_names(paths: Sequence[Path]) -> None:
    seen: dict[str, Path] = {}
    for path in paths:
        if path.stem in seen:
            raise DataError(f"{seen[path.stem]} and {path} would both be written as {path.stem}.glb; rename one")
        seen[path.stem] = path


def _cpu(pose: Pose) -> Pose:
    return Pose(*(values.cpu() for values in pose))
