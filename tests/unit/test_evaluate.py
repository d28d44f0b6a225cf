import math

import pytest
import torch

from pipeline.evaluation.alignment import turn_pose, turn_vertices
from pipeline.evaluation.artifacts import Reconstructions, Snapshot, TrueObjects, Truth
from pipeline.evaluation.evaluate import ChainResult, EvaluateConfig, evaluate_images, evaluate_truth
from pipeline.evaluation.multiview import MultiviewConfig
from pipeline.evaluation.shape_metrics import ShapeMetricsConfig, silhouettes
from pipeline.geometry.camera import CameraConfig, Pose
from pipeline.geometry.icosphere import icosphere
from pipeline.networks.feature_extractor import FeatureExtractor
from pipeline.networks.wide_resnet import WideResNet
from pipeline.rendering.renderer import RendererConfig
from pipeline.seeding import generator, initialised

COUNT = 12
RENDERER = RendererConfig(camera=CameraConfig(distance=2.7, field_of_view=30.0), size=16, supersampling=2)
CONFIG = EvaluateConfig(
    seed=0,
    shape=ShapeMetricsConfig(voxel_resolution=16, surface_points=400),
    chance_draws=36,
    batch_size=5,
    multiview=MultiviewConfig(objects=COUNT, step=50, elevation=10.0, ridge=0.1, examples=2),
)
FRAME = math.radians(90)


def random_pose(count: int, seed: int) -> Pose:
    unit = torch.rand(2, count, generator=torch.Generator().manual_seed(seed))
    zeros = torch.zeros(count)
    return Pose(unit[0] * 2 * math.pi, unit[1] * 0.5, zeros, torch.zeros(count, 2), zeros + 0.8)


def ellipsoids(count: int) -> torch.Tensor:
    wider = torch.linspace(-0.05, 0.05, count)
    higher = 20 * wider.square() - 0.02
    sizes = torch.tensor([0.5, 0.4, 1.0]) + torch.stack([wider, higher, torch.zeros(count)], 1)
    return icosphere(2)[0].float() / 2 * sizes[:, None]


def reconstruction(pose: Pose, vertices: torch.Tensor, shade: float) -> Snapshot:
    images = torch.full((COUNT, 3, 16, 16), shade)
    return Snapshot(pose, vertices, torch.zeros_like(images), images)


@pytest.fixture(scope="module")
def truth() -> Truth:
    vertices, (directions, faces) = ellipsoids(COUNT), icosphere(2)
    pose = random_pose(COUNT, 0)
    masks = silhouettes(reconstruction(pose, vertices, 0), faces, directions.float(), RENDERER)
    return Truth(pose, TrueObjects(masks, vertices, faces))


