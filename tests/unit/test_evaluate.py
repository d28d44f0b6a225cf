import math
from dataclasses import replace

import pytest
import torch

from pipeline.evaluation import shape_metrics
from pipeline.evaluation.alignment import turn_pose, turn_vertices
from pipeline.evaluation.artifacts import Truth
from pipeline.evaluation.evaluate import ChainResult, chain_result, evaluate_images, evaluate_truth
from pipeline.evaluation.shape import iou
from pipeline.evaluation.shape_metrics import silhouettes
from pipeline.geometry.camera import pose_to_tensor
from pipeline.geometry.icosphere import icosphere
from pipeline.geometry.voxels import voxelize
from pipeline.networks.feature_extractor import FeatureExtractor
from pipeline.networks.wide_resnet import WideResNet
from pipeline.seeding import generator, initialised
from tests.tiny_full_model import tiny_model
from tests.turned_ellipsoids import (
    CONFIG,
    COUNT,
    FRAME,
    RENDERER,
    TRAINING_COUNT,
    VISITED,
    shown_ellipsoids,
    training_ellipsoids,
    turned_answers,
)


@pytest.fixture(scope="module")
def truth() -> Truth:
    return shown_ellipsoids()


@pytest.fixture(scope="module")
def training() -> Truth:
    return training_ellipsoids()


@pytest.fixture(scope="module")
def extractor() -> FeatureExtractor:
    with initialised(0, "extractor"):
        return FeatureExtractor(WideResNet(10, 1, 2), 2.0)


@pytest.fixture(scope="module")
def learned(training: Truth, truth: Truth) -> ChainResult:
    return turned_answers(training, truth)


def test_right_answers_in_a_turned_frame_score_full_marks(learned: ChainResult, training: Truth, truth: Truth) -> None:
    figures, table = evaluate_truth(learned, training, truth, CONFIG)
    assert math.isclose(figures["alignment"]["degrees"], 90)
    assert figures["pose"]["train"]["acc_pi6"] == figures["pose"]["test_tuned"]["acc_pi6"] == 1
    assert math.isclose(figures["pose"]["test"]["acc_pi6"], 2 / 3)
    assert math.isclose(figures["pose"]["test"]["flipped"]["value"], 1 / 3)
    assert math.isclose(figures["pose"]["test"]["seen_side"]["value"], 2 / 3)
    assert figures["pose"]["test"]["front_or_side"]["value"] == 1
    assert figures["shape"]["test_tuned"]["voxel_iou"]["value"] > 0.99
    assert figures["shape"]["test_tuned"]["mask_iou"]["value"] == 1
    assert figures["shape"]["test_tuned"]["chamfer_l1"]["value"] < 0.03
    assert figures["shape"]["test_tuned"]["width_correlation"]["value"] > 0.999
    assert figures["shape"]["test_tuned"]["height_correlation"]["value"] > 0.999
    assert figures["shape"]["base"]["voxel_iou"]["value"] > 0.85
    assert figures["shape"]["final_base"]["voxel_iou"]["value"] < figures["shape"]["base"]["voxel_iou"]["value"]
    assert table["rotation_error_predicted"].sort().values[-4:].tolist() == pytest.approx([180] * 4, abs=1e-3)
    assert table["rotation_error_tuned"].max() < 1e-3


