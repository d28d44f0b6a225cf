"""`kato3d benchmark`: predictions of any method, measured as a run is."""

import json
import math
import re
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh
from ruamel.yaml import YAML

from pipeline.cli.__main__ import main
from pipeline.datasets.images import to_bytes
from pipeline.datasets.prepared import write_images, write_truth
from pipeline.datasets.truth import GroundTruth, viewpoints_of_boxes
from pipeline.evaluation.artifacts import Reconstructions, Truth
from pipeline.evaluation.evaluate import ChainResult, evaluate_images, evaluate_truth
from pipeline.evaluation.pose import rotation
from pipeline.evaluation.shape_metrics import silhouettes
from pipeline.networks.feature_extractor import FeatureExtractor
from pipeline.networks.wide_resnet import WideResNet
from pipeline.seeding import initialised, numpy_generator
from tests.turned_ellipsoids import (
    CONFIG,
    COUNT,
    TRAINING_COUNT,
    shown_ellipsoids,
    training_ellipsoids,
    turned_answers,
)

DOCUMENT = (Path(__file__).parents[2] / "docs" / "benchmark.md").read_text()
Arrays = dict[str, np.ndarray]


@pytest.fixture(scope="module")
def truth() -> Truth:
    return shown_ellipsoids()


@pytest.fixture(scope="module")
def training() -> Truth:
    return training_ellipsoids()


@pytest.fixture(scope="module")
def photographs() -> dict[str, np.ndarray]:
    rng = numpy_generator(0, "photographs")
    counts = {"train": TRAINING_COUNT, "test": COUNT}
    return {split: rng.integers(256, size=(count, 16, 16, 3), dtype=np.uint8) for split, count in counts.items()}


