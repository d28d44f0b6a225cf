"""Within an iteration the host never waits for the device: it would, on a GPU, where a number or a size is asked for.

Without a GPU, operations and reads that are known to wait there are noticed, whether Triton's interpreter draws or
kernels are asked for and not run; constants are made and topologies derived in a first iteration.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from pipeline.geometry.camera import CameraConfig
from pipeline.geometry.icosphere import icosphere
from pipeline.geometry.sphere import build_sphere
from pipeline.rendering.renderer import Mesh, RendererConfig
from pipeline.seeding import generator
from pipeline.training.base_shape import SeedTrainer
from pipeline.training.candidates import ExplorationConfig
from pipeline.training.full_trainer import FullTrainer
from pipeline.training.photographs import Photographs
from pipeline.training.warm_up import draw_sample, warm_up_loss
from tests.learning.test_base_shape import CONFIG as BASE_SHAPE
from tests.tiny_full_model import MODEL, TRAINING, photographs, tiny_extractor, tiny_model, tiny_scenes
from tests.triton_kernels import DEVICE, draw_with_triton, enlarge_programs, launch_nothing

SMALL = RendererConfig(CameraConfig(2.7, 30.0), 8, 2)
FEW = replace(TRAINING.exploration, perturbed_poses=1, flipped_poses=1, turned_poses=1)
SINGLE_STAGE = {"two_stage": False, "mirror_texture": False, "stripes": False}
aten = torch.ops.aten
WAITING = {
    aten._linalg_check_errors.default: "a solution was checked",
    aten._linalg_eigh.default: "a solution was checked",
    aten._linalg_svd.default: "a solution was checked",
    aten._local_scalar_dense.default: "a tensor became a number",
    aten.allclose.default: "tensors were compared",
    aten.bincount.default: "a size was computed",
    aten.equal.default: "tensors were compared",
    aten.histc.default: "a range was computed",
    aten.is_nonzero.default: "a tensor became a truth value",
    aten.lift_fresh.default: "numbers became a tensor",
    aten.masked_select.default: "a mask chose entries",
    aten.multinomial.default: "probabilities were checked",
    aten.nonzero.default: "entries were counted",
    aten.repeat_interleave.Tensor: "a size was computed",
    aten._unique2.default: "a size was computed",
    aten.unique_consecutive.default: "a size was computed",
    aten.unique_dim.default: "a size was computed",
}


class NoticeWaits(TorchDispatchMode):
    """Raise AssertionError where the host would wait."""

    def __torch_dispatch__(
        self,
        func: Any,
        types: Sequence[type],
        args: tuple[Any, ...] = (),
        kwargs: Mapping[str, Any] | None = None,
    ) -> Any:
        assert func not in WAITING, WAITING[func]
        indices = args[1] if func in (aten.index.Tensor, aten.index_put.default, aten.index_put_.default) else ()
        masked = any(index is not None and index.dtype == torch.bool for index in indices)
        assert not masked, "a mask chose entries"
        return func(*args, **(kwargs or {}))


def notice_reads(monkeypatch: pytest.MonkeyPatch) -> None:
    """Raise AssertionError where Python would read values of a GPU, or move them: on a CPU that is no operation."""

    def read(*_: object, **__: object) -> None:
        raise AssertionError("values were read")

    def to(values: Tensor, *args: Any, **kwargs: Any) -> Tensor:
        moved = any(isinstance(value, str | torch.device) for value in (*args, *kwargs.values()))
        assert not moved, "values were moved"
        return convert(values, *args, **kwargs)

    convert = Tensor.to
    for name, method in (("cpu", read), ("numpy", read), ("tolist", read), ("to", to)):
        monkeypatch.setattr(Tensor, name, method)


@contextmanager
def no_waits() -> Iterator[None]:
    """Fail where the host waits: noticed by PyTorch on a GPU, by what is known to wait there elsewhere."""
    if DEVICE.type == "cuda":
        torch.cuda.set_sync_debug_mode("error")
        try:
            yield
        finally:
            torch.cuda.set_sync_debug_mode("default")
        return
    with NoticeWaits(), pytest.MonkeyPatch.context() as monkeypatch:
        notice_reads(monkeypatch)
        yield


@pytest.fixture(autouse=True)
def large_programs(monkeypatch: pytest.MonkeyPatch) -> None:
    enlarge_programs(monkeypatch)


def full_trainer(
    settle: float, changes: Mapping[str, Any], exploration: ExplorationConfig = TRAINING.exploration
) -> FullTrainer:
    model = replace(MODEL, renderer=SMALL, **changes)
    config = replace(TRAINING, model=model, batch_size=2, settle=settle, exploration=exploration)
    images = photographs(4)[0][..., ::4, ::4].to(DEVICE)
    directions, faces = (part.to(DEVICE) for part in icosphere(1))
    extractor, base = tiny_extractor().to(DEVICE), Mesh(directions[None] / 2, faces, directions)
    return FullTrainer(config, Photographs(images, extractor, 4, memory=2**30), base, 0)


@pytest.mark.parametrize(
    "wait",
    [
        lambda values: values.sum().item(),
        lambda values: bool(values.any()),
        lambda values: values[values > 0],
        lambda values: values.index_put((values > 0,), values.sum()),
        lambda values: values.nonzero(),
        lambda values: values.new_tensor([1.0, 2.0]),
        lambda values: torch.arange(3).repeat_interleave(values.long()),
        lambda values: values.tolist(),
        lambda values: values.numpy(),
        lambda values: values.cpu(),
        lambda values: values.to("cpu"),
        lambda values: values.to(dtype=torch.float64, device=torch.device("cpu")),
        lambda values: torch.allclose(values, values),
        lambda values: values.long().bincount(),
        lambda values: values.histc(2),
        lambda values: values.multinomial(1),
        lambda values: torch.linalg.solve(values.diag(), values),
        lambda values: torch.linalg.eigh(values.diag()),
        lambda values: torch.linalg.svd(values.diag()),
    ],
)
@pytest.mark.skipif(DEVICE.type == "cuda", reason="on a GPU PyTorch notices waits itself")
def test_waits_are_noticed(wait: Callable[[Tensor], object]) -> None:
    values = torch.ones(3)
    with pytest.raises(AssertionError), no_waits():
        wait(values)


@pytest.mark.parametrize("settle", [0.0, 0.75], ids=["exploring", "refining"])
@pytest.mark.parametrize(
    "changes", [{}, {"framing": "box", "shapes_from": "photographs"}, SINGLE_STAGE], ids=["free", "box", "single_stage"]
)
def test_an_iteration_of_full_training_waits_for_nothing(
    monkeypatch: pytest.MonkeyPatch, settle: float, changes: Mapping[str, Any]
) -> None:
    trainer = full_trainer(settle, changes)
    trainer.step(0)
    draw_with_triton(monkeypatch)
    launch_nothing(monkeypatch)
    with no_waits():
        trainer.step(1)


def test_an_iteration_of_full_training_that_draws_has_finite_losses(monkeypatch: pytest.MonkeyPatch) -> None:
    trainer = full_trainer(0.0, {}, FEW)
    trainer.step(0)
    draw_with_triton(monkeypatch)
    with no_waits():
        losses = trainer.step(1)
    assert all(loss.isfinite() for loss in losses.values())


@pytest.mark.gpu
def test_steps_on_either_side_of_settling_are_captured_and_stay_finite() -> None:
    trainer = full_trainer(0.5, {})
    trainer.config = replace(trainer.config, iterations=12)  # six refining ones, six exploring ones
    for iteration in range(12):
        losses = trainer.step(iteration)
        assert all(loss.isfinite() for loss in losses.values()), iteration
    trainer.finish()
    assert all(value.isfinite().all() for value in trainer.model.state_dict().values())


def test_an_iteration_of_base_shape_learning_waits_for_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    config = replace(BASE_SHAPE, batch_size=2)
    extractor = tiny_extractor().to(DEVICE)
    images = photographs(4)[0][..., ::2, ::2].to(DEVICE)
    features = Photographs(images, extractor, 4, memory=2**30)
    trainer = SeedTrainer(config, build_sphere(config.subdivisions, DEVICE), features, 0, 0)
    trainer.step(0)
    draw_with_triton(monkeypatch)
    with no_waits():
        losses = trainer.step(1)
    assert all(loss.isfinite() for loss in losses.values())


def test_an_iteration_of_the_warm_up_waits_for_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    model, scenes, rng = (
        tiny_model(renderer=replace(MODEL.renderer, supersampling=1)).to(DEVICE),
        tiny_scenes().generators[0].to(DEVICE),
        generator(0, device=DEVICE),
    )
    config = replace(TRAINING.warm_up, batch_size=2)
    warm_up_loss(model, draw_sample(model, scenes, config, rng)).backward()
    draw_with_triton(monkeypatch)
    with no_waits():
        loss = warm_up_loss(model, draw_sample(model, scenes, config, rng))
        loss.backward()
    assert loss.isfinite()
