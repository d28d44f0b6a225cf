"""`kato3d doctor`, on a project with a tiny trained model."""

import subprocess
import sys
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from pipeline.cli import doctor
from pipeline.cli.__main__ import main


def test_doctor_names_what_is_missing(project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as exit_:
        main(["doctor", "--project", str(project)])
    assert exit_.value.code == 1
    lines = capsys.readouterr().out.splitlines()
    missing = [line for line in lines if line.startswith("MISSING")]
    assert [line for line in missing if "page of 'toybox-car'" in line]
    assert [line for line in missing if "photographs of 'toybox'" in line]
    assert any(line.startswith("ok      torch ") for line in lines)
    assert any(line.startswith("ok      model of 'toybox-car'") for line in lines)
    assert any(line.startswith("ok      features of 'toybox-car'") for line in lines)


def test_doctor_names_a_source_that_is_no_path(project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    params = project / "params.yaml"
    settings = YAML().load(params)
    settings["datasets"]["toybox"]["source"] = 2024
    YAML().dump(settings, params)
    with pytest.raises(SystemExit):
        main(["doctor", "--project", str(project)])
    assert "'datasets.toybox.source' must be text, not 2024" in capsys.readouterr().out


def test_doctor_needs_no_runs(project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    params = project / "params.yaml"
    settings = YAML().load(params)
    settings |= {"runs": None, "datasets": None}
    YAML().dump(settings, params)
    main(["doctor", "--project", str(project)])
    assert "MISSING" not in capsys.readouterr().out


def test_doctor_tells_what_it_finds_before_what_it_cannot_read(
    project: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (project / "params.yaml").write_text("runs: [")
    with pytest.raises(SystemExit, match=r"^error: \S*params\.yaml"):
        main(["doctor", "--project", str(project)])
    assert "ok      MeshLab loads" in capsys.readouterr().out


def test_doctor_names_an_entry_that_is_no_section(project: Path) -> None:
    params = project / "params.yaml"
    whole = params.read_text()
    for section, broken, words in (
        ("runs", {"toybox-car": "toybox"}, "'runs.toybox-car' must be a section of keys and values, not 'toybox'"),
        ("runs", {"toybox-car": {"size": "laptop", "dataset": "toybox"}}, "has no 'runs.toybox-car.features'"),
        ("runs", ["toybox-car"], "'runs' must be a section of keys and values"),
        ("datasets", {"toybox": None}, "'datasets.toybox' must be a section of keys and values, not None"),
        ("datasets", {"toybox": {"kind": "toybox"}}, "has no 'datasets.toybox.source'"),
    ):
        YAML().dump(YAML().load(whole) | {section: broken}, params)
        with pytest.raises(SystemExit, match=words):
            main(["doctor", "--project", str(project)])


@pytest.mark.parametrize("package", ["packaging", "pandas", "torch"])
def test_doctor_sees_that_what_it_uses_itself_is_missing(project: Path, package: str) -> None:
    code = f"""
import sys
sys.modules[{package!r}] = None  # importing it fails
from pipeline.cli import doctor
def version(name):
    if name == {package!r}:
        raise doctor.PackageNotFoundError
    return real(name)
real, doctor.version = doctor.version, version
from pipeline.cli.__main__ import main
main(["doctor", "--project", {str(project)!r}])
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 1, done.stderr
    assert done.stderr == ""
    assert f"MISSING {package}: install it with" in done.stdout
    assert "photographs of 'toybox'" in done.stdout


def test_doctor_sees_that_meshlab_does_not_load(monkeypatch: pytest.MonkeyPatch) -> None:
    assert doctor.meshlab().found

    def refuse(name: str) -> None:
        raise ImportError(f"libGL.so.1: cannot open shared object file, needed by {name}")

    monkeypatch.setattr(doctor, "import_module", refuse)
    finding = doctor.meshlab()
    assert not finding.found
    assert finding.advice.startswith("libGL.so.1: cannot open")


def test_doctor_sees_packages_that_are_missing_or_old(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "requires", lambda _: ["numpy<1", "no-such-package", "torch>=2", "x; extra == 'none'"])
    found = [(finding.found, finding.what.split()[0], finding.advice) for finding in doctor.packages()]
    assert found[0][:2] == (False, "numpy")
    assert found[0][2].startswith("needs <1; install it with")
    assert found[1][:2] == (False, "no-such-package")
    assert found[1][2].startswith("install it with")
    assert found[2][:2] == (True, "torch")
    assert len(found) == 3
