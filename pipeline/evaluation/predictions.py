"""What another method says of a category's pictures, read from one `.npz` file: the form is in docs/benchmark.md."""

import math
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from tokenize import TokenError
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from pipeline.datasets.archives import DAMAGE, LARGEST
from pipeline.errors import DataError, MeshError
from pipeline.evaluation.evaluate import PoseEstimates
from pipeline.geometry.camera import Pose
from pipeline.geometry.closed_mesh import enclosed_volume, is_closed
from pipeline.naming import did_you_mean

SPLIT = "test"
"""The section of the metrics in which poses of test pictures are measured."""
ENDING = ".npy"
"""Of a member of the file, after the name of its array."""
LEAST_VOLUME = 1e-6
"""Of a mesh in the unit cube; a flat one has less."""


class Counts(NamedTuple):
    """How many pictures a category has, and how large they are."""

    train: int
    test: int
    size: int


class Meshes(NamedTuple):
    """One closed mesh per test picture, in the frame of the poses."""

    vertices: Float[Tensor, "N V 3"]
    """As many for each picture; those that a mesh does not use are at the place of one that it uses."""
    faces: Sequence[Int[Tensor, "_ 3"]]
    """Those that all meshes share, or one entry a mesh."""


class Predictions(NamedTuple):
    """What a file has of each kind, or None where it has not."""

    poses: PoseEstimates | None
    """Centre and scale are not known."""
    masks: Bool[Tensor, "N H W"] | None
    """Of all test pictures."""
    meshes: Meshes | None
    images: UInt8[Tensor, "N H W 3"] | None
    """Reconstructions of all test pictures."""


class _Form(NamedTuple):
    """Which arrays are taken: `accepted` types of numbers, kept as `kept`, of a shape in which letters are any size."""

    accepted: type[np.generic]
    kept: type[np.generic]
    shapes: tuple[tuple[str | int, ...], ...]


FORMS = {
    "train_angles": _Form(np.floating, np.float32, (("M", 3),)),
    "train_index": _Form(np.integer, np.int64, (("M",),)),
    "test_angles": _Form(np.floating, np.float32, (("test", 3),)),
    "masks": _Form(np.bool_, np.bool_, (("test", "size", "size"),)),
    "vertices": _Form(np.floating, np.float64, (("test", "V", 3),)),
    "faces": _Form(np.integer, np.int64, (("F", 3), ("test", "F", 3))),
    "images": _Form(np.uint8, np.uint8, (("test", "size", "size", 3),)),
}
_WORDS = {np.floating: "floating-point numbers", np.integer: "whole numbers", np.bool_: "bool", np.uint8: "uint8"}
_DAMAGE_OF_ARRAYS = (KeyError, MemoryError, RuntimeError, SyntaxError, TokenError, ValueError)
"""What readers of an archive's arrays raise besides; MemoryError where an array claims to be larger than its file."""
_NEEDS = (
    ("train_index", "train_angles", "the poses of the pictures that it names"),
    ("test_angles", "train_angles", "by which the alignment is fitted"),
    ("vertices", "train_angles", "by which the alignment is fitted"),
    ("vertices", "faces", "which join them"),
    ("faces", "vertices", "which they join"),
)


def read_predictions(path: Path, counts: Counts) -> Predictions:
    """Read a file of predictions.

    Raises DataError for one that is no such file or is damaged, and for arrays that are unknown, missing, of another
    type or shape, not finite or out of range; MeshError for meshes that are open, flat or inside out.
    """
    arrays = _read_arrays(path, counts)
    for name, needed, why in _NEEDS:
        if name in arrays and needed not in arrays:
            raise DataError(f"{path} has '{name}', but no '{needed}', {why}; add them")
    poses = _poses(path, arrays, counts) if "train_angles" in arrays else None
    meshes = _meshes(path, arrays["vertices"], arrays["faces"]) if "vertices" in arrays else None
    return Predictions(poses, arrays.get("masks"), meshes, arrays.get("images"))


def _read_arrays(path: Path, counts: Counts) -> dict[str, Tensor]:
    with path.open("rb") as stream:
        try:
            with zipfile.ZipFile(stream) as archive:
                return {name: _checked(path, name, _read(archive, name), counts) for name in _names(path, archive)}
        except (*DAMAGE, *_DAMAGE_OF_ARRAYS):
            raise DataError(
                f"{path} is damaged, no .npz file, or holds Python objects; write it anew with numpy.savez, from "
                "arrays of numbers"
            ) from None


def _names(path: Path, archive: zipfile.ZipFile) -> list[str]:
    members = {member.filename.removesuffix(ENDING): member.file_size for member in archive.infolist()}
    if not members:
        raise DataError(f"{path} is empty; expected some of the arrays {', '.join(FORMS)}")
    for name, size in members.items():
        if name not in FORMS:
            raise DataError(f"{path} has an unknown array '{name}'{did_you_mean(name, FORMS)}")
        if size > LARGEST:
            raise DataError(f"{path}: '{name}' is larger than a gibibyte; write it as float32, or with fewer vertices")
    return list(members)


def _read(archive: zipfile.ZipFile, name: str) -> np.ndarray:
    with archive.open(f"{name}{ENDING}") as stream:
        return np.lib.format.read_array(stream, allow_pickle=False)


