"""Photometric fine-tuning of single reconstructions (paper section 3.2.4)."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float, UInt8
from torch import Tensor
from tqdm import tqdm

from pipeline.datasets.images import Images, to_bytes
from pipeline.geometry.camera import pose_to_tensor
from pipeline.losses.image_distance import Features, feature_distance
from pipeline.networks.feature_extractor import FeatureExtractor, extract
from pipeline.networks.full_model import FullModel, Reconstruction
from pipeline.ranges import Count, Momentum, Natural, NonNegative, Positive
from pipeline.training.candidates import Flips, flipped
from pipeline.training.checkpoint import Checkpoint
from pipeline.training.exploration import comparable, require_maps

Loss = Callable[[Reconstruction], Float[Tensor, " B"]]


@dataclass(frozen=True)
class PhaseConfig:
    """One optimisation of one of the networks' outputs by Adam."""

    steps: Natural
    learning_rate: Positive
    """In the units of the output: background code, pose coordinates, or shape parameters."""


@dataclass(frozen=True)
class FineTuneConfig:
    """Settings of fine-tuning; the three outputs are optimised one after the other."""

    photographs: Count | None
    """How many photographs, from the first on; null for all."""
    batch_size: Count
    betas: tuple[Momentum, Momentum]
    map_weights: tuple[NonNegative, ...]
    """Of the comparison of poses to start from, as in exploration."""
    flipped_poses: Flips
    """Flipped views of the student's pose, up to three, that may replace it as the start; so may the ensemble's."""
    background: PhaseConfig
    pose: PhaseConfig
    shape: PhaseConfig

    @property
    def phases(self) -> tuple[tuple[str, PhaseConfig], ...]:
        """The outputs that are tuned, in their order."""
        return ("background", self.background), ("pose", self.pose), ("shape", self.shape)


class Outputs:
    """Hold what the networks predict for a batch of photographs, in the form in which it is tuned."""

    def __init__(self, model: FullModel, images: Float[Tensor, "B 3 H W"], features: Features) -> None:
        self.model = model
        with torch.no_grad():
            self.heads = model.pose_decoder.ensemble(model.pose_encoder(images)).coordinates
            self.values = {
                "background": model.background_encoder(images),
                "pose": model.read_poses(images),
                "shape": model.read_shapes(images, features),
            }
            self.texture_maps = model.read_textures(images)

    @torch.no_grad()
    def admit(self, name: str, value: Float[Tensor, "B K"]) -> None:
        """Bring poses back into their ranges in place: left outside, they would get no gradient that leads back."""
        if name == "pose":
            value.copy_(self.model.poses.clamp(value))

    def reconstruct(self, **replaced: Tensor) -> Reconstruction:
        """Decode the outputs, some of them replaced. Gradients flow to the replacements."""
        values = self.values | replaced
        vertices = self.model.shapes(values["shape"])
        pose = self.model.poses(self.model.poses.clamp(values["pose"]), vertices)
        backgrounds = self.model.background_decoder(values["background"])
        return Reconstruction(vertices, self.texture_maps, pose, backgrounds)


@torch.no_grad()
def choose_start(outputs: Outputs, distance: Loss, flips: int) -> None:
    """Replace each photograph's pose by the nearest of the student's, its flipped views and the ensemble's.

    Descent cannot turn an object round; the regressors of the ensemble stand for the different answers.
    """
    student = outputs.values["pose"]
    starts = torch.cat([student[None], flipped(student, flips), outputs.heads.transpose(0, 1)])
    distances = torch.stack([distance(outputs.reconstruct(pose=start)) for start in starts])
    outputs.values["pose"] = starts[distances.argmin(dim=0), torch.arange(len(student), device=student.device)]


def tune(outputs: Outputs, name: str, loss: Loss, phase: PhaseConfig, betas: tuple[float, float]) -> None:
    """Descend on the loss along one output and keep each photograph's best value met, the first one included.

    Photographs do not influence each other: Adam's steps are per coordinate and the losses are summed.
    """
    value = outputs.values[name].clone().requires_grad_()
    best_value, best_loss = outputs.values[name].clone(), torch.full_like(value[:, 0], torch.inf)
    optimizer = torch.optim.Adam([value], lr=phase.learning_rate, betas=betas)
    for step in range(phase.steps + 1):
        losses = loss(outputs.reconstruct(**{name: value}))
        better = losses.detach() < best_loss
        best_value = torch.where(better[:, None], value.detach(), best_value)
        best_loss = torch.where(better, losses.detach(), best_loss)
        if step < phase.steps:
            optimizer.zero_grad()
            losses.sum().backward()
            optimizer.step()
            outputs.admit(name, value)
    outputs.values[name] = best_value


