import json
import os
import shutil
import struct
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
import trimesh
from torch import Tensor
from trimesh.visual import TextureVisuals

from pipeline.export.glb import write_glb
from pipeline.export.obj import write_obj
from pipeline.export.seam import UnwrappedMesh, cut_open
from pipeline.geometry.closed_mesh import is_closed
from pipeline.geometry.icosphere import icosphere
from pipeline.geometry.topology import polygon_areas
from tests.deformed_spheres import deformed_sphere
from tests.rendering_in_torch import sample_sphere_texture

SIZE = 32
VALIDATOR = Path(__file__).parents[2] / ".ci" / "gltf-validator"


def smooth_texture() -> Tensor:
    """Return a texture of known colours: red grows to the right, green upwards, blue marks the front."""
    line = torch.linspace(0, 1, SIZE)
    front = (-((line - 0.5) ** 2) * 20).exp()
    return torch.stack([line.expand(SIZE, SIZE), line.flip(0)[:, None].expand(SIZE, SIZE), front.expand(SIZE, SIZE)])


def colors_by_uv(texture: Tensor, uv: Tensor) -> Tensor:
    """Sample a texture that repeats to the sides, as a viewer does."""
    repeated = torch.cat([texture] * 3, dim=2)[None]
    grid = torch.stack([(uv[:, 0] + 1) * 2 / 3 - 1, uv[:, 1] * 2 - 1], dim=1)[None, None]
    return torch.nn.functional.grid_sample(repeated, grid, padding_mode="border", align_corners=False)[0, :, 0].T


def turned(directions: Tensor) -> Tensor:
    """Turn the sphere so that poles and cut meet no vertex."""
    matrix = torch.linalg.qr(torch.randn(3, 3, generator=torch.Generator().manual_seed(0))).Q
    return directions @ (matrix * matrix.det())


@pytest.mark.parametrize("place", [lambda directions: directions, turned], ids=["cut along edges", "cut through faces"])
def test_flat_look_up_agrees_with_the_sphere(place: Callable[[Tensor], Tensor]) -> None:
    directions, faces = icosphere(3)
    directions = place(directions)
    mesh = cut_open(faces, directions).unwrap(directions, SIZE)
    texture = torch.rand(3, SIZE, SIZE, generator=torch.Generator().manual_seed(0))
    smooth = torch.nn.functional.avg_pool2d(torch.cat([texture] * 3, dim=2)[None], 9, 1, 4)[0, :, :, SIZE : 2 * SIZE]
    # Away from the poles, where a flat triangle cannot follow the sphere, also inside the faces.
    for weights in (torch.tensor([1.0, 0, 0]), torch.full((3,), 1 / 3), torch.tensor([0.1, 0.1, 0.8])):
        points = (mesh.vertices[mesh.faces] * weights[:, None]).sum(dim=1)
        uv = (mesh.uv[mesh.faces] * weights[:, None]).sum(dim=1)
        chosen = points[:, 1].abs() < 0.8
        expected = sample_sphere_texture(smooth[None], points[None, None, chosen])[0, :, 0].T
        torch.testing.assert_close(colors_by_uv(smooth, uv[chosen]), expected, atol=0.02, rtol=0)


@pytest.mark.parametrize("place", [lambda directions: directions, turned], ids=["cut along edges", "cut through faces"])
def test_no_face_reaches_across_the_texture(place: Callable[[Tensor], Tensor]) -> None:
    directions, faces = icosphere(3)
    mesh = cut_open(faces, place(directions)).unwrap(directions, SIZE)
    corners = mesh.uv[mesh.faces]
    assert (corners[..., 0].amax(dim=1) - corners[..., 0].amin(dim=1)).max() <= 0.51
    assert mesh.uv[:, 0].min() > -0.5
    assert mesh.uv[:, 0].max() < 1.5
    assert mesh.uv[:, 1].min() >= 0.5 / SIZE
    assert mesh.uv[:, 1].max() <= 1 - 0.5 / SIZE


