"""The full model as a whole: rebuilding it from a file, its predictions and its renderings."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from pipeline.geometry.camera import pose_to_tensor
from pipeline.networks.encoders import Encoder
from pipeline.networks.full_model import FullModel, load_full_model, save_full_model
from pipeline.seeding import generator
from pipeline.tensor_files import save_tensors
from pipeline.training.full import load_base
from tests.tiny_full_model import (
    CHANNELS,
    MODEL,
    TRAINING,
    base_mesh,
    inferred,
    photographs,
    tiny_extractor,
    tiny_model,
)


def pictures(count: int) -> Tensor:
    return photographs(count)[0].float() / 255


@pytest.mark.parametrize("shapes_from", ["photographs", "features"])
def test_model_from_a_file_predicts_the_same(shapes_from: str, tmp_path: Path) -> None:
    model, images = tiny_model(framing="box", shapes_from=shapes_from).eval(), pictures(2)
    path = tmp_path / "model.safetensors"
    save_full_model(path, model, {})
    loaded = load_full_model(path, torch.device("cpu"))
    assert loaded.config == model.config
    assert not loaded.training
    assert torch.equal(loaded.render(inferred(loaded, images)), model.render(inferred(model, images)))


def test_reconstructions_of_single_photographs_equal_those_of_a_batch() -> None:
    model, images = tiny_model().eval(), pictures(3)
    batch, single = inferred(model, images), inferred(model, images[1:2])
    torch.testing.assert_close(batch.vertices[1:2], single.vertices)
    torch.testing.assert_close(batch.texture_maps[1:2], single.texture_maps)
    torch.testing.assert_close(pose_to_tensor(batch.pose)[1:2], pose_to_tensor(single.pose))
    torch.testing.assert_close(batch.backgrounds[1:2], single.backgrounds)


def test_constraints_of_textures_and_backgrounds() -> None:
    reconstruction = inferred(tiny_model(), pictures(2))
    torch.testing.assert_close(reconstruction.texture_maps, reconstruction.texture_maps.flip(-1))
    assert torch.equal(reconstruction.backgrounds, reconstruction.backgrounds[..., :1].expand(-1, -1, -1, 32))
    free = inferred(tiny_model(mirror_texture=False), pictures(2)).texture_maps
    assert (free - free.flip(-1)).abs().amax() > 1e-3


def test_textures_alone_are_read_from_whitened_colors() -> None:
    model = tiny_model()
    model.standardize(pictures(8), tiny_extractor()(pictures(8)))
    encoders = {name: part for name, part in model.named_children() if isinstance(part, Encoder)}
    plain = {name for name, encoder in encoders.items() if torch.equal(encoder.color_mixing, 2 * torch.eye(3))}
    assert encoders.keys() - plain == {"texture_encoder"}
    assert len(plain) == 2


@pytest.mark.parametrize("shapes_from", ["photographs", "features"])
def test_gradients_of_a_rendering_reach_every_network(shapes_from: str) -> None:
    model = tiny_model(shapes_from=shapes_from)
    images = pictures(2)
    vertices = model.shapes(model.read_shapes(images, tiny_extractor()(images)))
    reconstruction = inferred(model, images)._replace(
        vertices=vertices,
        pose=model.poses(model.pose_decoder(model.pose_encoder(images)).coordinates, vertices),
        texture_maps=model.texture_decoder(model.texture_encoder(images)),
        backgrounds=model.background_decoder(model.background_encoder(images)),
    )
    (model.render(reconstruction) - images).square().mean().backward()
    for name in ("shape", "pose", "texture", "background"):
        encoder = getattr(model, f"{name}_encoder")
        assert all(p.grad is not None and p.grad.abs().sum() > 0 for p in encoder.parameters()), name


def test_single_stage_training_starts_from_the_ellipsoid_and_needs_no_mesh() -> None:
    single_stage = replace(TRAINING, model=replace(MODEL, two_stage=False))
    base = load_base(single_stage, Path("missing"), torch.device("cpu"))
    model = FullModel(single_stage.model, base, torch.float32, CHANNELS)
    sides = base.vertices[0].amax(0) - base.vertices[0].amin(0)
    torch.testing.assert_close(sides, torch.tensor([0.5, 0.5, 1.0]), atol=0.02, rtol=0)
    assert model.shapes.parameter_count == base.vertices[0].numel()


def test_base_mesh_is_read_from_its_file_and_fitted_to_the_unit_cube(tmp_path: Path) -> None:
    mesh, path = base_mesh(), tmp_path / "mesh.safetensors"
    tensors = {"vertices": 2 * mesh.vertices[0], "faces": mesh.faces, "directions": mesh.directions}
    save_tensors(path, tensors, {})
    loaded = load_base(TRAINING, path, torch.device("cpu"))
    torch.testing.assert_close(loaded.vertices, mesh.vertices)
    assert torch.equal(loaded.faces, mesh.faces)


def test_true_coordinates_rerender_the_photographs_silhouettes() -> None:
    model = tiny_model()
    images, coordinates = photographs(4)
    vertices = model.base_vertices.expand(4, -1, -1)
    with torch.no_grad():
        prediction = inferred(model, images.float() / 255)
        white = torch.ones_like(prediction.backgrounds)
        pose = model.poses(coordinates, vertices)
        black = torch.zeros_like(prediction.texture_maps)
        shadows = model.render(prediction._replace(vertices=vertices, pose=pose, texture_maps=black, backgrounds=white))
    background = (images.float() / 255 - 0.8).abs().amax(dim=1) < 0.01
    assert (background == (shadows[:, 0] > 0.99)).float().mean() > 0.97


def test_random_poses_differ() -> None:
    drawn = tiny_model().poses.draw(100, generator(0))
    assert len(drawn.unique(dim=0)) == 100


def test_backgrounds_without_stripes_are_any_picture() -> None:
    reconstruction = inferred(tiny_model(stripes=False), torch.rand(2, 3, 32, 32, generator=generator(0)))
    assert reconstruction.backgrounds.std(dim=3).min() > 1e-4


def test_poses_of_symmetric_objects_are_read_off_mirror_images_too() -> None:
    model, images = tiny_model().eval(), pictures(3)
    read = model.read_poses(images)
    torch.testing.assert_close(model.read_poses(images.flip(-1)), model.poses.mirror(read), atol=1e-5, rtol=0)
    lopsided = tiny_model(shape=replace(MODEL.shape, mirror=False)).eval()
    own = lopsided.pose_decoder(lopsided.pose_encoder(images)).coordinates
    torch.testing.assert_close(lopsided.read_poses(images), own)
    assert (lopsided.read_poses(images) - read).abs().amax() > 1e-3