@pytest.fixture(scope="module")
def learned(training: Truth, truth: Truth, photographs: dict[str, np.ndarray]) -> ChainResult:
    """Give the answers of a run, whose predicted pictures are the photographs, half as bright."""
    answers = turned_answers(training, truth)
    images = torch.from_numpy(photographs["test"] // 2).permute(0, 3, 1, 2).contiguous().float() / 255
    predicted = answers.reconstructions.predicted._replace(images=images)
    return answers._replace(reconstructions=answers.reconstructions._replace(predicted=predicted))


@pytest.fixture(scope="module")
def project(
    tmp_path_factory: pytest.TempPathFactory, training: Truth, truth: Truth, photographs: dict[str, np.ndarray]
) -> Path:
    """Write settings, photographs, and the truth, of `toybox` whole and of `cars` without shapes."""
    folder = tmp_path_factory.mktemp("project")
    YAML(typ="safe").dump({"evaluate": asdict(CONFIG), "datasets": {"boats": {}}}, folder / "params.yaml")
    splits = {"train": training, "test": truth}
    boxes = {
        split: {"car": viewpoints_of_boxes([tuple(row) for row in angles(known).tolist()])}
        for split, known in splits.items()
    }
    for dataset, known in (
        ("toybox", {name: {"car": arrays(known)} for name, known in splits.items()}),
        ("cars", boxes),
    ):
        write_truth(folder / "data" / "truth" / dataset, known)
        images = {split: {"car": pictures} for split, pictures in photographs.items()}
        write_images(folder / "data" / "prepared" / dataset, images)
    return folder


def arrays(truth: Truth) -> GroundTruth:
    assert truth.objects is not None
    pose = {name: values.numpy() for name, values in truth.pose._asdict().items()}
    masks, vertices, faces = (values.numpy() for values in truth.objects)
    return GroundTruth(**pose, masks=masks.astype(np.uint8), vertices=vertices, faces=faces)


def angles(truth: Truth) -> np.ndarray:
    return torch.stack(truth.pose[:3], dim=1).numpy()


def exported(learned: ChainResult) -> Arrays:
    """Bring what a run says into the form of the benchmark."""
    found = learned.reconstructions
    masks = silhouettes(found.predicted, found.faces, found.directions, learned.renderer)
    images = to_bytes(found.predicted.images).permute(0, 2, 3, 1)
    return {
        "train_angles": angles(Truth(learned.training_pose, None)),
        "train_index": learned.training_index.numpy(),
        "test_angles": angles(Truth(found.predicted.pose, None)),
        "masks": masks.numpy(),
        "vertices": found.predicted.vertices.numpy(),
        "faces": found.faces.numpy(),
        "images": images.numpy(),
    }


@pytest.fixture(scope="module")
def ours(learned: ChainResult) -> Arrays:
    return exported(learned)


def measure(project: Path, folder: Path, predictions: Mapping[str, np.ndarray], dataset: str = "toybox") -> Any:
    np.savez(folder / "ours.npz", **predictions)  # pyright: ignore[reportArgumentType]
    return benchmark(project, folder / "ours.npz", "--dataset", dataset)


def benchmark(project: Path, file: Path, *words: str) -> Any:
    out = file.with_suffix(".json")
    main(["benchmark", "--project", str(project), str(file), "--category", "car", "--out", str(out), *words])
    return json.loads(out.read_text())


def test_a_runs_predictions_have_the_figures_of_evaluate(
    project: Path, learned: ChainResult, ours: Arrays, training: Truth, truth: Truth, tmp_path: Path
) -> None:
    figures = measure(project, tmp_path, ours)
    expected = evaluate_truth(learned, training, truth, CONFIG)[0]
    assert figures["alignment"] == expected["alignment"]
    assert figures["pose"] == {name: expected["pose"][name] for name in ("train", "test", "chance", "constant")}
    assert figures["shape"] == {name: expected["shape"][name] for name in ("test", "constant")}
    assert figures["reconstruction"] == {"predicted": image_figures_of_evaluate(learned.reconstructions, project)}


def image_figures_of_evaluate(found: Reconstructions, project: Path) -> dict[str, Any]:
    photographs, training = (
        torch.from_numpy(np.load(project / f"data/prepared/toybox/{split}/car.npy")).permute(0, 3, 1, 2)
        for split in ("test", "train")
    )
    with initialised(0, "extractor"):
        extractor = FeatureExtractor(WideResNet(10, 1, 2), 2.0)
    figures, _ = evaluate_images(photographs.contiguous().float() / 255, training, found, extractor, CONFIG)
    return {name: figures["reconstruction"]["predicted"][name] for name in ("psnr", "ssim")}


def perfect(learned: ChainResult, photographs: Mapping[str, np.ndarray], truth: Truth) -> Arrays:
    """Give the truth in the frame of the run, turned by 90 degrees."""
    assert truth.objects is not None
    right = exported(
        learned._replace(reconstructions=learned.reconstructions._replace(predicted=learned.reconstructions.tuned))
    )
    return right | {"masks": truth.objects.masks.numpy(), "images": photographs["test"]}


def test_the_truth_in_a_turned_frame_has_full_marks(
    project: Path,
    learned: ChainResult,
    photographs: dict[str, np.ndarray],
    truth: Truth,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    figures = measure(project, tmp_path, perfect(learned, photographs, truth))
    assert figures["alignment"]["degrees"] == pytest.approx(90)
    assert figures["pose"]["test"]["acc_pi6"] == figures["pose"]["test"]["seen_side"]["value"] == 1
    assert figures["pose"]["test"]["median_error_degrees"]["value"] == pytest.approx(0, abs=1e-3)
    assert figures["shape"]["test"]["mask_iou"] == {"value": 1, "standard_error": 0, "n": COUNT}
    assert figures["shape"]["test"]["voxel_iou"]["value"] > 0.99
    assert figures["shape"]["test"]["height_correlation"]["value"] > 0.999
    assert figures["reconstruction"]["predicted"]["ssim"]["value"] == pytest.approx(1)
    assert figures["reconstruction"]["predicted"]["psnr"]["value"] == pytest.approx(100)
    printed = capsys.readouterr().out.splitlines()
    assert f"shape.test.mask_iou                    1.0000      0.0000     {COUNT}" in printed
    assert printed[-1] == f"written to {tmp_path / 'ours.json'}"


def test_meshes_may_have_faces_of_their_own(project: Path, ours: Arrays, tmp_path: Path) -> None:
    """Cut one along every edge, make the faces of another smaller, and give all vertices that no face names."""
    meshes = [trimesh.Trimesh(vertices, ours["faces"], process=False) for vertices in ours["vertices"]]
    meshes[1].unmerge_vertices()
    meshes[2] = meshes[2].subdivide()
    most = max(len(mesh.vertices) for mesh in meshes) + 1
    own = {
        "vertices": np.full((COUNT, most, 3), 100.0),
        "faces": np.full((COUNT, max(len(mesh.faces) for mesh in meshes), 3), -1),
    }
    for number, mesh in enumerate(meshes):
        own["vertices"][number, : len(mesh.vertices)] = mesh.vertices
        own["faces"][number, : len(mesh.faces)] = mesh.faces
    shared, figures = (measure(project, tmp_path, ours | change)["shape"] for change in ({}, own))
    distance, other_distance = (shape["test"].pop("chamfer_l1")["value"] for shape in (shared, figures))
    assert other_distance == pytest.approx(distance, rel=0.05)
    assert figures["constant"] == shared["constant"]
    for name, figure in shared["test"].items():
        assert figures["test"][name]["value"] == pytest.approx(figure["value"], abs=1e-3), name


@pytest.mark.parametrize(
    ("names", "sections"),
    [
        (["masks"], {"shape": ["constant", "test"]}),
        (["images"], {"reconstruction": ["predicted"]}),
        (["train_angles", "train_index"], {"alignment": ["degrees", "n"], "pose": ["chance", "constant", "train"]}),
    ],
)
def test_what_is_missing_is_not_measured(
    project: Path, ours: Arrays, names: list[str], sections: dict[str, list[str]], tmp_path: Path
) -> None:
    figures = measure(project, tmp_path, {name: ours[name] for name in names})
    assert {name: list(section) for name, section in figures.items()} == sections
    assert all(list(part) == ["mask_iou"] for part in figures.get("shape", {}).values())


def changed(array: np.ndarray, place: Any, value: float) -> np.ndarray:
    copy = array.copy()
    copy[place] = value
    return copy


@pytest.mark.parametrize(("size", "place"), [(1e-300, 0.0), (1e300, 0.0), (1.0, 1e7), (3.0, -1e9)])
def test_meshes_may_have_any_size_and_place(
    project: Path, ours: Arrays, size: float, place: float, tmp_path: Path
) -> None:
    whole = measure(project, tmp_path, ours)["shape"]["test"]
    vertices = ours["vertices"].astype(np.float64) * size + place
    moved = measure(project, tmp_path, ours | {"vertices": vertices})["shape"]["test"]
    for name in ("voxel_iou", "chamfer_l1"):
        assert moved[name]["value"] == pytest.approx(whole[name]["value"], rel=2e-3)


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("masks", lambda masks: masks[1:], r"'masks' has the shape \(11, 16, 16\); expected \(12, 16, 16\)$"),
        ("masks", lambda masks: masks * 255, r"'masks' holds int64; expected bool$"),
        ("images", lambda images: images / 255, r"'images' holds float64; expected uint8$"),
        ("train_angles", lambda angles: angles[:0], r"'train_angles' has the shape \(0, 3\); expected \(M, 3\)$"),
        (
            "train_angles",
            lambda angles: angles[:-1],
            r"'train_angles' has 11 rows; expected 12, or 'train_index' of as",
        ),
        ("train_index", lambda index: index + 1, r"'train_index' must name pictures from 0 to 19, each once at most$"),
        ("train_index", lambda index: index * 0, r"'train_index' must name pictures from 0 to 19, each once at most$"),
        (
            "test_angles",
            np.rad2deg,
            r"'test_angles' has \(.*\) in its entry 0; expected azimuth, elevation and roll in rad",
        ),
        ("test_angles", np.int64, r"'test_angles' holds int64; expected floating-point numbers$"),
        (
            "test_angles",
            lambda angles: changed(angles, (3, 1), np.nan),
            r"'test_angles' has NaN or infinity in its entry 3",
        ),
        (
            "vertices",
            lambda vertices: changed(vertices, (0, 5, 1), np.inf),
            r"'vertices' has NaN or infinity in its entry 0; expected fin",
        ),
        (
            "vertices",
            lambda vertices: changed(vertices, (7, ..., 1), 0),
            r"picture 7 encloses a volume of .* flat or insi",
        ),
        (
            "faces",
            lambda faces: faces[:, ::-1],
            r"picture 0 encloses a volume of -0\.\d when scaled into the unit cube",
        ),
        ("faces", lambda faces: faces[1:], r"picture 0 is not closed: expected every edge to join faces of one orient"),
        ("faces", lambda faces: faces + 1, r"'faces' must name vertices from 0 to 161, at least one triple a mesh; -1"),
        ("faces", lambda faces: faces - faces - 1, r"'faces' must name vertices from 0 to 161, at least one triple a"),
        (
            "faces",
            lambda faces: faces[None],
            r"'faces' has the shape \(1, 320, 3\); expected \(F, 3\) or \(12, F, 3\)$",
        ),
    ],
)
def test_what_is_wrong_with_an_array_is_one_sentence(
    project: Path, ours: Arrays, name: str, change: Callable[[Any], Any], message: str, tmp_path: Path
) -> None:
    with pytest.raises(SystemExit, match=rf"^error: \S*ours\.npz: .*{message}"):
        measure(project, tmp_path, ours | {name: change(ours[name])})
    assert sorted(path.name for path in tmp_path.iterdir()) == ["ours.npz"]


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ([], r"ours\.npz is empty; expected some of the arrays train_angles, train_index, test_angles, masks"),
        (
            ["test_angles", "masks"],
            r"ours\.npz has 'test_angles', but no 'train_angles', by which the alignment is fitted",
        ),
        (["vertices", "faces"], r"ours\.npz has 'vertices', but no 'train_angles', by which the alignment is fitted"),
        (["vertices", "train_angles", "train_index"], r"ours\.npz has 'vertices', but no 'faces', which join them"),
        (["faces"], r"ours\.npz has 'faces', but no 'vertices', which they join"),
        (["train_index"], r"ours\.npz has 'train_index', but no 'train_angles', the poses of the pictures"),
    ],
)
def test_an_array_that_lacks_another_is_named(
    project: Path, ours: Arrays, names: list[str], message: str, tmp_path: Path
) -> None:
    with pytest.raises(SystemExit, match=f"^error: .*{message}"):
        measure(project, tmp_path, {name: ours[name] for name in names})


