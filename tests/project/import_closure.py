"""Find the code that each stage runs, and keep the code dependencies of dvc.yaml equal to it.

DVC does not follow imports. `python -m tests.project.import_closure` rewrites the dependencies.
"""

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

ROOT = Path(__file__).parents[2]
PACKAGES = ("pipeline", "stages")
CODE = (".py", ".js")
TRAINING = ["train_features", "learn_base_shape", "train_full", "fine_tune", "train_hologan"]
"""Stages that train."""


def import_closure(module: str, root: Path = ROOT) -> list[str]:
    """List the project's files that a module imports, directly or not, at its top or inside a function; itself too.

    With a module come the scripts for browsers that lie beside it and that it names.
    """
    found: set[Path] = set()
    waiting = [_file(module, root)]
    while waiting:
        file = waiting.pop()
        if file is not None and file not in found:
            found |= {file, *_named_scripts(file)}
            waiting += [_file(name, root) for name in _imported_names(file)]
    return sorted(file.relative_to(root).as_posix() for file in found)


def code_dependencies(stage: dict[str, Any]) -> list[str]:
    """List the code among a stage's dependencies, as dvc.yaml gives them."""
    return [path for path in stage["deps"] if path.endswith(CODE)]


def stage_bodies(document: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the body of every stage of dvc.yaml: what stands under `do` where a stage is repeated."""
    return {name: stage.get("do", stage) for name, stage in document["stages"].items()}


def _imported_names(file: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def _named_scripts(file: Path) -> list[Path]:
    return [path for path in file.parent.glob("*.js") if f'"{path.name}"' in file.read_text(encoding="utf-8")]


def _file(module: str, root: Path) -> Path | None:
    if module.split(".")[0] not in PACKAGES:
        return None
    file = root.joinpath(*module.split(".")).with_suffix(".py")
    return file if file.exists() else None


def _rewrite(path: Path) -> None:
    yaml = YAML()
    yaml.width = 120
    document = yaml.load(path)
    for name, stage in stage_bodies(document).items():
        data = [dependency for dependency in stage["deps"] if not dependency.endswith(CODE)]
        stage["deps"][:] = data + import_closure(f"stages.{name}")
    yaml.dump(document, path)


if __name__ == "__main__":
    _rewrite(ROOT / "dvc.yaml")
