"""Photographs are painted on reconstructions."""

from dataclasses import asdict, replace
from pathlib import Path

import pytest
import torch
import yaml
from jaxtyping import Float
from torch import Tensor

from pipeline.config import load
from pipeline.errors import ConfigError
from pipeline.export import painting
from pipeline.export.painting import PaintingConfig, find_object, minimize_quadratic, paint
from pipeline.geometry.camera import CameraConfig, Pose
from pipeline.rendering.renderer import RendererConfig, render
from pipeline.seeding import generator
from tests.scenes import smooth_textures
from tests.tiny_full_model import base_mesh

CONFIG = PaintingConfig(
    photograph_size=64, texture_size=64, deviation=0.15, noise=0.1, symmetry=0.5, border=0.03, iterations=20
)
CAMERA = CameraConfig(distance=2.7, field_of_view=30.0)
MESH = base_mesh()
GREY = torch.full((3, 8, 8), 0.5)


def pose(azimuth: float, center: tuple[float, float] = (0.0, 0.0)) -> Pose:
    flat = torch.zeros(1)
    return Pose(torch.tensor([azimuth]), torch.tensor([0.2]), flat, torch.tensor([center]), torch.full((1,), 1.4))


def picture(texture: Float[Tensor, "3 T T"], view: Pose) -> Float[Tensor, "4 64 64"]:
    """Render before black, with the silhouette as the last channel."""
    images, silhouettes = render(MESH, texture[None], view, None, None, RendererConfig(CAMERA, 64, 2))
    return torch.cat([images, silhouettes[:, None]], dim=1)[0]


def error(texture: Float[Tensor, "3 T T"], truth: Float[Tensor, "3 T T"], view: Pose) -> float:
    """Return the mean difference of colours over the object, seen from somewhere."""
    seen, expected = picture(texture, view), picture(truth, view)
    return ((seen - expected)[:3].abs().mean(dim=0).sum() / expected[3].sum()).item()


@pytest.fixture(scope="module")
def truth() -> Float[Tensor, "3 64 64"]:
    """Return a colourful texture, mirror-symmetric, mostly red."""
    texture = smooth_textures(1, 64, torch.Generator().manual_seed(0))[0]
    texture = (texture + texture.flip(-1)) / 2
    return (texture * 0.5 + torch.tensor([0.4, 0.0, 0.0])[:, None, None]).clamp(0, 1)


def painted(truth: Float[Tensor, "3 64 64"], mirror: bool) -> Float[Tensor, "3 64 64"]:
    return paint(MESH, GREY, pose(1.2), picture(truth, pose(1.2))[:3], CAMERA, mirror, CONFIG)


@pytest.mark.parametrize("mirror", [False, True])
def test_what_the_photograph_shows_is_painted(truth: Float[Tensor, "3 64 64"], mirror: bool) -> None:
    texture = painted(truth, mirror)
    assert texture.shape == (3, 64, 64)
    assert error(GREY, truth, pose(1.2)) > 0.15
    assert error(texture, truth, pose(1.2)) < 0.03


def test_the_other_side_of_a_symmetric_object_is_painted_like_the_one_that_is_seen(
    truth: Float[Tensor, "3 64 64"],
) -> None:
    other_side = pose(-1.2)
    alone, like_the_other = (error(painted(truth, mirror), truth, other_side) for mirror in (False, True))
    assert alone < 0.8 * error(GREY, truth, other_side)  # colours spread
    assert like_the_other < 0.8 * alone