def test_an_unknown_array_is_named_with_the_nearest(project: Path, ours: Arrays, tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match=r"ours\.npz has an unknown array 'mask'; did you mean 'masks'\?$"):
        measure(project, tmp_path, ours | {"mask": ours["masks"]})


def test_files_that_are_no_arrays_of_numbers_are_refused(project: Path, ours: Arrays, tmp_path: Path) -> None:
    np.savez(tmp_path / "whole.npz", masks=ours["masks"])
    whole = (tmp_path / "whole.npz").read_bytes()
    np.savez(tmp_path / "objects.npz", masks=np.array([{}]))
    np.save(tmp_path / "array.npy", ours["masks"])
    with zipfile.ZipFile(tmp_path / "text.npz", "w") as archive:
        archive.writestr("masks", "text")
    header = whole.index(b"'shape'")
    with zipfile.ZipFile(tmp_path / "huge.npz", "w") as archive, archive.open("masks.npy", "w") as stream:
        np.lib.format.write_array_header_1_0(stream, {"descr": "|b1", "fortran_order": False, "shape": (2**50,)})
    for name, content in (
        ("cut.npz", whole[:-30]),
        ("none.npz", b""),
        ("turned.npz", whole[:header] + b"(" + whole[header + 1 :]),
    ):
        (tmp_path / name).write_bytes(content)
    for name in ("objects.npz", "array.npy", "text.npz", "cut.npz", "none.npz", "turned.npz", "huge.npz"):
        with pytest.raises(
            SystemExit, match=rf"{name} is damaged, no \.npz file, or holds Python objects; write it anew"
        ):
            benchmark(project, tmp_path / name)
        assert not (tmp_path / name).with_suffix(".json").exists()


