"""A project with a tiny trained model, calls of `kato3d reconstruct` on it, and what they should give."""

from pathlib import Path

import numpy as np
import torch
from jaxtyping import UInt8
from PIL import Image
from torch import Tensor

from pipeline.cli.__main__ import main
from pipeline.export.views import TurntableConfig
from pipeline.networks.feature_extractor import extract, load_feature_extractor, save_feature_extractor
from pipeline.networks.full_model import Reconstruction, save_full_model
from pipeline.networks.wide_resnet import WideResNet
from pipeline.seeding import initialised
from tests.report_inputs import VIEW
from tests.tiny_full_model import tiny_model

TURNTABLE = TurntableConfig(frames=4, view=VIEW)


def save_models(project: Path) -> None:
    """Save the tiny model and a network of features as those of the run `toybox-car`."""
    save_full_model(project / "models/full/toybox-car.safetensors", tiny_model(), {})
    with initialised(1):
        network = WideResNet(10, 1, 2)
    save_feature_extractor(project / "models/features/toybox-laptop.safetensors", network, 2.0, {})


def reconstruct(project: Path, *words: str) -> list[str]:
    out = project / "out"
    main(["reconstruct", "--project", str(project), *words, "--out", str(out)])
    return sorted(path.relative_to(out).as_posix() for path in out.rglob("*") if path.suffix)


def inferred(project: Path, images: UInt8[Tensor, "B 3 H W"]) -> Reconstruction:
    """Return what the project's model reads off photographs."""
    path = project / "models/features/toybox-laptop.safetensors"
    extractor = load_feature_extractor(path, torch.device("cpu"), torch.float32)
    features = [layer.float() for layer in extract(extractor, images, len(images))]
    return tiny_model().eval().infer(images / 255, features)


def pixels(path: Path) -> UInt8[Tensor, "H W 3"]:
    """Read a picture."""
    with Image.open(path) as picture:
        return torch.from_numpy(np.asarray(picture.convert("RGB")).copy())