@pytest.mark.parametrize("place", [lambda directions: directions, turned], ids=["cut along edges", "cut through faces"])
def test_shape_is_unchanged(place: Callable[[Tensor], Tensor]) -> None:
    vertices, faces, directions = deformed_sphere("horse")
    mesh = cut_open(faces, place(directions)).unwrap(vertices, SIZE)
    areas = polygon_areas(mesh.vertices, mesh.faces)
    torch.testing.assert_close(areas.sum(), polygon_areas(vertices, faces).sum())
    torch.testing.assert_close(mesh.normals.norm(dim=1), torch.ones(len(mesh.normals)))
    assert len(mesh.vertices) < 1.15 * len(vertices)


def upright(direction: Tensor) -> Tensor:
    """Return the rotation, to be multiplied from the right, that turns a direction upwards."""
    up = torch.nn.functional.normalize(direction, dim=0)
    right = torch.nn.functional.normalize(torch.linalg.cross(up, torch.tensor([0.3, 0.5, 0.8])), dim=0)
    return torch.stack([right, up, torch.linalg.cross(right, up)], dim=1)


@pytest.mark.parametrize("weights", [[1.0, 0, 0], [0.72, 0.28, 0], [0.5, 0.3, 0.2]], ids=["corner", "edge", "face"])
def test_copies_along_the_cut_are_equal_to_the_last_bit(weights: list[float], tmp_path: Path) -> None:
    directions, faces = icosphere(2)
    shapes = torch.rand(len(directions), 1, generator=torch.Generator().manual_seed(0)) + 0.5
    for face in faces[::20]:
        placed = directions @ upright(torch.tensor(weights) @ directions[face])
        mesh = cut_open(faces, placed).unwrap(placed * shapes, SIZE)
        assert is_closed(mesh.vertices, mesh.faces)
        loaded = read_glb(tmp_path, mesh)
        assert is_closed(torch.tensor(loaded.vertices), torch.tensor(loaded.faces))


@pytest.mark.parametrize("weights", [[1.0, 0, 0], [0.7, 0.3, 0]], ids=["corner", "edge"])
@pytest.mark.parametrize("tilt", [1e-7, 3e-6, 8e-6, 3e-5])
def test_a_pole_near_a_corner_or_an_edge_leaves_no_crack(weights: list[float], tilt: float) -> None:
    directions, faces = icosphere(2)
    for face in faces[::20]:
        near = torch.tensor(weights) @ directions[face] + tilt * torch.tensor([0.6, -0.3, 0.7])
        placed = directions @ upright(near)
        mesh = cut_open(faces, placed).unwrap(placed, SIZE)
        assert is_closed(mesh.vertices, mesh.faces)


def read_obj(folder: Path, mesh: UnwrappedMesh) -> trimesh.Trimesh:
    write_obj(folder / "car.obj", mesh, smooth_texture())
    return trimesh.load_mesh(folder / "car.obj", process=False)


def read_glb(folder: Path, mesh: UnwrappedMesh) -> trimesh.Trimesh:
    write_glb(folder / "car.glb", mesh, smooth_texture())
    return trimesh.load_mesh(folder / "car.glb", process=False)


@pytest.mark.parametrize("read", [read_obj, read_glb])
def test_another_reader_sees_the_same_mesh_and_the_texture_right_side_up(
    read: Callable[[Path, UnwrappedMesh], trimesh.Trimesh], tmp_path: Path
) -> None:
    vertices, faces, directions = deformed_sphere("car")
    mesh = cut_open(faces, directions).unwrap(vertices, SIZE)
    loaded = read(tmp_path, mesh)
    torch.testing.assert_close(torch.tensor(loaded.vertices).float(), mesh.vertices, atol=1e-6, rtol=0)
    assert torch.equal(torch.tensor(loaded.faces), mesh.faces)
    inside = (mesh.uv[:, 0] > 0.05) & (mesh.uv[:, 0] < 0.95)
    assert isinstance(loaded.visual, TextureVisuals)
    seen = torch.tensor(loaded.visual.to_color().vertex_colors[:, :3] / 255).float()
    torch.testing.assert_close(seen[inside], colors_by_uv(smooth_texture(), mesh.uv[inside]), atol=0.1, rtol=0)
    loaded.merge_vertices(merge_tex=True, merge_norm=True)
    assert loaded.is_watertight
    assert loaded.is_winding_consistent
    assert loaded.volume > 0