@torch.no_grad()
def keep_better(outputs: Outputs, first: dict[str, Tensor], loss: Loss) -> None:
    """Go back to the first values where the loss did not fall: another start can lead to a worse end."""
    worse = loss(outputs.reconstruct()) > loss(outputs.reconstruct(**first))
    outputs.values = {name: torch.where(worse[:, None], first[name], value) for name, value in outputs.values.items()}


def fine_tune(
    config: FineTuneConfig,
    images: Images,
    model: FullModel,
    extractor: FeatureExtractor,
    checkpoint: Checkpoint,
) -> dict[str, Tensor]:
    """Reconstruct photographs and fine-tune background, pose and shape of each, batch by batch.

    Returns, for `predicted` and `tuned`, `pose_*`, `vertices_*`, `backgrounds_*` and `images_*` (8-bit pictures) and
    `feature_distance_*`, then `textures`, `faces`, `directions` and `test_index`. Batches that the checkpoint holds are
    not tuned again.
    """
    require_maps(config.map_weights, extractor, "fine_tune.map_weights")
    model.requires_grad_(False)
    index = torch.arange(len(images) if config.photographs is None else min(config.photographs, len(images)))
    collected: dict[str, list[Tensor]] = {}
    batches = index.split(config.batch_size)
    steps = sum(phase.steps + 1 for _, phase in config.phases)
    with tqdm(total=len(batches) * steps, desc="fine-tuning", unit="step", disable=None) as progress:
        for batch in batches:
            part = checkpoint.part(f"{int(batch[0])}-{int(batch[-1])}")
            if (restored := part.load()) is None:
                pictures = images[batch.to(images.device)]
                restored = _fine_tune_batch(config, pictures, model, extractor, progress.update), {}
                part.save(*restored)
            else:
                progress.update(steps)
            for name, values in restored[0].items():
                collected.setdefault(name, []).append(values)
    results = {name: torch.cat(values) for name, values in collected.items()}
    return results | {"faces": model.faces, "directions": model.directions, "test_index": index}


def _fine_tune_batch(
    config: FineTuneConfig,
    images: UInt8[Tensor, "B 3 H W"],
    model: FullModel,
    extractor: FeatureExtractor,
    advance: Callable[[], object],
) -> dict[str, Tensor]:
    """Return what `fine_tune` does of a batch; `advance` is called at every step."""
    features = [layer.float() for layer in extract(extractor, images, len(images))]
    compared = comparable(features, config.map_weights)

    def loss(reconstruction: Reconstruction) -> Float[Tensor, " B"]:
        return feature_distance(features, extractor(model.render(reconstruction)))

    def distance(reconstruction: Reconstruction) -> Float[Tensor, " B"]:
        rendered = comparable(extractor(model.render(reconstruction), len(config.map_weights)), config.map_weights)
        return feature_distance(compared, rendered)

    outputs = Outputs(model, images.float() / 255, features)
    results, first = _describe(outputs, loss, "predicted"), outputs.values.copy()
    choose_start(outputs, distance, config.flipped_poses)

    def step(reconstruction: Reconstruction) -> Float[Tensor, " B"]:
        advance()
        return loss(reconstruction)

    for name, phase in config.phases:
        tune(outputs, name, step, phase, config.betas)
    keep_better(outputs, first, loss)
    return results | _describe(outputs, loss, "tuned") | {"textures": outputs.texture_maps.cpu()}


@torch.no_grad()
def _describe(outputs: Outputs, loss: Loss, state: str) -> dict[str, Tensor]:
    reconstruction = outputs.reconstruct()
    images = outputs.model.render(reconstruction)
    results = {
        "pose": pose_to_tensor(reconstruction.pose),
        "vertices": reconstruction.vertices,
        "backgrounds": to_bytes(reconstruction.backgrounds),
        "images": to_bytes(images),
        "feature_distance": loss(reconstruction),
    }
    return {f"{name}_{state}": value.cpu() for name, value in results.items()}