def _checked(path: Path, name: str, array: np.ndarray, counts: Counts) -> Tensor:
    """Return an array as a tensor of the type that is kept, if it is of the form that its name stands for."""
    where, form = f"{path}: '{name}'", FORMS[name]
    if not np.issubdtype(array.dtype, form.accepted):
        raise DataError(f"{where} holds {array.dtype}; expected {_WORDS[form.accepted]}")
    sizes = counts._asdict()
    shapes = [tuple(sizes.get(str(side), side) for side in shape) for shape in form.shapes]
    if not any(_fits(array.shape, shape) for shape in shapes):
        raise DataError(f"{where} has the shape {_text(array.shape)}; expected {' or '.join(map(_text, shapes))}")
    with np.errstate(over="ignore"):
        kept = array.astype(form.kept)
    finite = np.isfinite(kept).reshape(len(kept), -1).all(axis=1)
    if not finite.all():
        raise DataError(f"{where} has NaN or infinity in its entry {finite.argmin()}; expected finite numbers")
    return torch.from_numpy(kept)


def _fits(shape: tuple[int, ...], expected: tuple[str | int, ...]) -> bool:
    return len(shape) == len(expected) and all(
        side > 0 if isinstance(at, str) else side == at for side, at in zip(shape, expected, strict=True)
    )


def _text(values: Iterable[str | float]) -> str:
    return f"({', '.join(map(str, values))})"


def _poses(path: Path, arrays: Mapping[str, Tensor], counts: Counts) -> PoseEstimates:
    index = arrays.get("train_index", torch.arange(counts.train))
    if not bool(((index >= 0) & (index < counts.train)).all()) or len(index.unique()) < len(index):
        raise DataError(f"{path}: 'train_index' must name pictures from 0 to {counts.train - 1}, each once at most")
    found = len(arrays["train_angles"])
    if found != len(index):
        raise DataError(f"{path}: 'train_angles' has {found} rows; expected {len(index)}, or 'train_index' of as many")
    poses = {
        name: _pose(f"{path}: '{name}'", arrays[name]) for name in ("train_angles", "test_angles") if name in arrays
    }
    test = {SPLIT: poses["test_angles"]} if "test_angles" in poses else {}
    return PoseEstimates(poses["train_angles"], index, test)


def _pose(where: str, angles: Float[Tensor, "N 3"]) -> Pose:
    limits = torch.tensor([2 * math.pi, math.pi / 2, 2 * math.pi])
    beyond = (angles.abs() > limits + 1e-5).any(dim=1)
    if beyond.any():
        raise DataError(
            f"{where} has {_text(angles[beyond][0].tolist())} in its entry {int(beyond.int().argmax())}; expected "
            "azimuth, elevation and roll in radians: elevation within pi / 2, the others within 2 pi"
        )
    azimuth, elevation, roll = angles.unbind(dim=1)
    return Pose(azimuth, elevation, roll, torch.full((len(angles), 2), math.nan), torch.full((len(angles),), math.nan))


def _meshes(path: Path, vertices: Float[Tensor, "N V 3"], faces: Int[Tensor, "F 3"] | Int[Tensor, "N F 3"]) -> Meshes:
    """Take off what fills up, and require solids; vertices in float64 become float32."""
    rows = faces if faces.ndim == 3 else faces[None]
    valid = ((rows >= 0) & (rows < vertices.shape[1])).all(dim=2)
    if not bool((valid | (rows == -1).all(dim=2)).all()) or not bool(valid.any(dim=1).all()):
        raise MeshError(
            f"{path}: 'faces' must name vertices from 0 to {vertices.shape[1] - 1}, at least one triple a mesh; -1 "
            "fills up where others have more"
        )
    own = [some[keep] for some, keep in zip(rows, valid, strict=True)]
    parts = zip(vertices.split(len(vertices) // len(own)), own, strict=True)
    kept = torch.cat([_at_hand(_without_unused(shapes, joined)).float() for shapes, joined in parts])
    for number, (shape, joined) in enumerate(zip(kept, own * (len(kept) // len(own)), strict=True)):
        _require_solid(f"{path}: the mesh of 'vertices' and 'faces' for picture {number}", shape, joined)
    return Meshes(kept, own)


def _without_unused(vertices: Float[Tensor, "B V 3"], faces: Int[Tensor, "F 3"]) -> Float[Tensor, "B V 3"]:
    used = faces.unique()
    kept = vertices[:, used[:1]].repeat(1, vertices.shape[1], 1)
    kept[:, used] = vertices[:, used]
    return kept


def _at_hand(vertices: Float[Tensor, "B V 3"]) -> Float[Tensor, "B V 3"]:
    """Bring meshes of any size and place to where float32 resolves them.

    They are moved by whole lengths of their longest side and scaled by powers of two: no digit of those that are
    around the origin changes.
    """
    lower, upper = vertices.amin(dim=1, keepdim=True), vertices.amax(dim=1, keepdim=True)
    longest_side = (upper - lower).amax(dim=2, keepdim=True).clamp(min=torch.finfo(vertices.dtype).tiny)
    moved = vertices - ((lower + upper) / 2 / longest_side).round() * longest_side
    return moved * torch.exp2(-longest_side.frexp().exponent.to(vertices))


def _require_solid(which: str, vertices: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"]) -> None:
    if not is_closed(vertices, faces):
        raise MeshError(f"{which} is not closed: expected every edge to join faces of one orientation; fill its holes")
    volume = enclosed_volume(vertices[None], faces).item()
    if not volume > LEAST_VOLUME:
        raise MeshError(
            f"{which} encloses a volume of {volume:.1g} when scaled into the unit cube: it is flat or inside out; "
            "expected faces that are counter-clockwise from outside"
        )
