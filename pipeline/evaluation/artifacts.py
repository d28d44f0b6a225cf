"""What evaluation and report read of the chain's artifacts: reconstructions of the test pictures, and ground truth."""

from pathlib import Path
from typing import NamedTuple
from zipfile import BadZipFile

import numpy
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from pipeline.datasets.images import load_images, to_colors
from pipeline.errors import DataError
from pipeline.files import read_json
from pipeline.geometry.camera import Pose, fill_picture, pose_from_tensor
from pipeline.networks.pose_coordinates import Framing
from pipeline.rendering.renderer import Mesh, RendererConfig, render
from pipeline.tensor_files import load_tensors

STATES = ("predicted", "tuned")


class Snapshot(NamedTuple):
    """The test pictures as the model explains them, in one state."""

    pose: Pose
    """Camera pose in the learned frame."""
    vertices: Float[Tensor, "B V 3"]
    """Learned frame, unit cube."""
    backgrounds: Float[Tensor, "B 3 H W"]
    """What is behind the object, in [0, 1]."""
    images: Float[Tensor, "B 3 H W"]
    """The rendering, in [0, 1]."""


class Reconstructions(NamedTuple):
    """Reconstructions before (`predicted`) and after (`tuned`) fine-tuning, and what both share."""

    predicted: Snapshot
    tuned: Snapshot
    textures: Float[Tensor, "B 3 T T"]
    """One map per picture, in [0, 1]."""
    faces: Int[Tensor, "F 3"]
    directions: Float[Tensor, "V 3"]
    """Each vertex's point on the unit sphere, the texture domain."""
    test_index: Int[Tensor, " B"]
    """Position of each picture in the test split."""

    def at(self, state: str) -> Snapshot:
        """Return what one of `STATES` left."""
        return {"predicted": self.predicted, "tuned": self.tuned}[state]


class Truth(NamedTuple):
    """Ground truth of one split of a category: viewpoints, and the objects where they are known."""

    pose: Pose
    """In the dataset's frame; where viewpoints alone are known, the centre is 0 and the scale NaN."""
    objects: "TrueObjects | None"


class TrueObjects(NamedTuple):
    """Shapes and masks of pictures; shapes share their faces and fit the unit cube."""

    masks: Bool[Tensor, "B H W"]
    vertices: Float[Tensor, "B V 3"]
    faces: Int[Tensor, "F 3"]


def load_reconstructions(path: Path) -> Reconstructions:
    """Read the artifact of `fine_tune`."""
    tensors, _ = load_tensors(path)

    def at(state: str) -> Snapshot:
        return Snapshot(
            pose_from_tensor(tensors[f"pose_{state}"]),
            tensors[f"vertices_{state}"],
            tensors[f"backgrounds_{state}"].float() / 255,
            tensors[f"images_{state}"].float() / 255,
        )

    shared = (tensors[name] for name in ("textures", "faces", "directions", "test_index"))
    return Reconstructions(at("predicted"), at("tuned"), *shared)


@torch.no_grad()
def render_tuned(
    found: Reconstructions, index: slice | Int[Tensor, " K"], pose: Pose, framing: Framing, renderer: RendererConfig
) -> Float[Tensor, "K 3 H W"]:
    """Render fine-tuned objects from given poses over their backgrounds; framed by box, they fill each picture."""
    mesh = Mesh(found.tuned.vertices[index], found.faces, found.directions)
    if framing == "box":
        pose = fill_picture(mesh.vertices, pose, renderer.camera)
    images = render(mesh, found.textures[index], pose, found.tuned.backgrounds[index], None, renderer).images
    return images.clamp(0, 1)


def load_photographs(path: Path, index: Int[Tensor, " B"]) -> Float[Tensor, "B 3 H W"]:
    """Read the chosen photographs of a prepared category, in [0, 1]."""
    return to_colors(load_images(path)[index])


def load_truth(folder: Path, category: str) -> tuple[Truth, Truth] | None:
    """Read the ground truth of a category's training and test split, or return None where the dataset has none.

    Raises DataError for a damaged file.
    """
    if category not in read_json(folder / "index.json"):
        return None
    return _load_split(folder / "train", category), _load_split(folder / "test", category)


def _load_split(folder: Path, category: str) -> Truth:
    tensors = _read_arrays(folder / f"{category}.npz")
    pose = Pose(*(tensors[name] for name in Pose._fields))
    if "vertices" not in tensors:
        return Truth(pose, None)
    return Truth(pose, TrueObjects(tensors["masks"].bool(), tensors["vertices"], tensors["faces"].long()))


def _read_arrays(path: Path) -> dict[str, Tensor]:
    try:
        with path.open("rb") as stream, numpy.load(stream, allow_pickle=False) as stored:
            return {name: torch.from_numpy(stored[name]) for name in stored.files}
    except (BadZipFile, EOFError, ValueError):
        raise DataError(f"{path} is damaged; copy it again, or run prepare_data for its dataset") from None


def select(truth: Truth, index: Int[Tensor, " B"]) -> Truth:
    """Keep the chosen pictures of a split."""
    objects = truth.objects
    if objects is not None:
        objects = objects._replace(masks=objects.masks[index], vertices=objects.vertices[index])
    return Truth(truth.pose.at(index), objects)
