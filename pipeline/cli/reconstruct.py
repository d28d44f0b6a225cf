"""Photographs to textured meshes, with the model of a run or one that comes with the project."""

import hashlib
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path, PurePath
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor
from tqdm import tqdm

from pipeline.cli.finishing import Picture, Reading, Writing, writing
from pipeline.cli.gallery import write_gallery
from pipeline.cli.outputs import Found
from pipeline.cli.photographs import RECORD, Target, Task, find_targets
from pipeline.cli.runs import Pretrained, Run
from pipeline.cli.workers import workers
from pipeline.config import load, scalar
from pipeline.datasets.archives import is_hidden
from pipeline.datasets.decoding import Fit, reading
from pipeline.datasets.prepare import load_prepare
from pipeline.device import resolve_precision
from pipeline.errors import DataError
from pipeline.export.animation import encoder
from pipeline.export.painting import PaintingConfig
from pipeline.export.views import TurntableConfig
from pipeline.files import alone, read_json, sha256, write_json
from pipeline.geometry.camera import Pose, pose_from_tensor
from pipeline.networks.feature_extractor import FeatureExtractor, extract, load_feature_extractor
from pipeline.networks.full_model import FullModel, load_full_model
from pipeline.training.checkpoint import Checkpoint
from pipeline.training.fine_tune import FineTuneConfig, fine_tune

PAGE = "index.html"
"""Shows the meshes in the folder of outputs, first those of the last call."""
PAGED = ("mesh", "picture", "pose")
"""Outputs that a photograph needs to be on the page."""


class Steps(NamedTuple):
    """What is done to a photograph beyond reading shape, pose, texture and background off it."""

    fine_tune: bool
    """Fit background, pose and shape (paper section 3.2.4)."""
    paint: bool
    """Paint the mesh with the photograph."""

    @property
    def title(self) -> str:
        """What pages add to the name of the model."""
        return (", fine-tuned" if self.fine_tune else "") + (", painted" if self.paint else "")


class Settings(NamedTuple):
    """Parameters that say what comes out."""

    fine_tune: FineTuneConfig
    paint: PaintingConfig
    fit: Fit
    turntable: TurntableConfig


class Outcome(NamedTuple):
    """What became of the photographs."""

    written: int
    skipped: int
    """Already reconstructed by an earlier call."""
    failures: list[str]
    """One sentence for each photograph that cannot be reconstructed, or shown because its outputs are damaged."""
    page: Path | None
    """Where the meshes can be looked at, if there are any."""


def reconstruct(
    tasks: Sequence[Task],
    trained: Run | Pretrained,
    out: Path,
    outputs: Sequence[str],
    steps: Steps,
    device: torch.device,
) -> Outcome:
    """Write the outputs of each photograph, in batches, going on where an earlier call for the same folder stopped.

    Raises DataError where the folder holds anything else, reconstructions by another model or with other steps or
    settings among it, and where another call is writing to it; ConfigError for films without their encoder.
    """
    if "video" in outputs:
        encoder()  # not missed only after the first photograph
    model, settings = load_full_model(trained.model, device), _load_settings(trained)
    precision = resolve_precision(scalar(trained.params, "precision"), device)
    extractor = load_feature_extractor(trained.features, device, precision)
    way = _way(trained, settings, steps)
    read = Reading(model.config.renderer.size, settings.fit)
    write = writing(model, read, outputs, settings.turntable, settings.paint if steps.paint else None)

    def find(images: UInt8[Tensor, "B 3 H W"]) -> list[Found]:
        write_json(out / RECORD, way)
        if steps.fine_tune:
            return _fine_tuned(images.to(device), model, extractor, settings.fine_tune)
        return _inferred(images.to(device), model, extractor)

    is_new = not out.exists()
    with alone(out / RECORD):
        _require_same_way(out, way)
        waiting, failures = _waiting(tasks, outputs)
        skipped = len(tasks) - len(waiting) - len(failures)
        results = _in_batches(waiting, settings.fine_tune.batch_size, read, find, write)
        progress = tqdm(results, "reconstructing", len(waiting), unit="photograph", disable=None)
        failed = [sentence for sentence in progress if sentence is not None]
        latest = {task.target for task in tasks}
        done = sorted(find_targets(out, PAGED), key=lambda target: target not in latest)
        damaged = write_gallery(out / PAGE, done, model.config.renderer.camera, f"{trained.title}{steps.title}")
        failures = [*failures, *failed, *damaged]
        page = out / PAGE if (out / PAGE).is_file() else None
    if is_new and not any(out.iterdir()):
        out.rmdir()
    return Outcome(len(waiting) - len(failed), skipped, failures, page)


