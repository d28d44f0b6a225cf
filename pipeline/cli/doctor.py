"""What is installed, which device, which data and which results are there, and how to get what is missing."""

import platform
from collections.abc import Iterator, Sequence
from importlib import import_module
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import NamedTuple

from pipeline.cli.runs import Pretrained, Run, find_pretrained, find_run
from pipeline.config import entries, scalar
from pipeline.errors import UserError

EXTRAS = ("", "pipeline")
INSTALL = "install it with `.venv/bin/pip install -c constraints.txt -e '.[pipeline]'`"


class Finding(NamedTuple):
    """One line of the doctor's report."""

    found: bool
    what: str
    advice: str


def findings(project: Path) -> Iterator[Finding]:
    """Look at packages, the device, the data, the models that come with a project, and its runs."""
    yield Finding(True, f"Python {platform.python_version()}", "")
    yield from packages()
    yield meshlab()
    yield device(project)
    yield from data(project)
    yield from pretrained(project)
    yield from runs(project)


def packages() -> Iterator[Finding]:
    """Compare what the project requires with what is installed."""
    try:
        from packaging.requirements import Requirement
    except ImportError:
        yield Finding(False, "packaging", INSTALL)
        return
    for text in requires("kato3d") or []:
        requirement = Requirement(text)
        if not any(requirement.marker is None or requirement.marker.evaluate({"extra": extra}) for extra in EXTRAS):
            continue
        try:
            installed = version(requirement.name)
        except PackageNotFoundError:
            yield Finding(False, requirement.name, INSTALL)
            continue
        right = requirement.specifier.contains(installed, prereleases=True)
        yield Finding(
            right, f"{requirement.name} {installed}", "" if right else f"needs {requirement.specifier}; {INSTALL}"
        )


def meshlab() -> Finding:
    """Load MeshLab, which needs the system's libraries of OpenGL."""
    try:
        import_module("pymeshlab")
    except ImportError as error:
        return Finding(False, "MeshLab", f"{error}; on Debian and Ubuntu `apt-get install libgl1 libopengl0`")
    return Finding(True, "MeshLab loads", "")


def device(project: Path) -> Finding:
    """Say where computations run, and in which precision."""
    try:
        import torch

        from pipeline.device import resolve_device, resolve_precision
    except ImportError as error:
        return Finding(False, "device", f"PyTorch does not load ({error}); {INSTALL}")
    try:
        chosen = resolve_device(scalar(project / "params.yaml", "device"))
        precision = resolve_precision(scalar(project / "params.yaml", "precision"), chosen)
    except UserError as error:
        return Finding(False, "device", str(error))
    name = torch.cuda.get_device_name(chosen) if chosen.type == "cuda" else f"{torch.get_num_threads()} threads"
    return Finding(True, f"device {chosen} ({name}), {str(precision).removeprefix('torch.')}", "")


def data(project: Path) -> Iterator[Finding]:
    """Look for the sources of the datasets that are on."""
    params = project / "params.yaml"
    for name in entries(params, "datasets"):
        given = scalar(params, f"datasets.{name}.source")
        if not isinstance(given, str):
            yield Finding(False, f"photographs of '{name}'", f"'datasets.{name}.source' must be text, not {given!r}")
            continue
        source = project / given
        advice = "" if source.exists() else "name its folder or archive with `make run ... SOURCE=...`"
        yield Finding(source.exists(), f"photographs of '{name}' in {source}", advice)


def pretrained(project: Path) -> Iterator[Finding]:
    """Look for every model that comes with the project, and for its features."""
    for name in entries(project / "params.yaml", "pretrained"):
        yield from _files(find_pretrained(project, name), ("model", "features"), f"of the pretrained '{name}'")


def runs(project: Path) -> Iterator[Finding]:
    """Look for the trained model, its features and the page of every run."""
    for name in entries(project / "params.yaml", "runs"):
        yield from _files(find_run(project, name), ("model", "features", "page"), f"of '{name}'")


def _files(holder: Run | Pretrained, files: Sequence[str], whose: str) -> Iterator[Finding]:
    for file in files:
        try:
            yield Finding(True, f"{file} {whose}: {getattr(holder, file)}", "")
        except UserError as error:
            yield Finding(False, f"{file} {whose}", str(error))
