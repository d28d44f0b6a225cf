"""Lessons: the pose networks learn to read known poses off photographs (ours).

Before full training, from first poses; then from recorded ones, when ends are told apart and after training. During
full training a photograph is seen a few times, among losses that pull at the same networks; a lesson is cheap, for
nothing is rendered.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor

from pipeline.datasets.images import Images
from pipeline.distributed import average, share
from pipeline.networks.full_model import FullModel
from pipeline.ranges import Count, Momentum, Natural, Positive
from pipeline.training.cuda_graph import GraphedStep
from pipeline.training.divergence import require_finite
from pipeline.training.loop import take_steps
from pipeline.training.optimization import adam, falling, set_learning_rate, take_step


@dataclass(frozen=True)
class LessonsConfig:
    """Settings of the lessons."""

    iterations: Natural
    """0 leaves them out."""
    batch_size: Count
    learning_rate: Positive
    """In the first half of the iterations; it falls to zero in the second."""
    betas: tuple[Momentum, Momentum]


def learn_poses(
    model: FullModel,
    photographs: Images,
    index: Int[Tensor, " K"],
    poses: Float[Tensor, "K 7"],
    config: LessonsConfig,
    rng: torch.Generator,
) -> None:
    """Train the pose networks to read poses off some photographs and, negated, off their mirror images.

    Mirror images take part where objects are mirror-symmetric. Every head learns from every photograph: what thousands
    of them agree on outweighs single wrong poses. Raises TrainingDiverged.
    """
    parameters = [*model.pose_encoder.parameters(), *model.pose_decoder.parameters()]
    optimizer = adam(parameters, config.learning_rate, config.betas)

    def learn(pictures: UInt8[Tensor, "B 3 H W"], wanted: Float[Tensor, "B 7"]) -> dict[str, Float[Tensor, ""]]:
        images = pictures.float() / 255
        if model.config.shape.mirror:
            images, wanted = torch.cat([images, images.flip(-1)]), torch.cat([wanted, model.poses.mirror(wanted)])
        loss = model.pose_decoder.known_error(model.pose_encoder(images), wanted)
        take_step(loss, optimizer)
        return {"loss": average(loss.detach())}

    graphed = GraphedStep(learn, rng.device)

    def step(iteration: int) -> dict[str, Float[Tensor, ""]]:
        rows = share(torch.randint(len(index), (config.batch_size,), generator=rng, device=rng.device))
        set_learning_rate(falling(config.learning_rate, iteration, config.iterations, 0.5), optimizer)
        return graphed(photographs[index[rows]], poses[rows])

    take_steps(step, config.iterations, "lessons")
    require_finite(model.state_dict(), config.iterations, "lessons")
