"""Shape, texture and background generators and their constraints."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from pipeline.errors import ConfigError
from pipeline.geometry.icosphere import icosphere
from pipeline.geometry.symmetry import mirror_index, reflect
from pipeline.networks.generators import ImageGenerator, LinearUpsample, ShapeGenerator, SpherePad
from pipeline.networks.scene_generator import (
    ConstraintConfig,
    GeneratorConfig,
    Scene,
    SceneConfig,
    SceneGenerator,
    load_scenes,
    scene_metadata,
    scene_tensors,
)
from pipeline.seeding import generator, initialised
from pipeline.tensor_files import save_tensors

CONFIG = GeneratorConfig(
    latent_size=16,
    shape_hidden=32,
    offset_scale=30.0,
    texture_channels=4,
    texture_size=16,
    background_hidden=8,
    mirror_texture=True,
)
ALL = ConstraintConfig(smoothness=True, symmetry=True, texture_simplicity=True, background_simplicity=True)


def build(config: GeneratorConfig = CONFIG, constraints: ConstraintConfig = ALL, seed: int = 0) -> SceneGenerator:
    vertices, _ = icosphere(1)
    with initialised(seed):
        return SceneGenerator(SceneConfig(config, constraints, 2, 8), vertices, mirror_index(vertices))


def scene(model: SceneGenerator) -> Scene:
    return model(model.sample_noise(6, generator(1)))


def test_shapes_are_mirror_symmetric_and_fill_the_unit_cube() -> None:
    model = build()
    vertices = scene(model).vertices
    assert torch.equal(reflect(vertices)[:, model.mirror_index], vertices)
    extent = vertices.amax(1) - vertices.amin(1)
    assert extent.amax(1).allclose(torch.ones(6))


def test_without_symmetry_shapes_are_free() -> None:
    model = build(constraints=replace(ALL, symmetry=False))
    vertices = scene(model).vertices
    assert not torch.allclose(reflect(vertices)[:, model.mirror_index], vertices, atol=1e-3)


@pytest.mark.parametrize("size", [0, 2, 24, 100])
def test_sizes_between_powers_of_two_are_refused(size: int) -> None:
    with pytest.raises(ConfigError, match=f"textures and backgrounds cannot be {size} px wide; expected 4, 8, 16"):
        build(replace(CONFIG, texture_size=size))


def test_a_palette_of_one_colour_makes_a_plain_texture() -> None:
    model = build()
    with initialised(0):
        plain = SceneGenerator(SceneConfig(CONFIG, ALL, 1, 8), model.initial_vertices, model.mirror_index)
    textures = scene(plain).texture_maps
    assert textures.flatten(2).std(dim=2).max() < 1e-6
    assert textures.flatten(2).mean(2).std(dim=0).max() > 1e-3


def test_texture_maps_stay_in_range_and_mirror() -> None:
    textures = scene(build()).texture_maps
    assert textures.shape == (6, 3, 16, 16)
    assert textures.min() >= 0
    assert textures.max() <= 1
    assert torch.equal(textures, textures.flip(-1))


def test_maps_on_the_sphere_have_no_borders() -> None:
    maps = torch.arange(64.0).view(1, 1, 8, 8)
    padded = SpherePad()(maps)[0, 0]
    assert torch.equal(padded[1:-1, 1:-1], maps[0, 0])
    assert torch.equal(padded[1:-1, 0], maps[0, 0, :, 7])
    assert torch.equal(padded[1:-1, -1], maps[0, 0, :, 0])
    assert padded[0].tolist() == [3, 4, 5, 6, 7, 0, 1, 2, 3, 4]
    assert padded[-1].tolist() == [59, 60, 61, 62, 63, 56, 57, 58, 59, 60]


def test_a_turned_texture_is_the_same_texture() -> None:
    with initialised(0):
        network = ImageGenerator(16, 4, 3, 32, on_sphere=True)
    start = torch.randn(2, 16, 4, 4, generator=generator(0))
    maps, turned = (network.output(network.blocks(features)) for features in (start, start.roll(1, dims=-1)))
    torch.testing.assert_close(turned, maps.roll(8, dims=-1))


def test_the_top_of_a_texture_knows_nothing_of_its_underside() -> None:
    with initialised(0):
        network = ImageGenerator(16, 4, 3, 8, on_sphere=True).eval()
    start = torch.randn(1, 4, 4, 4, generator=generator(0)).requires_grad_()
    network.output(network.blocks(start))[:, :, 0].sum().backward()
    assert start.grad is not None
    assert (start.grad.abs().amax(dim=(0, 1, 3)) > 0).tolist() == [True, True, False, False]


@pytest.mark.parametrize("simple", [True, False])
def test_backgrounds_are_stripes_only_under_the_constraint(simple: bool) -> None:
    backgrounds = scene(build(constraints=replace(ALL, background_simplicity=simple))).backgrounds
    assert backgrounds.shape == (6, 3, 8, 8)
    assert (backgrounds.std(dim=3).max() < 1e-6) == simple


def test_every_generator_receives_gradients() -> None:
    model = build()
    generated = scene(model)
    weights = torch.linspace(-1, 1, generated.vertices.numel()).view_as(generated.vertices)
    loss = (generated.vertices * weights).sum() + generated.texture_maps[:, :, 3].sum() + generated.backgrounds.sum()
    loss.backward()
    assert all(parameter.grad is not None and parameter.grad.isfinite().all() for parameter in model.parameters())


def test_generators_survive_their_file_and_the_chosen_ones_come_first(tmp_path: Path) -> None:
    models = [build(seed=seed).eval() for seed in range(3)]
    directions, faces = icosphere(1)
    tensors = {"seed_scores": torch.tensor([0.5, 0.1, 0.4]), "faces": faces, "directions": directions}
    save_tensors(tmp_path / "scene.safetensors", {**tensors, **scene_tensors(models)}, scene_metadata(models[0]))
    save_tensors(tmp_path / "mesh.safetensors", {}, {"seed": "2"})
    files, device = (tmp_path / "scene.safetensors", tmp_path / "mesh.safetensors"), torch.device("cpu")
    loaded = load_scenes(*files, 8, device)
    assert torch.equal(loaded.faces, faces)
    assert torch.equal(loaded.directions, directions)
    for ours, theirs in zip(loaded.generators, [models[2], models[0], models[1]], strict=True):
        assert all(torch.equal(a, b) for a, b in zip(scene(ours), scene(theirs), strict=True))
    larger, usual = scene(load_scenes(*files, 16, device).generators[0]), scene(models[2])
    assert torch.equal(larger.vertices, usual.vertices)
    assert larger.backgrounds.shape == (6, 3, 16, 16)
    upper, lower = usual.backgrounds[:, :, :-1], usual.backgrounds[:, :, 1:]
    torch.testing.assert_close(larger.backgrounds[:, :, 1:-1:2, ::2], 0.75 * upper + 0.25 * lower)


def test_the_offset_scale_scales_offsets() -> None:
    latent, made = torch.randn(2, 4, generator=generator(0)), []
    for scale in (1.0, 3.0):
        with initialised(0):
            made.append(ShapeGenerator(4, 8, 5, scale)(latent))
    torch.testing.assert_close(made[1], 3 * made[0])


def test_untrained_backgrounds_differ_in_colour() -> None:
    model = build()
    backgrounds = model(model.sample_noise(200, generator(1))).backgrounds
    assert backgrounds.std(dim=0).mean() > 0.04


def test_rows_are_stretched_linearly() -> None:
    rows = torch.tensor([[[0.0, 1.0, 3.0], [3.0, 3.0, 3.0]]])
    expected = torch.tensor([[[0.0, 0.25, 0.75, 1.5, 2.5, 3.0], [3.0] * 6]])
    torch.testing.assert_close(LinearUpsample(6)(rows), expected)


def test_first_shapes_are_the_initial_ones() -> None:
    with initialised(0):
        network = ShapeGenerator(16, 32, 42, 1.0)
    offsets = network(torch.randn(64, 16, generator=generator(0)))
    assert 0 < offsets.abs().max() < 0.02