def test_an_array_that_would_fill_the_memory_is_refused(
    project: Path, ours: Arrays, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pipeline.evaluation.predictions.LARGEST", 1000)
    with pytest.raises(SystemExit, match=r"ours\.npz: 'masks' is larger than a gibibyte"):
        measure(project, tmp_path, {"masks": ours["masks"]})


def test_where_shapes_are_not_known_poses_are_measured_alone(project: Path, ours: Arrays, tmp_path: Path) -> None:
    poses = {name: array for name, array in ours.items() if "angles" in name or name == "train_index"}
    figures = measure(project, tmp_path, poses, "cars")
    assert figures == {name: measure(project, tmp_path, poses)[name] for name in ("alignment", "pose")}
    for names in (["masks"], ["vertices", "faces"]):
        with pytest.raises(SystemExit, match=r"^error: true masks and meshes are not known here; leave out 'masks'"):
            measure(project, tmp_path, poses | {name: ours[name] for name in names}, "cars")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--out", "."], r"^error: \. cannot be written; name a file that ends in \.json$"),
        (["--out", "ours.npz"], r"^error: ours\.npz cannot be written; name a file that ends in \.json$"),
        (["--out", "file/ours.json"], r"^error: file/ours\.json cannot be written; look at \S*/file, or name"),
        (["--dataset", ""], r"^error: the dataset is ''; expected an entry of `datasets` in params\.yaml$"),
        (["--dataset", "boats"], r"boats does not exist; make it with `dvc repro prepare_data@boats`$"),
        (["--dataset", "boat"], r"params\.yaml: datasets has no 'boat'; did you mean 'boats'\?$"),
        (["--category", "cat"], r"toybox has no category 'cat'; did you mean 'car'\?$"),
    ],
)
def test_a_wrong_word_is_one_sentence(
    project: Path, words: list[str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").touch()
    with pytest.raises(SystemExit, match=message):
        benchmark(project, tmp_path / "ours.npz", *words)


def test_a_missing_file_is_one_sentence(project: Path, tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match=r"^error: \S*ours\.npz: No such file or directory"):
        benchmark(project, tmp_path / "ours.npz")


def test_the_examples_of_the_document_can_be_measured(
    project: Path, truth: Truth, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    complete, of_rotations, of_meshes = re.findall(r"```python\n(.*?)```", DOCUMENT, re.DOTALL)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "data").symlink_to(project / "data")
    names: dict[str, Any] = {"rotations": rotation(truth.pose).numpy()}
    exec(complete, names)
    assert math.isclose(
        benchmark(project, tmp_path / "predictions.npz")["shape"]["test"]["width_correlation"]["value"], 0
    )
    assert truth.objects is not None
    (tmp_path / "meshes").mkdir()
    for number, vertices in enumerate(truth.objects.vertices):
        trimesh.Trimesh(vertices, truth.objects.faces).export(tmp_path / f"meshes/{number:03}.obj")
    exec(of_rotations + of_meshes, names)
    np.testing.assert_allclose(names["predictions"]["test_angles"], angles(truth), atol=1e-6)
    figures = measure(project, tmp_path, names["predictions"])
    assert figures["shape"]["test"]["width_correlation"]["value"] == pytest.approx(1)
