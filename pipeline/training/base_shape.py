"""Learning a category's base shape by matching distributions of renderings and photographs (paper 3.1)."""

import gc
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.distributed import agree, average, average_losses, divide, share, whole, world
from pipeline.errors import ConfigError, DataError
from pipeline.geometry.camera import fill_picture
from pipeline.geometry.normalize import fit_unit_cube
from pipeline.geometry.sphere import Sphere, build_sphere
from pipeline.losses.chamfer import chamfer
from pipeline.losses.feature_matching import feature_matching
from pipeline.losses.smoothness import SmoothnessConfig, smoothness
from pipeline.networks.pose_coordinates import Framing
from pipeline.networks.scene_generator import (
    ConstraintConfig,
    GeneratorConfig,
    Scene,
    SceneConfig,
    SceneGenerator,
)
from pipeline.networks.seed_choice import best_seed
from pipeline.ranges import Count, Fraction, Momentum, Natural, Positive
from pipeline.rendering.renderer import Mesh, RendererConfig, render
from pipeline.seeding import generator, initialised
from pipeline.training.checkpoint import Checkpoint, Part
from pipeline.training.cuda_graph import GraphedStep
from pipeline.training.curves import Curve
from pipeline.training.loop import Schedule, run_training
from pipeline.training.optimization import adam, falling, set_learning_rate, take_step
from pipeline.training.photographs import Photographs
from pipeline.training.viewpoints import LightConfig, ViewpointConfig, enlarge_fronts, sample_lights, sample_viewpoints


@dataclass(frozen=True)
class BaseShapeConfig:
    """Settings of base-shape learning."""

    iterations: Count
    batch_size: Count
    seeds: Count
    """How many base shapes are learned; a label-free score picks one."""
    learning_rate: Positive
    betas: tuple[Momentum, Momentum]
    cool_down: Fraction
    """The last part of the iterations, over which the learning rate falls to zero; the paper has none."""
    reconstruction_balance: Fraction
    """lambda_rec, the share of the Chamfer distance against feature matching."""
    colors: Count
    """Size of the texture palette, N_c."""
    initial_dimensions: tuple[Positive, Positive, Positive]
    """Width, height and depth of the initial ellipsoid (paper Table 3)."""
    subdivisions: Natural
    """Of the icosphere; 3 gives 642 vertices."""
    framing: Framing
    """`box` lets the object fill each rendering, like photographs cut to their boxes."""
    front_scale: Positive
    """How many times larger objects are drawn from ahead and behind than from the side, at framing `free`; the paper
    draws them alike, photographers fill the frame from every side."""
    generator: GeneratorConfig
    constraints: ConstraintConfig
    viewpoint: ViewpointConfig
    light: LightConfig
    renderer: RendererConfig
    smoothness: SmoothnessConfig
    score_batches: Count
    """Batches of photographs and renderings that the score is averaged over."""
    curve_every: Count
    """Iterations that one row of the curve averages."""
    checkpoint_every: Count
    """Iterations between restart states."""

    def __post_init__(self) -> None:
        """Raise ConfigError for a scale that filling the picture would override."""
        if self.framing == "box" and self.front_scale != 1:
            raise ConfigError(f"front_scale is {self.front_scale} at framing box; expected 1, or framing free")


class BaseShapes(NamedTuple):
    """The result of all seeds."""

    sphere: Sphere
    vertices: Float[Tensor, "K V 3"]
    """One shape a seed, in the unit cube."""
    scores: Float[Tensor, " K"]
    """Label-free score of each seed; lower is better."""
    best: int
    """Index of the seed with the lowest score."""
    generators: list[SceneGenerator]
    """Every seed's."""
    curve: Curve
    """Losses of all seeds."""


class Learned(NamedTuple):
    """What one seed ends with, on the CPU: its shape, label-free score and generators, and rows of the curve."""

    vertices: Float[Tensor, "V 3"]
    score: float
    generator: SceneGenerator
    rows: list[dict[str, float]]


