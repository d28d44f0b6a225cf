"""Photographs to textured meshes, with the model of a run."""

import hashlib
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import torch
from jaxtyping import Float, UInt8
from torch import Tensor
from tqdm import tqdm

from pipeline.cli.photographs import FILES, Task
from pipeline.cli.runs import Run
from pipeline.config import load, scalar
from pipeline.datasets.decoding import Fit, decode, reading
from pipeline.datasets.prepare import PrepareConfig
from pipeline.device import resolve_precision
from pipeline.errors import DataError
from pipeline.export.animation import write_gif, write_mp4
from pipeline.export.glb import write_glb
from pipeline.export.obj import write_obj
from pipeline.export.picture import enlarge, write_png
from pipeline.export.report import ReportConfig
from pipeline.export.seam import unwrap
from pipeline.export.views import on_white, render_textured
from pipeline.files import read_json, sha256, write_json
from pipeline.geometry.camera import Pose, pose_from_tensor
from pipeline.networks.feature_extractor import FeatureExtractor, extract, load_feature_extractor
from pipeline.networks.full_model import FullModel, load_full_model
from pipeline.training.checkpoint import Checkpoint
from pipeline.training.fine_tune import FineTuneConfig, fine_tune

RECORD = "reconstruct.json"
"""Says in the folder of outputs which model made them, and how."""


class Found(NamedTuple):
    """What a model reads off photographs."""

    vertices: Float[Tensor, "B V 3"]
    textures: Float[Tensor, "B 3 T T"]
    pose: Pose
    images: Float[Tensor, "B 3 H W"]
    """The reconstructions, rendered over their backgrounds."""


class Outcome(NamedTuple):
    """What became of the photographs."""

    written: int
    skipped: int
    """Already reconstructed by an earlier call."""
    failures: list[str]
    """One sentence for each photograph that cannot be reconstructed."""


def reconstruct(
    tasks: Sequence[Task], run: Run, out: Path, outputs: Sequence[str], tuned: bool, device: torch.device
) -> Outcome:
    """Write the outputs of each photograph, in batches, going on where an earlier call for the same folder stopped.

    Raises DataError where the folder holds reconstructions by another model, or with other steps or settings.
    """
    model = load_full_model(run.model, device)
    config = load(run.params, FineTuneConfig, ["fine_tune", f"sizes.{run.size}.fine_tune"])
    fit = load(run.params, PrepareConfig, ["prepare_data", f"datasets.{run.dataset}"]).fit
    report = load(run.params, ReportConfig, ["report"])
    steps = replace(config, photographs=None, batch_size=1)  # neither changes what comes out
    settings = repr([fit, report.frames, report.view, sha256(run.features), *([steps] if tuned else [])])
    way = {"model": sha256(run.model), "fine_tune": tuned, "settings": hashlib.sha256(settings.encode()).hexdigest()}
    _require_same_way(out, way)
    write_json(out / RECORD, way)
    waiting = [task for task in tasks if not task.done(outputs)]
    extractor = load_feature_extractor(run.features, device, resolve_precision(scalar(run.params, "precision"), device))
    find = (
        partial(_fine_tuned, model=model, extractor=extractor, config=replace(config, photographs=None))
        if tuned
        else partial(_inferred, model=model, extractor=extractor)
    )
    failures: list[str] = []
    with tqdm(total=len(waiting), desc="reconstructing", unit="photograph", disable=None) as progress:
        for start in range(0, len(waiting), config.batch_size):
            readable, images = _read(waiting[start : start + config.batch_size], model, fit, failures)
            progress.update(min(config.batch_size, len(waiting) - start) - len(readable))
            if not readable:
                continue
            found = find(images.to(device))
            for index, task in enumerate(readable):
                _write(task, index, found, model, report, outputs)
                progress.update()
    return Outcome(len(waiting) - len(failures), len(tasks) - len(waiting), failures)


def _read(
    tasks: Sequence[Task], model: FullModel, fit: Fit, failures: list[str]
) -> tuple[list[Task], UInt8[Tensor, "B 3 H W"]]:
    """Decode photographs; return those that can be read, and add a sentence to the failures for each of the others."""
    size = model.config.renderer.size
    readable, images = [], [torch.zeros(0, 3, size, size, dtype=torch.uint8)]
    for task in tasks:
        try:
            with reading(str(task.photograph)):
                content = task.photograph.read_bytes()
            picture = decode(content, str(task.photograph), size, fit)
        except DataError as error:
            failures.append(str(error))
        else:
            readable.append(task)
            images.append(torch.from_numpy(picture.copy()).permute(2, 0, 1)[None])
    return readable, torch.cat(images)


@torch.no_grad()
def _inferred(images: UInt8[Tensor, "B 3 H W"], model: FullModel, extractor: FeatureExtractor) -> Found:
    features = [layer.float() for layer in extract(extractor, images, len(images))]
    scene = model.infer(images.float() / 255, features)
    return Found(scene.vertices.cpu(), scene.texture_maps.cpu(), _cpu(scene.pose), model.render(scene).cpu())


def _fine_tuned(
    images: UInt8[Tensor, "B 3 H W"], model: FullModel, extractor: FeatureExtractor, config: FineTuneConfig
) -> Found:
    with tempfile.TemporaryDirectory() as folder:
        results = fine_tune(config, images, model, extractor, Checkpoint(Path(folder), "reconstruct"))
    pose = pose_from_tensor(results["pose_tuned"])
    return Found(results["vertices_tuned"], results["textures"], pose, results["images_tuned"].float() / 255)


def _write(
    task: Task, index: int, found: Found, model: FullModel, report: ReportConfig, outputs: Sequence[str]
) -> None:
    vertices, texture = found.vertices[index], found.textures[index]
    faces, directions = model.faces.cpu(), model.directions.cpu()
    if "mesh" in outputs:
        mesh = unwrap(vertices, faces, directions, texture.shape[-1])
        write_glb(task.file(".glb"), mesh, texture)
        write_obj(task.file(".obj"), mesh, texture)
    if "picture" in outputs:
        picture = found.images[index].clamp(0, 1)
        factor = max(1, report.view.size // picture.shape[-1])
        write_png(task.file("_reconstruction.png"), enlarge(picture, factor))
    if "turntable" in outputs or "video" in outputs:
        azimuths = [360 * frame / report.frames for frame in range(report.frames)]
        camera = model.config.renderer.camera
        turn = on_white(render_textured(vertices, faces, directions, texture, azimuths, camera, report.view))
        for output, write in (("turntable", write_gif), ("video", write_mp4)):
            if output in outputs:
                write(task.file(*FILES[output]), turn, 2400 // report.frames)
    if "pose" in outputs:
        write_json(task.file("_pose.json"), describe(found.pose, index))


def describe(pose: Pose, index: int) -> dict[str, float | list[float]]:
    """Return one pose in degrees and ndc."""
    return {
        "azimuth_degrees": pose.azimuth[index].rad2deg().item() % 360,
        "elevation_degrees": pose.elevation[index].rad2deg().item(),
        "roll_degrees": pose.roll[index].rad2deg().item(),
        "center": pose.center[index].tolist(),
        "scale": pose.scale[index].item(),
    }


def _require_same_way(out: Path, way: dict[str, str | bool]) -> None:
    record = out / RECORD
    if record.is_file() and read_json(record) != way:
        raise DataError(
            f"{out} holds reconstructions by another model or with other steps or settings ({RECORD}); name another "
            "folder, or remove this one"
        )


def _cpu(pose: Pose) -> Pose:
    return Pose(*(values.cpu() for values in pose))
