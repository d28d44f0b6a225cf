import os
import subprocess
import sys
from collections.abc import Callable
from ctypes.util import find_library
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from pipeline.errors import MeshError
from pipeline.geometry import remeshing
from pipeline.geometry.mapped_mesh import MappedMesh
from pipeline.geometry.mesh_quality import area_variation, measure_map, measure_remeshing, surface_distance
from pipeline.geometry.remeshing import IsotropicConfig, remesh_isotropic
from pipeline.geometry.sphere_map import SphereMapConfig
from pipeline.geometry.symmetry import mirror_index, reflect
from pipeline.geometry.topology import euler_characteristic
from pipeline.tensor_files import load_tensors
from tests.deformed_spheres import SHAPES, deformed_sphere
from tests.project.import_closure import ROOT

ISOTROPIC = IsotropicConfig(target_faces=1280, attempts=2, iterations=10, feature_angle=90.0, surface_tolerance=0.5)
SPHERE_MAP = SphereMapConfig(iterations=60, correction=0.5)


@pytest.mark.parametrize("name", SHAPES)
def test_remeshed_surface(name: str) -> None:
    original = MappedMesh(*deformed_sphere(name))
    remeshed = remesh_isotropic(original, ISOTROPIC, SPHERE_MAP)
    measured = measure_remeshing(original, remeshed)
    assert euler_characteristic(remeshed.faces) == 2
    assert 1100 < measured["faces_after"] < 1450
    assert measured["area_variation_after"] < min(0.45, measured["area_variation_before"])
    assert measured["hausdorff"] < 0.02
    assert measured["map_flipped_faces"] == 0
    assert measured["map_area_distortion"] < (1.6 if name == "horse" else 1.15)


def test_attempts_come_nearer_to_the_target() -> None:
    mesh = MappedMesh(*deformed_sphere("car", 2))

    def miss(attempts: int) -> int:
        config = replace(ISOTROPIC, target_faces=400, attempts=attempts, iterations=3)
        return abs(len(remesh_isotropic(mesh, config, replace(SPHERE_MAP, iterations=1)).faces) - 400)

    assert miss(3) < 0.7 * miss(1)


FREED_ZEROS = (
    "import ctypes, torch, numpy; c = ctypes.CDLL(None); c.malloc.restype = ctypes.c_void_p;"
    "held = [c.malloc(size) for size in range(24, 300, 16) for _ in range(3000)];"
    "[c.memset(ctypes.c_void_p(p), 0, 24) for p in held]; [c.free(ctypes.c_void_p(p)) for p in held[::2]];"
)


@pytest.mark.parametrize(("before", "fill"), [("", "255"), (FREED_ZEROS, "0")], ids=["fresh", "freed"])
def test_result_does_not_depend_on_what_memory_holds(before: str, fill: str, tmp_path: Path) -> None:
    remeshed = remesh_isotropic(MappedMesh(*deformed_sphere("dented")), ISOTROPIC, SPHERE_MAP)
    script = (
        f"{before}from pipeline.tensor_files import save_tensors; from tests.unit.test_remeshing import *;"
        "mesh = remesh_isotropic(MappedMesh(*deformed_sphere('dented')), ISOTROPIC, SPHERE_MAP);"
        f"save_tensors(Path({str(tmp_path / 'mesh.safetensors')!r}), dict(vertices=mesh.vertices), dict())"
    )
    zeros = {**os.environ, "MALLOC_PERTURB_": fill}
    subprocess.run([sys.executable, "-c", script], cwd=ROOT, env=zeros, check=True)
    again, _ = load_tensors(tmp_path / "mesh.safetensors")
    assert torch.equal(remeshed.vertices, again["vertices"])


@pytest.mark.skipif(find_library("c_malloc_debug") is None, reason="of glibc's debugging malloc")
def test_memory_is_sound_when_python_ends() -> None:
    checked = {**os.environ, "LD_PRELOAD": "libc_malloc_debug.so.0", "MALLOC_CHECK_": "3"}
    words = [sys.executable, "-c", "import pipeline.geometry.meshlab"]
    assert subprocess.run(words, cwd=ROOT, env=checked, check=False).returncode == 0


def test_result_is_symmetric_outward_and_the_same_every_time() -> None:
    original = MappedMesh(*deformed_sphere("car"))
    remeshed, again = (remesh_isotropic(original, ISOTROPIC, SPHERE_MAP) for _ in range(2))
    mirror = mirror_index(remeshed.directions)
    assert torch.equal(remeshed.vertices[mirror], reflect(remeshed.vertices))
    assert torch.equal(remeshed.directions[mirror], reflect(remeshed.directions))
    assert torch.linalg.det(remeshed.vertices[remeshed.faces]).sum() > 0
    assert all(torch.equal(first, second) for first, second in zip(remeshed, again, strict=True))


@pytest.mark.parametrize("name", ["horse", "finned"])
def test_lopsided_surface_is_remeshed_as_it_is(name: str) -> None:
    vertices, faces, directions = deformed_sphere(name)
    lean = torch.tensor([[1.0, 0.3, 0.0], [0.0, 1.0, 0.0], [0.4, 0.0, 1.0]])
    original = MappedMesh(vertices @ lean, faces, directions)
    remeshed = remesh_isotropic(original, replace(ISOTROPIC, target_faces=800), SPHERE_MAP)
    measured = measure_remeshing(original, remeshed)
    assert measured["area_variation_after"] < 0.45
    assert measured["hausdorff"] < 0.06
    assert measured["map_flipped_faces"] == 0
    assert measured["map_area_distortion"] < (1.8 if name == "horse" else 1.2)