@pytest.mark.parametrize("name", ["shape.obj", "shape.glb"])
def test_another_reader_sees_normals_that_point_outward(name: str, tmp_path: Path) -> None:
    directions, faces = icosphere(2)
    mesh = cut_open(faces, directions).unwrap(directions * torch.tensor([0.3, 0.2, 0.5]), SIZE)
    write_obj(tmp_path / "shape.obj", mesh, smooth_texture())
    write_glb(tmp_path / "shape.glb", mesh, smooth_texture())
    (loaded,) = trimesh.load_scene(tmp_path / name, process=False).geometry.values()
    assert isinstance(loaded, trimesh.Trimesh)
    assert (loaded.vertex_normals[loaded.faces] * loaded.face_normals[:, None]).sum(axis=2).min() > 0


def test_khronos_validator_finds_nothing_wrong(tmp_path: Path) -> None:
    paths = [tmp_path / f"{name}.glb" for name in ("car", "dented")]
    for path in paths:
        vertices, faces, directions = deformed_sphere(path.stem, 3)
        write_glb(path, cut_open(faces, turned(directions)).unwrap(vertices, SIZE), smooth_texture())
    node, installed = shutil.which("node"), (VALIDATOR / "node_modules").is_dir()
    if "KATO3D_VALIDATOR_REQUIRED" not in os.environ and not (node and installed):
        pytest.skip(f"Khronos' validator is not installed: npm ci --prefix {VALIDATOR}")
    assert node
    found = subprocess.run([node, VALIDATOR / "validate.js", *paths], check=True, capture_output=True)
    for report in json.loads(found.stdout):
        assert report["issues"]["messages"] == []
        assert report["info"]["totalTriangleCount"] >= 1280


def test_textures_repeat_to_the_sides_alone_and_are_unlit(tmp_path: Path) -> None:
    vertices, faces, directions = deformed_sphere("dented", 2)
    mesh = cut_open(faces, directions).unwrap(vertices, SIZE)
    write_glb(tmp_path / "shape.glb", mesh, smooth_texture())
    write_obj(tmp_path / "shape.obj", mesh, smooth_texture())
    content = (tmp_path / "shape.glb").read_bytes()
    (length,) = struct.unpack_from("<I", content, 12)
    document = json.loads(content[20 : 20 + length])
    (sampler,), (material,) = document["samplers"], document["materials"]
    repeat, clamp_to_edge = 10497, 33071
    assert (sampler["wrapS"], sampler["wrapT"]) == (repeat, clamp_to_edge)
    assert "KHR_materials_unlit" in material["extensions"].keys() & set(document["extensionsUsed"])
    assert "illum 0" in (tmp_path / "shape.mtl").read_text().splitlines()


def test_files_are_the_same_every_time_and_name_each_other(tmp_path: Path) -> None:
    vertices, faces, directions = deformed_sphere("dented", 2)
    mesh = cut_open(faces, directions).unwrap(vertices, SIZE)
    for folder in (tmp_path / "first", tmp_path / "second"):
        folder.mkdir()
        write_obj(folder / "shape.obj", mesh, smooth_texture())
        write_glb(folder / "shape.glb", mesh, smooth_texture())
    names = ["shape.glb", "shape.mtl", "shape.obj", "shape_texture.png"]
    assert sorted(path.name for path in (tmp_path / "first").iterdir()) == names
    assert all((tmp_path / "first" / name).read_bytes() == (tmp_path / "second" / name).read_bytes() for name in names)
    assert "mtllib shape.mtl" in (tmp_path / "first" / "shape.obj").read_text()
    assert "map_Kd shape_texture.png" in (tmp_path / "first" / "shape.mtl").read_text()
