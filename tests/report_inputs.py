"""What the report reads of a tiny run: ellipsoids in two colours, with and without ground truth."""

import torch

from pipeline.evaluation.artifacts import Reconstructions, Snapshot
from pipeline.export.report import ReportConfig, ReportInputs
from pipeline.export.views import ViewConfig
from pipeline.geometry.camera import CameraConfig, Pose
from pipeline.geometry.icosphere import icosphere

CAMERA = CameraConfig(distance=2.7, field_of_view=30.0)
VIEW = ViewConfig(size=24, supersampling=2, elevation=0.0)
CONFIG = ReportConfig(seed=0, examples=2, stepped=1, frames=4, other_view=90.0, view=VIEW)
COUNT = 4
ORANGE, BLUE = torch.tensor([1.0, 0.5, 0.0]), torch.tensor([0.0, 0.2, 0.8])
DIMENSIONS = torch.tensor([0.5, 0.4, 1.0])


def figure(value: float) -> dict[str, float]:
    return {"value": value, "n": COUNT, "standard_error": 0.1}


def inputs(truth: bool) -> ReportInputs:
    """Four photographs whose objects are ellipsoids, orange in front and blue behind."""
    sphere, faces = icosphere(2)
    directions = sphere.float()
    zeros = torch.zeros(COUNT)
    pose = Pose(zeros, zeros, zeros, torch.zeros(COUNT, 2), zeros + 1)
    base = directions * DIMENSIONS / 2
    vertices = base.expand(COUNT, -1, -1)
    found = Snapshot(pose, vertices, *[torch.full((COUNT, 3, 16, 16), 0.5)] * 2)
    columns = {"feature_distance": figure(0.5), "psnr": figure(20), "ssim": figure(0.5)}
    figures: dict = {
        "reconstruction": dict.fromkeys(("predicted", "tuned", "retrieved"), columns) | {"improved": figure(0.75)}
    }
    table = {f"feature_distance_{stage}": ["4", "1", "3", "2"] for stage in ("predicted", "tuned")}
    table["test_index"] = ["7", "8", "9", "10"]
    if truth:
        row = {"acc_pi6": 0.5, "n": COUNT, "standard_error": 0.2, "median_error_degrees": figure(20)}
        figures["alignment"] = {"degrees": 90.0, "n": 10}
        figures["pose"] = {"test": row | {"flipped": figure(0.25)}, "chance": row, "constant": row}
        ious = {"voxel_iou": figure(0.6), "mask_iou": figure(0.7)}
        base_shapes = {name: {"voxel_iou": figure(0.6)} for name in ("base", "final_base")}
        figures["shape"] = {"test": ious, **base_shapes, "constant": ious}
        table |= {"truth_azimuth": ["0", "90", "180", "270"], "azimuth_predicted": ["0", "-90", "170", "0"]}
        table |= {f"rotation_error_{stage}": ["0", "180", "10", "90"] for stage in ("predicted", "tuned")}
        table["error_mode_predicted"] = ["correct", "flipped", "correct", "other"]
    photographs = torch.tensor([1.0, 0, 1])[:, None, None].expand(COUNT, 3, 16, 16)
    front = ((torch.arange(16) + 0.5) / 16 - 0.5).abs() < 0.25
    textures = torch.where(front[:, None], ORANGE, BLUE).T[:, None].expand(COUNT, 3, 16, 16)
    curve = {"iteration": ["0", "1"], "seed": ["0", "0"], "loss": ["2", "1"]}
    return ReportInputs(
        run="toy<car>",
        photographs=photographs,
        drawn=False,
        reconstructions=Reconstructions(found, found, textures, faces, directions, torch.arange(7, 11)),
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