@pytest.fixture(scope="module")
def learned(truth: Truth) -> ChainResult:
    """Give the right answers in a frame turned by 90 degrees; before fine-tuning a third of the poses are flipped."""
    directions, faces = icosphere(2)
    assert truth.objects is not None
    pose, vertices = turn_pose(truth.pose, -FRAME), turn_vertices(truth.objects.vertices, -FRAME)
    wrong = pose._replace(azimuth=pose.azimuth + math.pi * (torch.arange(COUNT) % 3 == 0))
    reconstructions = Reconstructions(
        reconstruction(wrong, vertices, 0.5),
        reconstruction(pose, vertices, 0.25),
        torch.zeros(COUNT, 3, 4, 4),
        faces,
        directions.float(),
        torch.arange(COUNT),
    )
    base = vertices[COUNT // 2]
    return ChainResult(reconstructions, pose, base, vertices[0], faces, RENDERER)


def test_right_answers_in_a_turned_frame_score_full_marks(learned: ChainResult, truth: Truth) -> None:
    figures, table = evaluate_truth(learned, truth, truth, CONFIG)
    assert math.isclose(figures["alignment"]["degrees"], 90)
    assert figures["pose"]["train"]["acc_pi6"] == figures["pose"]["test_tuned"]["acc_pi6"] == 1
    assert math.isclose(figures["pose"]["test"]["acc_pi6"], 2 / 3)
    assert math.isclose(figures["pose"]["test"]["flipped"]["value"], 1 / 3)
    assert figures["shape"]["test_tuned"]["voxel_iou"]["value"] > 0.99
    assert figures["shape"]["test_tuned"]["mask_iou"]["value"] == 1
    assert figures["shape"]["test_tuned"]["chamfer_l1"]["value"] < 0.03
    assert figures["shape"]["test_tuned"]["width_correlation"]["value"] > 0.999
    assert figures["shape"]["test_tuned"]["height_correlation"]["value"] > 0.999
    assert figures["shape"]["base"]["voxel_iou"]["value"] > 0.85
    assert figures["shape"]["final_base"]["voxel_iou"]["value"] < figures["shape"]["base"]["voxel_iou"]["value"]
    assert table["rotation_error_predicted"].sort().values[-4:].tolist() == pytest.approx([180] * 4, abs=1e-3)


def test_a_final_base_has_the_faces_of_the_reconstructions(learned: ChainResult, truth: Truth) -> None:
    finer, faces = icosphere(3)
    base_of_other_faces = learned._replace(base=finer.float() / 2, base_faces=faces)
    shapes = evaluate_truth(base_of_other_faces, truth, truth, CONFIG)[0]["shape"]
    assert shapes["final_base"] == evaluate_truth(learned, truth, truth, CONFIG)[0]["shape"]["final_base"] | {
        "chamfer_l1": shapes["final_base"]["chamfer_l1"]
    }


def test_single_stage_training_has_no_final_base(learned: ChainResult, truth: Truth) -> None:
    shapes = evaluate_truth(learned._replace(final_base=None), truth, truth, CONFIG)[0]["shape"]
    assert "base" in shapes
    assert "final_base" not in shapes


def test_viewpoints_alone_are_measured_alike(learned: ChainResult, truth: Truth) -> None:
    figures, table = evaluate_truth(learned, truth, truth, CONFIG)
    viewpoints = truth._replace(objects=None)
    figures_of_viewpoints, table_of_viewpoints = evaluate_truth(learned, viewpoints, viewpoints, CONFIG)
    assert figures_of_viewpoints == {name: figures[name] for name in ("alignment", "pose")}
    assert "rotation_error_predicted" in table_of_viewpoints
    assert "voxel_iou_predicted" in table.keys() - table_of_viewpoints.keys()


def test_every_figure_has_n_and_standard_error(learned: ChainResult, truth: Truth) -> None:
    figures, table = evaluate_truth(learned, truth, truth, CONFIG)
    for rows in (figures["pose"].values(), figures["shape"]["test"].values(), [figures["shape"]["base"]["voxel_iou"]]):
        assert all(row["n"] == COUNT and row["standard_error"] >= 0 for row in rows)
    assert all(len(column) == COUNT for column in table.values())


def test_same_seed_gives_the_same_figures(learned: ChainResult, truth: Truth) -> None:
    assert evaluate_truth(learned, truth, truth, CONFIG)[0] == evaluate_truth(learned, truth, truth, CONFIG)[0]


def test_reconstruction_nearer_to_the_photograph_counts_as_improved(learned: ChainResult) -> None:
    with initialised(0, "extractor"):
        extractor = FeatureExtractor(WideResNet(10, 1, 2), 2.0)
    photographs = learned.reconstructions.tuned.images
    training = torch.randint(256, (3, *photographs.shape[1:]), generator=generator(0)).to(torch.uint8)
    figures, table = evaluate_images(photographs, training, learned.reconstructions, extractor, CONFIG)
    assert figures["reconstruction"]["retrieved"]["feature_distance"]["value"] > 0
    assert figures["reconstruction"]["improved"]["value"] == 1
    assert figures["vertex_deviation"]["predicted"]["n"] == COUNT
    assert figures["reconstruction"]["tuned"]["feature_distance"]["value"] == 0
    torch.testing.assert_close(table["psnr_predicted"], torch.full((COUNT,), -20 * math.log10(0.25)))
