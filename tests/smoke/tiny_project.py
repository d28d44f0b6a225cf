"""A copy of the project whose numbers are so small that the whole chain runs within a minute."""

import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from numba.core.caching import UserProvidedCacheLocator
from ruamel.yaml import YAML

from pipeline.rendering.compiled import config
from tests.fresh_params import write_fresh_params

ROOT = Path(__file__).parents[2]

TINY: dict[str, Any] = {
    "device": "cpu",
    "precision": "bfloat16",  # wherever the tests run; unit tests have float32
    "prepare_data": {"toybox": {"train_count": 8, "test_count": 4, "photograph": {"supersampling": 2}}},
    "train_features": {
        "method": "rotation",
        "depth": 10,
        "width": 1,
        "epochs": 3,
        "batch_size": 8,
        "checkpoint_every": 1,
    },
    "learn_base_shape": {
        "iterations": 6,
        "batch_size": 4,
        "seeds": 2,
        "subdivisions": 2,
        "generator": {"latent_size": 8, "shape_hidden": 16, "texture_channels": 4, "texture_size": 16},
        "score_batches": 1,
        "curve_every": 2,
        "checkpoint_every": 1,
    },
    "remesh": {"isotropic": {"target_faces": 320, "attempts": 1, "iterations": 3}, "sphere_map": {"iterations": 3}},
    "train_full": {
        "iterations": 6,
        "batch_size": 4,
        "model": {
            "encoder": {"width": 8, "blocks": 1},
            "code_size": 8,
            "texture_code_size": 8,
            "hidden_size": 8,
            "texture_size": 16,
            "texture_channels": 4,
        },
        "discriminator_width": 4,
        "curve_every": 1,
        "warm_up": {"iterations": 2, "batch_size": 4},
        "first_poses": {"renderings": 8},
        "lessons": {"iterations": 2, "batch_size": 4},
        "settle": 0.5,
        "checkpoint_every": 1,
    },
    "fine_tune": {
        "batch_size": 1,
        "background": {"steps": 2},
        "pose": {"steps": 2},
        "shape": {"steps": 2},
    },
    "evaluate_base_shape": {"voxel_resolution": 8, "view": {"size": 32, "supersampling": 1}},
    "train_hologan": {
        "iterations": 20,
        "batch_size": 2,
        "network": {"latent_size": 4, "width": 2, "discriminator_width": 4},
        "curve_every": 5,
        "checkpoint_every": 1,
    },
    "evaluate": {"shape": {"voxel_resolution": 8, "surface_points": 50}, "chance_draws": 10},
    "report": {"examples": 2, "stepped": 1, "view": {"size": 32, "supersampling": 1}},
    "turntable": {"frames": 2, "view": {"size": 32, "supersampling": 1}},
}


def make_tiny_project(folder: Path) -> None:
    """Copy the code and the graph, shrink the numbers and set up DVC."""
    for package in ("pipeline", "stages"):
        shutil.copytree(ROOT / package, folder / package, ignore=shutil.ignore_patterns("kernels-*"))
    _share_kernels(folder)
    (folder / "data" / "raw").mkdir(parents=True)
    for path in (ROOT / "dvc.yaml", ROOT / ".dvcignore", *ROOT.glob("data/raw/*.safetensors")):
        shutil.copy(path, folder / path.relative_to(ROOT))
    params = YAML(typ="safe").load(write_fresh_params(folder / "params.yaml"))
    params["sizes"]["laptop"] = {stage: {} for stage in params["sizes"]["laptop"]}
    for row in params["rows"].values():
        row["learn_base_shape"].pop("iterations", None)
    replace(params, TINY)
    write_params(folder, params)
    run(folder, "dvc", "init", "--quiet", "--no-scm")


def _share_kernels(folder: Path) -> None:
    """Let numba compile for the repository and the copy at once: it keeps kernels by the place of their code."""
    compiled = Path(config.CACHE_DIR)  # pyright: ignore[reportAttributeAccessIssue]
    ours, theirs = (
        UserProvidedCacheLocator.get_suitable_cache_subpath(str(root / "pipeline" / "rendering" / "kernels.py"))
        for root in (ROOT, folder)
    )
    (compiled / ours).mkdir(parents=True, exist_ok=True)
    link = folder / "pipeline" / "rendering" / "__pycache__" / compiled.name / theirs
    link.parent.mkdir(parents=True)
    link.symlink_to(compiled / ours)


def replace(values: dict[str, Any], changes: Mapping[str, Any]) -> None:
    """Replace values that exist, at any depth. Raises KeyError for one that does not."""
    for name, change in changes.items():
        if isinstance(change, Mapping):
            replace(values[name], change)
        else:
            values[name] = type(values[name])(change) if values[name] is not None else change


def read_params(folder: Path) -> dict[str, Any]:
    return YAML(typ="safe").load(folder / "params.yaml")


def write_params(folder: Path, params: dict[str, Any]) -> None:
    YAML(typ="safe", pure=True).dump(params, folder / "params.yaml")


def run(folder: Path, *command: str) -> str:
    """Run a command of the environment in the project; return what it prints. Fails with that where it fails."""
    finished = subprocess.run(command, cwd=folder, env=environment(), capture_output=True, text=True, check=False)
    assert finished.returncode == 0, f"{' '.join(command)}\n{finished.stdout}\n{finished.stderr}"
    return finished.stdout


def environment() -> dict[str, str]:
    """Put this environment's programs first, and let one thread do the little work there is."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    return {**os.environ, "PATH": path, "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1", "DVC_NO_ANALYTICS": "1"}


def commands(folder: Path) -> dict[str, list[str]]:
    """Return the command line of every stage, as it was run."""
    stages = YAML(typ="safe").load(folder / "dvc.lock")["stages"]
    return {name.split("@")[0]: stage["cmd"].split() for name, stage in stages.items()}
