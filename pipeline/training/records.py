"""What full training records of each photograph: its best pose and shape so far (paper section 3.2)."""

from collections.abc import Callable
from functools import partial

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn import functional
from tqdm import tqdm

from pipeline.distributed import agree, gather, is_first
from pipeline.geometry.camera import Pose
from pipeline.networks.full_model import FullModel
from pipeline.networks.scene_generator import LearnedScenes
from pipeline.training.candidates import Record, first_record, flipped
from pipeline.training.checkpoint import Part
from pipeline.training.ends import EndsConfig, tell_ends
from pipeline.training.first_poses import FirstPosesConfig, first_poses
from pipeline.training.lessons import LessonsConfig, learn_poses
from pipeline.training.photographs import Photographs
from pipeline.training.reading import read_all_poses
from pipeline.training.viewpoints import LightConfig

_CHUNK = 10_000
"""Photographs whose recorded shapes are held at once."""


class Records:
    """Hold the best poses and shapes of all photographs, revise the poses, and teach them to the pose networks.

    Tensors are changed in place, never replaced: recorded GPU steps hold them.
    """

    def __init__(
        self, model: FullModel, photographs: Photographs, lessons: LessonsConfig, rng: torch.Generator
    ) -> None:
        """Start with random poses and the base shape."""
        self.model, self.photographs, self.lessons, self.rng = model, photographs, lessons, rng
        self.best = first_record(model, len(photographs.images), rng)
        self.visits = torch.zeros(len(photographs.images), dtype=torch.int64, device=rng.device)
        """How often each photograph was in a batch."""

    def keep(self, index: Int[Tensor, " B"], found: Record) -> None:
        """Record what was found for a batch, `found` being this process's share of it."""
        self.best.pose[index], self.best.shape[index] = gather(found.pose), gather(found.shape)
        self.visits[index] += 1

    def starting_from(
        self, scenes: LearnedScenes, config: FirstPosesConfig, light: LightConfig
    ) -> list[Callable[[], None]]:
        """List what replaces random poses by first poses: votes of the base shapes of all seeds, then lessons."""
        return [partial(self._find_first_poses, scenes, config, light), partial(self._teach_first_poses, config)]

    def _find_first_poses(self, scenes: LearnedScenes, config: FirstPosesConfig, light: LightConfig) -> None:
        images, extractor = self.photographs.images[: config.photographs], self.photographs.extractor
        poses = first_poses(self.model, scenes, extractor, images, config, light, self.rng)
        agree([poses])
        self.best.pose[: len(poses)] = poses

    def _teach_first_poses(self, config: FirstPosesConfig) -> None:
        """Teach the first poses, and record what the networks then read off all other photographs."""
        count = min(config.photographs, len(self.visits))
        self._teach(torch.arange(count, device=self.visits.device))
        if count < len(self.visits):
            self.best.pose[count:] = self._read(count)

    def turn_round(self, config: EndsConfig) -> None:
        """Turn recorded poses of photographs that show the opposite ends, and teach the poses.

        Photographs beyond the first, or without a visit, show the ends that the networks then read off them.
        """
        told = self._turn_told(config)
        if not told.any():
            return
        self._teach(told.nonzero().flatten())
        agreement = (self._read()[:, :2] * self.best.pose[:, :2]).sum(dim=1)  # of azimuths, -1 to 1
        self._turn(~told & (agreement < 0))

    def _turn_told(self, config: EndsConfig) -> Bool[Tensor, " N"]:
        """Turn records of the first photographs, those visited, that show the opposite ends; return which were told."""
        images, extractor = self.photographs.images[: config.photographs], self.photographs.extractor
        recorded, read = self.best.pose[: len(images)], read_all_poses(self.model, images)
        lead = tell_ends(images, recorded, read, self.model.poses, extractor, config, self.rng)
        agree([lead])
        lead = functional.pad(lead, (0, len(self.visits) - len(lead))) * (self.visits > 0)
        self._turn(lead < 0)
        if is_first() and lead.any():
            tqdm.write(f"ends told: {int((lead < 0).sum())} of {int((lead != 0).sum())} photographs turned round")
        return lead != 0

    def _turn(self, opposite: Bool[Tensor, " N"]) -> None:
        """Turn recorded poses of some photographs to the opposite azimuth."""
        poses = self.best.pose
        poses.copy_(torch.where(opposite[:, None], flipped(poses, 1)[0], poses))

    def teach_visited(self) -> None:
        """Teach the poses of all photographs that were in a batch."""
        index = self.visits.nonzero().flatten()
        if len(index):
            self._teach(index)

    def _teach(self, index: Int[Tensor, " K"]) -> None:
        learn_poses(self.model, self.photographs.images, index, self.best.pose[index], self.lessons, self.rng)

    def _read(self, first: int = 0) -> Float[Tensor, "_ 7"]:
        """Return what the networks read off the photographs from number `first` on; the same in all processes."""
        read = read_all_poses(self.model, self.photographs.images, first)
        agree([read])
        return read

    @torch.no_grad()
    def poses(self) -> Pose:
        """Return the best poses of all photographs; those without a visit have the one they started with."""
        rows = zip(self.best.pose.split(_CHUNK), self.best.shape.split(_CHUNK), strict=True)
        poses = [self.model.poses(pose, self.model.shapes(shape)) for pose, shape in rows]
        return Pose(*(torch.cat(values) for values in zip(*poses, strict=True)))

    def parts(self) -> dict[str, Part]:
        """Name what a restart state has to hold."""
        return {"pose": self.best.pose, "shape": self.best.shape, "visits": self.visits}
