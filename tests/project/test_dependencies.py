"""pyproject.toml names what is imported, and constraints.txt pins it."""

import ast
import re
import sys
import tomllib
from pathlib import Path

from pipeline.rendering.compiled import KERNELS
from tests.project.import_closure import ROOT, TRAINING, import_closure

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
PACKAGE_OF = {
    "cv2": "opencv-python-headless",
    "PIL": "pillow",
    "imageio_ffmpeg": "imageio-ffmpeg",
    "pillow_heif": "pillow-heif",
    "ruamel": "ruamel.yaml",
    "yaml": "pyyaml",
}


def _names(requirements: list[str]) -> set[str]:
    return {re.split(r"[\[<>=!~ ]", requirement)[0].lower() for requirement in requirements}


def _third_party(files: list[Path]) -> set[str]:
    modules: set[str] = set()
    for file in files:
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                modules |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module is not None:
                modules.add(node.module.split(".")[0])
    modules -= {*sys.stdlib_module_names, "pipeline", "stages", "tests"}
    return {PACKAGE_OF.get(module, module) for module in modules}


def test_everything_imported_is_declared_and_nothing_else() -> None:
    extras = PROJECT["optional-dependencies"]
    declared = _names(PROJECT["dependencies"] + extras["pipeline"] + extras["video"] + extras["baselines"])
    imported = _third_party([*ROOT.glob("pipeline/**/*.py"), *ROOT.glob("stages/*.py")])
    others = {"dvc", "trimesh"}  # DVC is run, of trimesh a file is read
    assert imported == declared - others | {"triton"}, "PyTorch brings Triton to GPUs"


def test_training_needs_the_core_dependencies_alone() -> None:
    files = {ROOT / file for stage in TRAINING for file in import_closure(f"stages.{stage}")}
    compiled = {file for file in files if _third_party([file]) & {"numba", "triton"}}
    assert {file.parent.name for file in compiled} <= {"rendering"}
    assert _third_party(list(files - compiled)) <= _names(PROJECT["dependencies"])


def test_every_dependency_is_pinned() -> None:
    requirements = [PROJECT["dependencies"], *PROJECT["optional-dependencies"].values()]
    pinned = dict(line.lower().split("==") for line in (ROOT / "constraints.txt").read_text().splitlines()[1:])
    assert {name for group in requirements for name in _names(group)} <= set(pinned)


def test_compiled_kernels_are_kept_apart_by_all_they_are_compiled_from() -> None:
    modules = [path.stem for path in ROOT.glob("pipeline/rendering/*_cpu.py")]
    used = {file for module in modules for file in import_closure(f"pipeline.rendering.{module}")}
    bounds_of_settings = {"pipeline/ranges.py"}
    assert {path.relative_to(ROOT).as_posix() for path in KERNELS} == used - bounds_of_settings