def without_a_face(mesh: MappedMesh) -> MappedMesh:
    return mesh._replace(faces=mesh.faces[1:])


def with_a_stray_vertex(mesh: MappedMesh) -> MappedMesh:
    return mesh._replace(vertices=mesh.vertices.index_fill(0, torch.tensor(3), torch.nan))


def without_extent(mesh: MappedMesh) -> MappedMesh:
    return mesh._replace(vertices=mesh.vertices * torch.tensor([0.0, 1.0, 0.0]))


def with_two_spheres(mesh: MappedMesh) -> MappedMesh:
    vertices, faces, directions = mesh
    count = len(vertices)
    return MappedMesh(vertices.repeat(2, 1), torch.cat([faces, faces + count]), directions.repeat(2, 1))


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (without_a_face, "not closed"),
        (with_a_stray_vertex, "not finite"),
        (without_extent, "collapsed"),
        (with_two_spheres, "Euler characteristic 4"),
    ],
)
def test_unusable_mesh_is_refused(spoil: Callable[[MappedMesh], MappedMesh], sentence: str) -> None:
    with pytest.raises(MeshError, match=sentence):
        remesh_isotropic(spoil(MappedMesh(*deformed_sphere("dented", 2))), ISOTROPIC, SPHERE_MAP)


def test_a_map_that_is_turned_over_in_parts_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = MappedMesh(*deformed_sphere("car", 2))
    corner = mesh.faces[0, :1]
    turned_over = mesh._replace(directions=mesh.directions.index_copy(0, corner, -mesh.directions[corner]))
    monkeypatch.setattr(remeshing, "_remesh_half", lambda *_: turned_over)
    with pytest.raises(MeshError, match="the map to the sphere turns"):
        remesh_isotropic(mesh, ISOTROPIC, SPHERE_MAP)


def test_distance_of_shifted_surfaces() -> None:
    mesh = MappedMesh(*deformed_sphere("dented"))
    shifted = mesh._replace(vertices=mesh.vertices + torch.tensor([0.0, 0.1, 0.0]))
    diagonal = (mesh.vertices.amax(dim=0) - mesh.vertices.amin(dim=0)).norm().item()
    distance = surface_distance(mesh, shifted)
    assert 0.09 / diagonal < distance["hausdorff"] <= 0.1001 / diagonal
    assert 0 < distance["mean_distance"] < distance["hausdorff"]


def test_a_spike_is_as_far_whichever_surface_has_it() -> None:
    _, faces, directions = deformed_sphere("dented", 3)
    sphere = MappedMesh(directions, faces, directions)
    spiked = sphere._replace(vertices=directions * torch.ones(len(directions), 1).index_fill(0, torch.tensor([5]), 1.3))
    diagonals = [(mesh.vertices.amax(dim=0) - mesh.vertices.amin(dim=0)).norm().item() for mesh in (sphere, spiked)]
    there, back = surface_distance(sphere, spiked), surface_distance(spiked, sphere)
    for kind, distance in there.items():
        assert distance * diagonals[0] == pytest.approx(back[kind] * diagonals[1], rel=1e-3), kind
    assert there["hausdorff"] * diagonals[0] == pytest.approx(0.3, rel=0.05)


@pytest.mark.parametrize("factor", [0.25, 4.0])
def test_the_largest_distortion_is_that_of_a_share_too_small_or_too_large(factor: float) -> None:
    _, faces, directions = deformed_sphere("dented", 2)
    scales = torch.ones(len(directions), 1).index_fill(0, faces[0], factor)
    measured = measure_map(MappedMesh(directions * scales, faces, directions))
    assert measured["map_area_distortion_max"] > 8


def test_sphere_maps_to_itself_without_distortion() -> None:
    vertices, faces, directions = deformed_sphere("dented", 4)
    sphere = MappedMesh(directions, faces, directions)
    assert area_variation(sphere) < 0.2
    assert measure_map(sphere)["map_area_distortion"] < 1.001
    assert measure_map(MappedMesh(vertices, faces, directions))["map_area_distortion"] > 1.1


def test_the_attempt_nearest_to_the_target_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    made, remesh = list[int](), remeshing.isotropic_remeshing

    def worse_at_last(vertices: Tensor, faces: Tensor, edge_length: float, *rest: Any) -> tuple[Tensor, Tensor]:
        found = remesh(vertices, faces, edge_length * (2 if len(made) == 2 else 1), *rest)
        made.append(len(found[1]))
        return found

    monkeypatch.setattr(remeshing, "isotropic_remeshing", worse_at_last)
    mesh = MappedMesh(*deformed_sphere("car", 2))
    config = replace(ISOTROPIC, target_faces=400, attempts=3, iterations=3)
    found = remeshing.remesh_isotropic(mesh, config, replace(SPHERE_MAP, iterations=1))
    assert min(made, key=lambda count: abs(count - 200)) != made[2]
    assert abs(len(found.faces) - 400) < 100
