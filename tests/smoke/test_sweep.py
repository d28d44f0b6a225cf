"""Many runs at once from DVC's queue, and artifacts that travel through a remote."""

import hashlib
import shutil
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest
from moto.server import ThreadedMotoServer
from ruamel.yaml import YAML

from pipeline.files import sha256
from tests.smoke.tiny_project import commands, make_tiny_project, run

pytestmark = pytest.mark.slow

STAGE = "train_features@toybox-laptop"
MODEL = "models/features/toybox-laptop.safetensors"
SEEDS = (1, 2)


@pytest.fixture(scope="module")
def meeting(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Name the place where runs of the stage wait for each other once it is there."""
    return tmp_path_factory.mktemp("place") / "meeting"


@pytest.fixture(scope="module")
def project(meeting: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run the first two stages in a project that git keeps."""
    folder = tmp_path_factory.mktemp("project")
    make_tiny_project(folder)
    shutil.copy(Path(__file__).with_name("meeting.py"), folder)
    graph = (folder / "dvc.yaml").read_text()
    command = "python -m stages.train_features"
    assert graph.count(command) == 1
    (folder / "dvc.yaml").write_text(graph.replace(command, f"python meeting.py {meeting} -m stages.train_features"))
    run(folder, "dvc", "config", "--unset", "core.no_scm")
    run(folder, "git", "init", "--quiet")
    settings = {"user.name": "a tester", "user.email": "tester@example.org", "commit.gpgsign": "false"}
    for key, value in settings.items():
        run(folder, "git", "config", key, value)
    run(folder, "dvc", "repro", STAGE)
    run(folder, "git", "add", ".")
    run(folder, "git", "commit", "--quiet", "--message", "Train features")
    return folder


@pytest.fixture(scope="module")
def experiments(project: Path, meeting: Path) -> Iterator[dict[int, str]]:
    """Queue one run a seed, let two workers take them, and return the git reference of each by its seed.

    A run that has nobody to meet in the stage fails: both train at the same time.
    """
    meeting.mkdir()
    seeds = ",".join(map(str, SEEDS))
    run(project, "dvc", "exp", "run", "--queue", "-S", f"features.toybox-laptop.seed={seeds}", STAGE)
    run(project, "dvc", "queue", "start", "--jobs", "2")
    try:
        _wait_for_queue(project)
        names = run(project, "dvc", "exp", "list", "--name-only").split()
        references = run(project, "git", "for-each-ref", "--format=%(refname)", "refs/exps").split()
        of_runs = [reference for reference in references if reference.rpartition("/")[2] in names]
        yield {_at(project, run_, "params.yaml")["features"]["toybox-laptop"]["seed"]: run_ for run_ in of_runs}
    finally:
        run(project, "dvc", "queue", "stop", "--kill")


def _wait_for_queue(project: Path) -> None:
    deadline = time.monotonic() + 240
    while any(word in (status := run(project, "dvc", "queue", "status")) for word in ("Queued", "Running")):
        assert time.monotonic() < deadline, status
        time.sleep(0.5)
    assert "Failed" not in status, status


def _at(project: Path, revision: str, path: str) -> dict:
    return YAML(typ="safe").load(run(project, "git", "show", f"{revision}:{path}"))


def test_queued_runs_do_not_disturb_each_other(project: Path, experiments: dict[int, str], tmp_path: Path) -> None:
    """Both end with the bytes of a run that is alone, and leave nothing behind."""
    assert set(experiments) == set(SEEDS)
    assert run(project, "git", "status", "--porcelain") == ""
    assert not list(project.rglob("state*.safetensors"))
    md5 = {
        seed: _at(project, name, "dvc.lock")["stages"][STAGE]["outs"][0]["md5"] for seed, name in experiments.items()
    }
    assert len(set(md5.values())) == len(SEEDS)

    command = commands(project)["train_features"]
    changed = {"--seed": "1", "--out": "model.safetensors", "--metrics": "metrics.json", "--curve": "curve.csv"}
    for option, value in (changed | {"--checkpoints": "checkpoints"}).items():
        command[command.index(option) + 1] = value if option == "--seed" else str(tmp_path / value)
    run(project, *command)
    assert hashlib.md5((tmp_path / "model.safetensors").read_bytes()).hexdigest() == md5[1]


@pytest.fixture
def bucket(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Start a server that speaks S3, with a bucket; yield its address."""
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.setenv(name, "testing")
    monkeypatch.setenv("AWS_DEFAULT_REGION", "us-east-1")
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    address = f"http://{host}:{port}"
    urllib.request.urlopen(urllib.request.Request(f"{address}/kato3d", method="PUT")).close()
    yield address
    server.stop()


@pytest.mark.parametrize("kind", ["folder", "s3"])
def test_artifacts_come_back_from_a_remote(
    project: Path, kind: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    run(
        project,
        "dvc",
        "remote",
        "add",
        "--local",
        "--force",
        "--default",
        "store",
        "s3://kato3d/store" if kind == "s3" else str(tmp_path / "store"),
    )
    if kind == "s3":
        run(project, "dvc", "remote", "modify", "--local", "store", "endpointurl", request.getfixturevalue("bucket"))
    artifacts = [project / "data/prepared/toybox", project / MODEL]
    before = [sha256(path) for path in artifacts]
    run(project, "dvc", "push", "--with-deps", STAGE)
    shutil.rmtree(project / ".dvc/cache")
    shutil.rmtree(project / "data/prepared")
    (project / MODEL).unlink()
    run(project, "dvc", "pull", "--with-deps", STAGE)
    assert [sha256(path) for path in artifacts] == before