def test_shapes_of_many_faces_are_compared_in_parts(
    learned: ChainResult, training: Truth, truth: Truth, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = evaluate_truth(learned, training, truth, CONFIG)[1]
    monkeypatch.setattr(shape_metrics, "_FACES_AT_ONCE", 2 * len(learned.reconstructions.faces))
    together: list[int] = []
    sample = shape_metrics.sample_outer_surface
    monkeypatch.setattr(
        shape_metrics, "sample_outer_surface", lambda *shapes: together.append(len(shapes[0])) or sample(*shapes)
    )
    parts = evaluate_truth(learned, training, truth, CONFIG)[1]
    assert max(together[1:]) == 2  # the first ones are the true shapes
    assert torch.equal(parts["voxel_iou_tuned"], whole["voxel_iou_tuned"])
    torch.testing.assert_close(parts["chamfer_l1_tuned"], whole["chamfer_l1_tuned"], atol=0.005, rtol=0)


def test_the_training_split_alone_tells_the_turn(learned: ChainResult, training: Truth, truth: Truth) -> None:
    further = learned._replace(training_pose=turn_pose(learned.training_pose, math.radians(20)))
    figures = evaluate_truth(further, training, truth, CONFIG)[0]
    assert math.isclose(figures["alignment"]["degrees"], 70)
    assert figures["alignment"]["n"] == figures["pose"]["train"]["n"] == len(VISITED)
    assert figures["pose"]["train"]["median_error_degrees"]["value"] == pytest.approx(0, abs=1e-3)
    assert figures["pose"]["test_tuned"]["median_error_degrees"]["value"] == pytest.approx(20, abs=1e-3)


def test_constants_are_those_of_the_whole_training_split(learned: ChainResult, training: Truth, truth: Truth) -> None:
    figures = evaluate_truth(learned, training, truth, CONFIG)[0]
    assert training.objects is not None
    assert truth.objects is not None
    assert figures["pose"]["constant"]["acc_pi6"] == 0.25
    flat = voxelize(training.objects.vertices[:1], icosphere(2)[1], 16)
    true = voxelize(truth.objects.vertices, icosphere(2)[1], 16)
    constant, overlaps = figures["shape"]["constant"], iou(flat.expand_as(true), true)
    assert constant["voxel_iou"]["value"] == pytest.approx(overlaps.mean().item())
    mask = training.objects.masks[:1].expand_as(truth.objects.masks)
    assert constant["mask_iou"]["value"] == pytest.approx(iou(mask, truth.objects.masks).mean().item())
    base = overlaps[COUNT // 2].item()
    assert figures["shape"]["base"]["mean_shape_iou"] == pytest.approx(base, abs=0.01)


def test_what_a_run_visited_moves_no_baseline(learned: ChainResult, training: Truth, truth: Truth) -> None:
    thorough = learned._replace(
        training_index=torch.arange(TRAINING_COUNT), training_pose=turn_pose(training.pose, -FRAME)
    )
    some, whole = (evaluate_truth(result, training, truth, CONFIG)[0] for result in (learned, thorough))
    assert some["pose"]["train"]["n"] < whole["pose"]["train"]["n"]
    assert all(some["pose"][name] == whole["pose"][name] for name in ("chance", "constant"))
    assert all(some["shape"][name] == whole["shape"][name] for name in ("constant", "base", "final_base"))


def test_poses_of_the_photographs_that_were_visited_are_compared(learned: ChainResult, training: Truth) -> None:
    trained = {"train_visits": torch.zeros(TRAINING_COUNT).long(), "train_pose": pose_to_tensor(training.pose)}
    trained["train_visits"][VISITED] = 3
    mesh = {"vertices": learned.base, "faces": learned.base_faces}
    result = chain_result(learned.reconstructions, tiny_model(), trained, mesh)
    assert torch.equal(result.training_index, VISITED)
    assert torch.equal(result.training_pose.azimuth, training.pose.azimuth[VISITED])


def test_masks_are_as_large_as_the_objects(learned: ChainResult) -> None:
    found = learned.reconstructions
    coarse, fine = (
        silhouettes(found.tuned, found.faces, found.directions, replace(RENDERER, size=size)).float().mean().item()
        for size in (16, 256)
    )
    assert coarse == pytest.approx(fine, rel=0.04)


def test_a_final_base_has_the_faces_of_the_reconstructions(learned: ChainResult, training: Truth, truth: Truth) -> None:
    finer, faces = icosphere(3)
    base_of_other_faces = learned._replace(base=finer.float() / 2, base_faces=faces)
    shapes = evaluate_truth(base_of_other_faces, training, truth, CONFIG)[0]["shape"]
    assert shapes["final_base"] == evaluate_truth(learned, training, truth, CONFIG)[0]["shape"]["final_base"] | {
        "chamfer_l1": shapes["final_base"]["chamfer_l1"]
    }


def test_all_shapes_are_turned_as_the_poses_are(learned: ChainResult, training: Truth, truth: Truth) -> None:
    further = math.radians(20)  # the frame is 70 degrees off then: unlike 90, not alike to the left and to the right
    tuned, base = learned.reconstructions.tuned, turn_vertices(learned.base, further)
    found = learned.reconstructions._replace(tuned=tuned._replace(vertices=turn_vertices(tuned.vertices, further)))
    pose = turn_pose(learned.training_pose, further)
    result = learned._replace(reconstructions=found, training_pose=pose, base=base, final_base=base)
    shapes = evaluate_truth(result, training, truth, CONFIG)[0]["shape"]
    assert shapes["test_tuned"]["voxel_iou"]["value"] > 0.99
    assert shapes["base"]["voxel_iou"]["value"] > 0.85
    for name in ("voxel_iou", "mean_shape_iou"):
        assert shapes["final_base"][name] == shapes["base"][name]


def test_single_stage_training_has_no_base_shape(learned: ChainResult, training: Truth, truth: Truth) -> None:
    shapes = evaluate_truth(learned._replace(final_base=None), training, truth, CONFIG)[0]["shape"]
    assert {"base", "final_base"}.isdisjoint(shapes)
    assert "test" in shapes


def test_viewpoints_alone_are_measured_alike(learned: ChainResult, training: Truth, truth: Truth) -> None:
    figures, table = evaluate_truth(learned, training, truth, CONFIG)
    known, asked = (split._replace(objects=None) for split in (training, truth))
    figures_of_viewpoints, table_of_viewpoints = evaluate_truth(learned, known, asked, CONFIG)
    assert figures_of_viewpoints == {name: figures[name] for name in ("alignment", "pose")}
    assert "rotation_error_predicted" in table_of_viewpoints
    assert "voxel_iou_predicted" in table.keys() - table_of_viewpoints.keys()


def test_every_figure_has_n_and_standard_error(learned: ChainResult, training: Truth, truth: Truth) -> None:
    figures, table = evaluate_truth(learned, training, truth, CONFIG)
    visited = figures["pose"].pop("train")
    for rows in (figures["pose"].values(), figures["shape"]["test"].values(), [figures["shape"]["base"]["voxel_iou"]]):
        assert {row["n"] for row in rows} == {COUNT}
    for row in (figures["pose"][name] for name in ("test", "test_tuned", "constant")):
        assert row["standard_error"] == pytest.approx((row["acc_pi6"] * (1 - row["acc_pi6"]) / (COUNT - 1)) ** 0.5)
    overlap = figures["shape"]["test"]["voxel_iou"]
    assert overlap["standard_error"] == pytest.approx((table["voxel_iou_predicted"].std() / COUNT**0.5).item())
    assert visited["n"] == len(VISITED)
    assert all(len(column) == COUNT for column in table.values())


def test_same_seed_gives_the_same_figures(learned: ChainResult, training: Truth, truth: Truth) -> None:
    assert evaluate_truth(learned, training, truth, CONFIG)[0] == evaluate_truth(learned, training, truth, CONFIG)[0]


def test_reconstruction_nearer_to_the_photograph_counts_as_improved(
    learned: ChainResult, extractor: FeatureExtractor
) -> None:
    photographs = learned.reconstructions.tuned.images
    training = torch.randint(256, (3, *photographs.shape[1:]), generator=generator(0)).to(torch.uint8)
    figures, table = evaluate_images(photographs, training, learned.reconstructions, extractor, CONFIG)
    assert figures["reconstruction"]["retrieved"]["feature_distance"]["value"] > 0
    assert figures["reconstruction"]["improved"]["value"] == 1
    assert figures["vertex_deviation"]["predicted"]["n"] == COUNT
    assert figures["reconstruction"]["tuned"]["feature_distance"]["value"] == 0
    torch.testing.assert_close(table["psnr_predicted"], torch.full((COUNT,), -20 * math.log10(0.25)))
    torch.testing.assert_close(table["psnr_tuned"], torch.full((COUNT,), 100.0))


def test_shapes_may_differ_at_one_stage_alone(learned: ChainResult, extractor: FeatureExtractor) -> None:
    predicted = learned.reconstructions.predicted
    alike = predicted._replace(vertices=predicted.vertices[:1].expand(COUNT, -1, -1))
    found, photographs = learned.reconstructions._replace(predicted=alike), predicted.images
    training = torch.zeros(1, *photographs.shape[1:], dtype=torch.uint8)
    spread = evaluate_images(photographs, training, found, extractor, CONFIG)[0]["vertex_deviation"]
    assert spread["predicted"]["value"] == pytest.approx(0, abs=1e-6)
    assert spread["tuned"]["value"] > 0.005


def test_shapes_are_measured_at_their_own_stage(training: Truth, truth: Truth) -> None:
    learned = turned_answers(training, truth)
    predicted = learned.reconstructions.predicted
    flat = predicted._replace(vertices=predicted.vertices * torch.tensor([1.0, 0.3, 1.0]))
    found = learned._replace(reconstructions=learned.reconstructions._replace(predicted=flat))
    shapes = evaluate_truth(found, training, truth, CONFIG)[0]["shape"]
    assert shapes["test_tuned"]["voxel_iou"]["value"] > 0.99
    assert shapes["test"]["voxel_iou"]["value"] < 0.6


def test_heights_alone_may_be_wrong(learned: ChainResult, training: Truth, truth: Truth) -> None:
    tuned = learned.reconstructions.tuned
    heights = torch.ones(COUNT, 1, 3)
    heights[:, 0, 1] = torch.linspace(1.3, 0.7, COUNT)
    found = learned.reconstructions._replace(tuned=tuned._replace(vertices=tuned.vertices * heights))
    shapes = evaluate_truth(learned._replace(reconstructions=found), training, truth, CONFIG)[0]["shape"]
    assert shapes["test_tuned"]["width_correlation"]["value"] > 0.999
    assert shapes["test_tuned"]["height_correlation"]["value"] < 0.9


def test_the_size_of_a_shape_does_not_count(training: Truth, truth: Truth) -> None:
    learned = turned_answers(training, truth)
    tuned = learned.reconstructions.tuned
    half = learned.reconstructions._replace(tuned=tuned._replace(vertices=tuned.vertices / 2))
    shapes = evaluate_truth(learned._replace(reconstructions=half), training, truth, CONFIG)[0]["shape"]
    assert shapes["test_tuned"]["voxel_iou"]["value"] > 0.99
