"""Structure from motion on photographs of a category: COLMAP (Schoenberger & Frahm 2016), a baseline (paper 4.1)."""

import re
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from jaxtyping import UInt8
from torch import Tensor
from torch.nn import functional

from pipeline.errors import DataError, UserError
from pipeline.evaluation.statistics import Figure, mean_figure
from pipeline.ranges import Count, Several

PREFIX = re.compile(r"^([IWEF])\d{8} [\d:.]+ +\d+ (\S+\]) (.*)$")
"""What COLMAP's log puts before a message: level, date, time, thread; then where in its source."""

HEADER = re.compile(r"Log file created at: |Running on machine: |Running duration |Log line format: ")
"""How lines begin that stand before the first message."""

TIME = re.compile(r" in \d+\.\d+s")
"""How long a step took, where a message says it."""

NO_PAIR = "No good initial image pair found"


@dataclass(frozen=True)
class ColmapConfig:
    """How COLMAP is tried; everything else is its default."""

    photographs: Several
    """How many, from the start of the training split; all pairs of them are matched."""
    enlargement: Count
    """Factor on the photographs' size, bicubic; the paper names none."""


def run_colmap(
    images: UInt8[Tensor, "N 3 H W"], config: ColmapConfig, seed: int, folder: Path
) -> tuple[dict[str, Any], str]:
    """Extract SIFT features, match all pairs and map incrementally, in an empty folder; return figures and the log.

    `seed` is that of its random sampling.

    `features` a photograph, `verified_pairs` the fraction of pairs whose matches agree on a geometry, `registered` the
    fraction of photographs that found a place in the largest model, and what COLMAP `says`: its warnings and errors.

    pycolmap brings a compression library that breaks the PNG writers of Pillow and OpenCV in the same process: call
    this in a process of its own. Raises UserError where pycolmap is not installed, and DataError for one photograph.
    """
    if len(images) < 2:
        raise DataError("COLMAP matches photographs with each other, but there is only one; prepare two photographs")
    pycolmap = _import_pycolmap()
    chosen = _enlarged(images[: config.photographs], config.enlargement)
    pictures, models, database = folder / "pictures", folder / "models", folder / "database.db"
    for path in (pictures, models):
        path.mkdir()
    for number, image in enumerate(chosen):
        pycolmap.Bitmap.from_array(image.numpy()).write(pictures / f"{number:05d}.png")
    extraction, matching = pycolmap.FeatureExtractionOptions(), pycolmap.FeatureMatchingOptions()
    mapping = pycolmap.IncrementalPipelineOptions()
    mapping.random_seed = seed
    extraction.num_threads = matching.num_threads = mapping.num_threads = torch.get_num_threads()
    one_each, device = pycolmap.CameraMode.PER_IMAGE, pycolmap.Device.cpu
    pycolmap.set_random_seed(seed)
    with _logging_to(folder / "log", pycolmap):
        pycolmap.extract_features(
            database, pictures, camera_mode=one_each, extraction_options=extraction, device=device
        )
        pycolmap.match_exhaustive(database, matching_options=matching, device=device)
        found = pycolmap.incremental_mapping(database, pictures, models, options=mapping)
    log = _read_log(folder)
    registered = max((model.num_reg_images() for model in found.values()), default=0)
    figures = _database_figures(pycolmap.Database.open(database), pycolmap)
    figures["registered"] = mean_figure(torch.arange(len(chosen)) < registered)
    return figures | {"says": _verdict(log)}, log


def _import_pycolmap() -> Any:
    try:
        import pycolmap
    except ImportError:
        raise UserError(
            "pycolmap is not installed; install it with `.venv/bin/pip install -c constraints.txt -e '.[baselines]'`"
        ) from None
    return pycolmap


def _enlarged(images: UInt8[Tensor, "N 3 H W"], factor: int) -> UInt8[Tensor, "N height width 3"]:
    if factor > 1:
        enlarged = functional.interpolate(images.float(), scale_factor=factor, mode="bicubic")
        images = enlarged.round().clamp(0, 255).byte()
    return images.permute(0, 2, 3, 1).contiguous()


@contextmanager
def _logging_to(path: Path, pycolmap: Any) -> Iterator[None]:
    """Send COLMAP's log, of every level, to a file named `path` and a suffix, complete afterwards; fatal ones print."""
    logging = pycolmap.logging
    logging.alsologtostderr, logging.stderrthreshold = False, int(logging.Level.FATAL)
    for level in (logging.Level.WARNING, logging.Level.ERROR, logging.Level.FATAL):
        logging.set_log_destination(level, "")
    logging.set_log_destination(logging.Level.INFO, str(path))
    try:
        yield
    finally:
        logging.set_log_destination(logging.Level.INFO, "")


def _read_log(folder: Path) -> str:
    """Read the log's messages without what differs from run to run: dates, threads, the machine's name and times."""
    lines = "".join(path.read_text(encoding="utf-8") for path in sorted(folder.glob("log*"))).splitlines()
    messages = (TIME.sub("", PREFIX.sub(r"\1 \2 \3", line)) for line in lines if not HEADER.match(line))
    return "".join(message + "\n" for message in messages if " timer.cc:" not in message)


def _verdict(log: str) -> list[str]:
    """Choose warnings, errors and the missing initial pair, which COLMAP reports as information; each once."""
    lines = (line.split("] ", 1) for line in log.splitlines() if line.startswith(("W ", "E ")) or NO_PAIR in line)
    return list(dict.fromkeys(message.removeprefix("=> ") for _, message in lines))


def _database_figures(database: Any, pycolmap: Any) -> dict[str, Figure]:
    images = [image.image_id for image in database.read_all_images()]
    features = [database.num_keypoints_for_image(image) for image in images]
    pairs, agreeing = database.read_two_view_geometry_num_inliers()
    matched = (pycolmap.pair_id_to_image_pair(pair) for pair, count in zip(pairs, agreeing, strict=True) if count)
    partners = Counter(image for pair in matched for image in pair)
    return {
        "features": mean_figure(torch.tensor(features).double()),
        "verified_pairs": mean_figure(torch.tensor([partners[image] for image in images]) / (len(images) - 1)),
    }
