"""What the report reads of a tiny run: ellipsoids in two colours, with and without ground truth."""

import torch

from pipeline.evaluation.artifacts import Reconstructions, Snapshot
from pipeline.export.report import ReportConfig, ReportInputs
from pipeline.export.views import ViewConfig
from pipeline.geometry.camera import CameraConfig, level_pose
from pipeline.geometry.icosphere import icosphere

CAMERA = CameraConfig(distance=2.7, field_of_view=30.0)
VIEW = ViewConfig(size=24, supersampling=2, elevation=0.0)
CONFIG = ReportConfig(seed=0, examples=2, stepped=1, other_view=90.0, view=VIEW)
COUNT = 4
ORANGE, BLUE = torch.tensor([1.0, 0.5, 0.0]), torch.tensor([0.0, 0.2, 0.8])
DIMENSIONS = torch.tensor([0.5, 0.4, 1.0])


def figure(value: float) -> dict[str, float]:
    return {"value": value, "n": COUNT, "standard_error": 0.1}


def picture_figures(distance: float, psnr: float, ssim: float) -> dict[str, dict[str, float]]:
    return {"feature_distance": figure(distance), "psnr": figure(psnr), "ssim": figure(ssim)}


def pose_figures(accuracy: float, median: float) -> dict:
    return {"acc_pi6": accuracy, "n": COUNT, "standard_error": 0.2, "median_error_degrees": figure(median)}


def inputs(truth: bool) -> ReportInputs:
    """Four photographs whose objects are ellipsoids, orange in front and blue behind.

    Every figure differs before and after fine-tuning; the last object is then seen from 30 degrees, others from ahead.
    """
    sphere, faces = icosphere(2)
    directions = sphere.float()
    zeros = torch.zeros(COUNT)
    ahead = level_pose(zeros, zeros)
    turned = ahead._replace(azimuth=torch.tensor([0.0, 0, 0, 30]).deg2rad())
    base = directions * DIMENSIONS / 2
    vertices = base.expand(COUNT, -1, -1)
    predicted = Snapshot(ahead, vertices, *[torch.full((COUNT, 3, 16, 16), 0.25)] * 2)
    tuned = Snapshot(turned, vertices, *[torch.full((COUNT, 3, 16, 16), 0.5)] * 2)
    figures: dict = {
        "reconstruction": {
            "predicted": picture_figures(0.5, 20, 0.5),
            "tuned": picture_figures(0.4, 22, 0.6),
            "retrieved": picture_figures(0.7, 15, 0.3),
            "improved": figure(0.75),
        }
    }
    table = {
        "test_index": ["7", "8", "9", "10"],
        "feature_distance_predicted": ["8", "6", "7", "5"],
        "feature_distance_tuned": ["4", "1", "3", "2"],
    }
    if truth:
        figures["alignment"] = {"degrees": 90.0, "n": 10}
        figures["pose"] = {
            "test": pose_figures(0.5, 20) | {"flipped": figure(0.25)},
            "test_tuned": pose_figures(0.75, 10) | {"flipped": figure(0.2)},
            "chance": pose_figures(0.15, 90),
            "constant": pose_figures(0.3, 60),
        }
        figures["shape"] = {
            "test": {"voxel_iou": figure(0.6), "mask_iou": figure(0.7)},
            "test_tuned": {"voxel_iou": figure(0.65), "mask_iou": figure(0.75)},
            "base": {"voxel_iou": figure(0.5)},
            "final_base": {"voxel_iou": figure(0.55)},
            "constant": {"voxel_iou": figure(0.4), "mask_iou": figure(0.45)},
        }
        table |= {"truth_azimuth": ["0", "90", "-180", "-90"], "azimuth_predicted": ["0", "-90", "170", "0"]}
        table |= {"rotation_error_predicted": ["0", "180", "10", "90"], "rotation_error_tuned": ["0", "5", "10", "15"]}
        table["error_mode_predicted"] = ["correct", "flipped", "correct", "other"]
        table["error_mode_tuned"] = ["correct", "front_back", "correct", "correct"]
    photographs = torch.tensor([1.0, 0, 1])[:, None, None].expand(COUNT, 3, 16, 16)
    front = ((torch.arange(16) + 0.5) / 16 - 0.5).abs() < 0.25
    textures = torch.where(front[:, None], ORANGE, BLUE).T[:, None].expand(COUNT, 3, 16, 16)
    curve = {"iteration": ["0", "1"], "seed": ["0", "0"], "loss": ["2", "1"]}
    return ReportInputs(
        run="toy<car>",
        photographs=photographs,
        drawn=False,
        reconstructions=Reconstructions(predicted, tuned, textures, faces, directions, torch.arange(7, 11)),
        seeds=torch.stack([directions / 2, base]),
        seed_faces=faces,
        seed_scores=torch.tensor([0.5, 0.25]),
        chosen_seed=0,
        base=base,
        camera=CAMERA,
        framing="free",
        figures=figures,
        stage_figures={"remesh": {"area_variation": 0.1}},
        curves={"features": {"iteration": []}, "base_shape": curve},
        table=table,
    )