def _in_batches(
    tasks: Sequence[Task],
    size: int,
    read: Reading,
    find: Callable[[UInt8[Tensor, "B 3 H W"]], list[Found]],
    write: Writing,
) -> Iterator[str | None]:
    """Read, find and write; yield for each photograph None, or a sentence that says why it could not be done."""
    with workers(len(tasks)) as divide:
        for start in range(0, len(tasks), size):
            readings = list(divide(read, tasks[start : start + size]))
            yield from (sentence for sentence in readings if isinstance(sentence, str))
            pictures = [picture for picture in readings if isinstance(picture, Picture)]
            if pictures:
                images = torch.from_numpy(np.stack([picture.pixels for picture in pictures])).permute(0, 3, 1, 2)
                yield from divide(write, list(zip(pictures, find(images.contiguous()), strict=True)))


def _load_settings(trained: Run | Pretrained) -> Settings:
    params, of_size = trained.params, f"sizes.{trained.size}.fine_tune"
    return Settings(
        replace(load(params, FineTuneConfig, ["fine_tune", of_size]), photographs=None),
        load(params, PaintingConfig, ["paint"]),
        trained.fit if isinstance(trained, Pretrained) else load_prepare(params, trained.dataset).fit,
        load(params, TurntableConfig, ["turntable"]),
    )


def _way(trained: Run | Pretrained, settings: Settings, steps: Steps) -> dict[str, str | bool]:
    """Say how reconstructions are made, so that a folder holds those of one way alone."""
    tuning = replace(settings.fine_tune, batch_size=1)  # which changes what comes out by rounding alone
    chosen = [*([tuning] if steps.fine_tune else []), *([settings.paint] if steps.paint else [])]
    text = repr([settings.fit, settings.turntable, sha256(trained.features), *chosen])
    return {"model": sha256(trained.model), **steps._asdict(), "settings": hashlib.sha256(text.encode()).hexdigest()}


def _waiting(tasks: Sequence[Task], outputs: Sequence[str]) -> tuple[list[Task], list[str]]:
    """Leave out photographs that are reconstructed, and say a sentence for each of those that cannot be."""
    waiting, failures = [], []
    first: dict[Target, Path] = {}
    for task in tasks:
        other = first.setdefault(task.target, task.photograph)
        if other != task.photograph:
            failures.append(f"the outputs of {task.photograph} would be written over those of {other}; rename one")
            continue
        try:
            with reading(str(task.photograph)):
                done = task.done(outputs)
        except DataError as error:
            failures.append(str(error))
        else:
            waiting.extend([] if done else [task])
    return waiting, failures


@torch.no_grad()
def _inferred(images: UInt8[Tensor, "B 3 H W"], model: FullModel, extractor: FeatureExtractor) -> list[Found]:
    features = [layer.float() for layer in extract(extractor, images, len(images))]
    scene = model.infer(images.float() / 255, features)
    pose = Pose(*(values.cpu() for values in scene.pose))
    vertices, textures, backgrounds = scene.vertices.cpu(), scene.texture_maps.cpu(), scene.backgrounds.cpu()
    return _separate(vertices, textures, pose, backgrounds, model.render(scene).cpu())


def _fine_tuned(
    images: UInt8[Tensor, "B 3 H W"], model: FullModel, extractor: FeatureExtractor, config: FineTuneConfig
) -> list[Found]:
    with tempfile.TemporaryDirectory() as folder:
        results = fine_tune(config, images, model, extractor, Checkpoint(Path(folder), "reconstruct"))
    pose = pose_from_tensor(results["pose_tuned"])
    backgrounds, rendered = (results[name].float() / 255 for name in ("backgrounds_tuned", "images_tuned"))
    return _separate(results["vertices_tuned"], results["textures"], pose, backgrounds, rendered)


def _separate(
    vertices: Float[Tensor, "B V 3"],
    textures: Float[Tensor, "B 3 T T"],
    pose: Pose,
    backgrounds: Float[Tensor, "B 3 H W"],
    images: Float[Tensor, "B 3 H W"],
) -> list[Found]:
    """Take a batch apart, into copies: pickled, a view holds all of its batch."""
    return [
        Found(
            vertices[index : index + 1].clone(),
            textures[index].clone(),
            Pose(*(values[index : index + 1].clone() for values in pose)),
            backgrounds[index : index + 1].clone(),
            images[index].clone(),
        )
        for index in range(len(images))
    ]


def _require_same_way(out: Path, way: dict[str, str | bool]) -> None:
    record = out / RECORD
    if not record.is_file():
        others = [path for path in out.iterdir() if not is_hidden(PurePath(path.name))] if out.is_dir() else []
        if others:  # which outputs of the same name would replace
            raise DataError(f"{out} holds {others[0].name}, which is no reconstruction; name a new or an empty folder")
    elif read_json(record) != way:
        raise DataError(
            f"{out} holds reconstructions by another model or with other steps or settings ({RECORD}); name another "
            "folder, or remove this one"
        )