def test_detail_needs_a_sharp_map(truth: Float[Tensor, "3 64 64"]) -> None:
    checks = (torch.arange(64) // 8 % 2).float()
    checked = truth * (0.1 + 0.9 * (checks[:, None] == checks))
    photograph = picture(checked, pose(1.2))[:3]
    sharp, coarse = (
        paint(MESH, GREY, pose(1.2), photograph, CAMERA, True, replace(CONFIG, texture_size=size)) for size in (64, 8)
    )
    assert coarse.shape == (3, 8, 8)
    assert error(sharp, checked, pose(1.2)) < 0.7 * error(coarse, checked, pose(1.2))


def test_an_object_outside_of_the_photograph_keeps_its_texture(truth: Float[Tensor, "3 64 64"]) -> None:
    photograph = picture(truth, pose(1.2))[:3]
    outside = pose(1.2, center=(5.0, 0.0))
    kept = paint(MESH, truth, outside, photograph, CAMERA, True, replace(CONFIG, texture_size=32))
    torch.testing.assert_close(kept, truth)  # a larger predicted map keeps its size too


def test_colors_correct_a_silhouette_near_its_outline() -> None:
    rows, columns = torch.meshgrid(torch.arange(64), torch.arange(64), indexing="ij")
    disk, shifted = ((rows - 32) ** 2 + (columns - middle) ** 2 < 400 for middle in (32, 35))
    noise = 0.05 * torch.rand(3, 64, 64, generator=torch.Generator().manual_seed(1))
    photograph = noise + torch.where(disk, torch.tensor([0.9, 0.1, 0.1])[:, None, None], 0.4)
    found = find_object(photograph, shifted, border=0.08)
    assert (shifted ^ disk).sum() > 100
    assert (found ^ disk).sum() < 10
    narrow = find_object(photograph, shifted, border=0.02)  # within one pixel of the outline
    assert 50 < (narrow ^ disk).sum() < (shifted ^ disk).sum()


def test_a_silhouette_without_inside_or_outside_stays_as_it_is() -> None:
    photograph = torch.rand(3, 16, 16, generator=torch.Generator().manual_seed(2))
    line = torch.zeros(16, 16, dtype=torch.bool)
    line[8] = True
    for silhouette in (line, ~torch.zeros_like(line), torch.zeros_like(line)):
        assert find_object(photograph, silhouette, border=0.1).equal(silhouette)


def test_conjugate_gradients_solve_linear_equations() -> None:
    rng = torch.Generator().manual_seed(3)
    root, right = torch.randn(6, 6, generator=rng).double(), torch.randn(6, generator=rng).double()
    matrix = root @ root.T + torch.eye(6)

    def loss(values: list[Tensor]) -> Tensor:
        joined = torch.cat([values[0], values[1].flatten()])
        return joined @ matrix @ joined / 2 - right @ joined

    start = [torch.ones(2).double(), torch.zeros(2, 2).double()]
    first, second = minimize_quadratic(loss, start, iterations=6)
    torch.testing.assert_close(torch.cat([first, second.flatten()]), torch.linalg.solve(matrix, right))


def test_a_texture_size_that_cannot_be_halved_is_refused(tmp_path: Path) -> None:
    settings = asdict(replace(CONFIG, texture_size=48))
    (tmp_path / "params.yaml").write_text(yaml.safe_dump({"paint": settings}))
    with pytest.raises(
        ConfigError, match=r"'paint\.texture_size' is 48; expected a whole number, a power of two from 4"
    ):
        load(tmp_path / "params.yaml", PaintingConfig, ["paint"])


def test_pixels_count_by_the_square_of_the_cosine_at_which_they_see_the_surface(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    costs: list[Tensor] = []
    monkeypatch.setattr(painting, "find_object", lambda _, covered, __: covered)
    monkeypatch.setattr(painting, "minimize_quadratic", lambda loss, none, _: (costs.append(loss(none)), none)[1])
    seen = painting._look(MESH, pose(1.2), CAMERA, 64)
    places = seen.covered.nonzero()[::40]
    for row, column in places:
        photograph = torch.full((3, 64, 64), 0.5)
        photograph[:, row, column] = 1.0  # a quarter is the squared error of each channel
        painting.paint(MESH, GREY, pose(1.2), photograph, CAMERA, True, CONFIG)
    facing = seen.facing[places[:, 0], places[:, 1]]
    assert facing.min() < 0.5 < 0.9 < facing.max()
    torch.testing.assert_close(torch.stack(costs), 0.75 * facing.square() / CONFIG.noise**2)


def test_enlarged_maps_have_no_seam_behind() -> None:
    values = torch.rand(3, 8, 8, generator=generator(0))
    stretched = painting._stretch(values, 32)
    torch.testing.assert_close(painting._stretch(values.roll(3, dims=-1), 32), stretched.roll(12, dims=-1))


def test_noise_counts_as_a_deviation_as_that_of_the_maps_does() -> None:
    photograph = torch.rand(3, 64, 64, generator=generator(0))
    both = (replace(CONFIG, deviation=factor * 0.15, noise=factor * 0.1, iterations=5) for factor in (1, 2))
    one, other = (painting.paint(MESH, GREY, pose(1.2), photograph, CAMERA, True, config) for config in both)
    torch.testing.assert_close(one, other, atol=1e-3, rtol=0)