class SeedTrainer:
    """Train one seed's generators."""

    def __init__(
        self, config: BaseShapeConfig, sphere: Sphere, photographs: Photographs, seed: int, index: int
    ) -> None:
        device = sphere.directions.device
        self.config, self.sphere, self.photographs, self.seed = config, sphere, photographs, seed
        dimensions = torch.tensor(config.initial_dimensions, device=device)
        with initialised(seed, "base_shape", index):
            self.scene = SceneGenerator(
                SceneConfig(config.generator, config.constraints, config.colors, config.renderer.size),
                fit_unit_cube((sphere.directions * dimensions)[None])[0],
                sphere.mirror,
            ).to(device)
        self.optimizer = adam(self.scene.parameters(), config.learning_rate, config.betas)
        self.rng = generator(seed, "base_shape", index, device=device)
        self._learn = GraphedStep(self._learn_once, device, self.rng) if photographs.on_device else self._learn_once
        agree(self.scene.state_dict().values())

    def generate(self, count: int, rng: torch.Generator) -> tuple[Scene, Float[Tensor, "B 3 H W"]]:
        """Draw `count` scenes, viewpoints and lights; render this process's share of them (paper 3.1.5)."""
        scene = self.scene(share(self.scene.sample_noise(count, rng)))
        pose = share(enlarge_fronts(sample_viewpoints(self.config.viewpoint, count, rng), self.config.front_scale))
        if self.config.framing == "box":
            pose = fill_picture(scene.vertices, pose, self.config.renderer.camera)
        light = share(sample_lights(self.config.light, count, rng))
        mesh = Mesh(scene.vertices, self.sphere.faces, self.sphere.directions)
        rendering = render(mesh, scene.texture_maps, pose, scene.backgrounds, light, self.config.renderer)
        return scene, rendering.images

    def reconstruction_loss(
        self, images: Float[Tensor, "B 3 H W"], rng: torch.Generator
    ) -> dict[str, Float[Tensor, ""]]:
        """Compare renderings, of which this process holds a share, with as many photographs (paper eqs. 2 to 4)."""
        total = len(self.photographs.images)
        index = torch.randint(total, (whole(len(images)),), generator=rng, device=rng.device)
        (_, real), generated = self.photographs.batch(index), self.photographs.extractor(images)
        balance = self.config.reconstruction_balance
        losses = {"chamfer": chamfer(real, generated), "feature_matching": feature_matching(real, generated)}
        losses["reconstruction"] = balance * losses["chamfer"] + (1 - balance) * losses["feature_matching"]
        return losses

    def step(self, iteration: int) -> dict[str, Float[Tensor, ""]]:
        """Take one optimisation step and return its losses, on the device."""
        config = self.config
        set_learning_rate(falling(config.learning_rate, iteration, config.iterations, config.cool_down), self.optimizer)
        return self._learn()

    def _learn_once(self) -> dict[str, Float[Tensor, ""]]:
        config = self.config
        self.scene.train()
        scene, images = self.generate(config.batch_size, self.rng)
        losses = self.reconstruction_loss(images, self.rng)
        total = losses["reconstruction"]
        if config.constraints.smoothness:
            losses["smoothness"] = smoothness(scene.vertices, self.sphere.faces, config.smoothness).mean()
            total = total + losses["smoothness"]
        take_step(total, self.optimizer)
        return average_losses(losses)

    def parts(self) -> dict[str, Part]:
        """Name everything a restart state has to hold."""
        return {"scene": self.scene, "optimizer": self.optimizer, "rng": self.rng}

    @torch.no_grad()
    def shape(self) -> Float[Tensor, "V 3"]:
        """Return the mean of the generated shapes, which collapse to one (paper 3.1.7)."""
        noise = self.scene.sample_noise(self.config.batch_size, self.rng)
        return fit_unit_cube(self.scene.vertices(noise).mean(0, keepdim=True))[0]

    @torch.no_grad()
    def score(self) -> float:
        """Return the mean reconstruction loss over fresh batches: a label-free measure of a base shape.

        It is measured on the same photographs, viewpoints and lights for every seed of a run, because batches differ by
        more than shapes do. As in a training step, textures are normalised by their batch; the generator goes on to
        collect its statistics.
        """
        rng = generator(self.seed, "base_shape_score", device=self.rng.device)
        losses = [
            self.reconstruction_loss(self.generate(self.config.batch_size, rng)[1], rng)["reconstruction"]
            for _ in range(self.config.score_batches)
        ]
        return average(torch.stack(losses).mean()).item()


def learn_base_shape(
    config: BaseShapeConfig, photographs: Photographs, seed: int, checkpoint: Checkpoint
) -> BaseShapes:
    """Learn one base shape a seed and pick the one whose renderings are closest to the photographs.

    Processes divide the seeds, each working alone, so that their number changes no shape as long as each has as many
    threads; a single seed's batches are shared. Each seed has its own part of the restart state; a killed call that is
    repeated returns the same bytes. Raises DataError for a single photograph.
    """
    if len(photographs.images) < 2:
        raise DataError("base shapes are learned from what photographs have in common, but there is only one; add more")
    sphere = build_sphere(config.subdivisions, photographs.images.device)
    schedule = Schedule(config.iterations, config.curve_every, config.checkpoint_every)

    # So many seeds that some process would wait for the last ones are trained in stretches: the next stretch of a seed
    # is taken by another process, which goes on from its restart state.
    size = world().size
    stretches = size if config.seeds > size and config.seeds % size else 1

    def learn(number: int) -> Learned | None:
        gc.collect()  # a recorded step refers to its trainer, and keeps a GPU's memory as long
        stretch, index = divmod(number, config.seeds)
        trainer = SeedTrainer(config, sphere, photographs, seed, index)
        until = config.iterations * (stretch + 1) // stretches
        curve = run_training(trainer, schedule, f"base shape {index}", checkpoint.part(str(index)), until=until)
        if stretch + 1 < stretches:
            return None
        rows = [{"seed": index, **row} for row in curve.rows]
        return Learned(trainer.shape().cpu(), trainer.score(), trainer.scene.cpu(), rows)

    return _gather(sphere, [one for one in divide(learn, config.seeds * stretches) if one is not None])


def _gather(sphere: Sphere, learned: list[Learned]) -> BaseShapes:
    scores = [one.score for one in learned]
    best = best_seed(scores)
    curve = Curve([row for one in learned for row in one.rows])
    vertices = torch.stack([one.vertices for one in learned])
    generators = [one.generator for one in learned]
    return BaseShapes(sphere, vertices, torch.tensor(scores), best, generators, curve)
