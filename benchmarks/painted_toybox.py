"""Reconstruct toybox objects from photographs four times as large as the model's, with and without painting.

Run `python -m benchmarks.painted_toybox FOLDER` after `make repro`, or with `--pretrained car` (or `horse`) before it.
A folder in FOLDER, named after the model, gets photographs of the first test objects, which it has not learned from,
and what `kato3d reconstruct --fine-tune` makes of them, of a pretrained model the painted ones alone; `--figure
OUT.png` draws them too.
"""

from argparse import ArgumentParser
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from PIL import Image, ImageSequence
from torch import Tensor

from pipeline.cli.photographs import list_tasks
from pipeline.cli.reconstruct import Steps, reconstruct
from pipeline.cli.runs import find_pretrained, find_run
from pipeline.config import load, scalar
from pipeline.datasets.toybox.toybox import ToyboxConfig, make_toybox
from pipeline.device import resolve_device
from pipeline.export.picture import sheet, write_png

RUN, CATEGORY = "toybox-car", "car"
PRETRAINED = ("car", "horse")
SIZE, COUNT = 128, 10
OUTPUTS = ("mesh", "picture", "turntable", "pose")
SIDES = {"from one corner": 45, "from the opposite corner": 225}


def write_photographs(folder: Path, params: Path, category: str) -> None:
    """Photograph the first test objects of a category in the places and the light of the toybox."""
    usual = load(params, ToyboxConfig, ["prepare_data.toybox"])
    large = replace(usual.photograph, size=SIZE, supersampling=2)
    toybox = make_toybox(replace(usual, train_count=1, test_count=COUNT, photograph=large))
    folder.mkdir(parents=True, exist_ok=True)
    for index, pixels in enumerate(toybox.images["test"][category]):
        Image.fromarray(pixels).save(folder / f"{index:02d}.png")


def draw(photographs: Sequence[Path], folders: Mapping[str, Path]) -> Float[Tensor, "3 H W"]:
    """Lay photographs and, way by way, reconstructions and the objects from two sides below each other."""
    rows = {"photograph": _stack([_read(path) for path in photographs])}
    for way, folder in folders.items():
        files = [folder / path.stem for path in photographs]
        rows[f"{way}: reconstruction"] = _stack([_read(Path(f"{file}_reconstruction.png")) for file in files])
        for side, azimuth in SIDES.items():
            rows[f"{way}: the object {side}"] = _stack(
                [_frame(Path(f"{file}_turntable.gif"), azimuth) for file in files]
            )
    return sheet(rows)


def _read(path: Path) -> Image.Image:
    with Image.open(path) as picture:
        return picture.convert("RGB")


def _frame(path: Path, azimuth: int) -> Image.Image:
    with Image.open(path) as turntable:
        frames = [frame.convert("RGB") for frame in ImageSequence.Iterator(turntable)]
    return frames[azimuth * len(frames) // 360]


def _stack(pictures: Sequence[Image.Image]) -> Float[Tensor, "K 3 H W"]:
    pixels = np.stack([np.asarray(picture.resize((SIZE, SIZE))) for picture in pictures])
    return torch.from_numpy(pixels).permute(0, 3, 1, 2) / 255


def main() -> None:
    """Write photographs, reconstructions and the figure."""
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, metavar="FOLDER")
    parser.add_argument("--pretrained", choices=PRETRAINED, help="the model that comes with the code, and its category")
    parser.add_argument("--figure", type=Path, help="a picture of all of them")
    arguments = parser.parse_args()
    pretrained = arguments.pretrained
    trained = find_pretrained(Path(), pretrained) if pretrained else find_run(Path(), RUN)
    device = resolve_device(scalar(trained.params, "device"))
    folder = arguments.folder / trained.name
    photographs = folder / "photographs"
    write_photographs(photographs, trained.params, pretrained or CATEGORY)
    folders = {way: folder / way for way in (["painted"] if pretrained else ["predicted", "painted"])}
    for way, out in folders.items():
        steps = Steps(fine_tune=True, paint=way == "painted")
        reconstruct(list_tasks([photographs], out), trained, out, OUTPUTS, steps, device)
    if arguments.figure:
        write_png(arguments.figure, draw(sorted(photographs.glob("*.png")), folders))


if __name__ == "__main__":
    main()
