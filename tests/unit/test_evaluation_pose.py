import math

import pytest
import torch

from pipeline.evaluation.alignment import chance_errors, fit_alignment, fit_constant, turn_pose, turn_vertices
from pipeline.evaluation.pose import (
    ACCURATE,
    MODES,
    error_mode,
    geodesic_distance,
    pairwise_distance,
    pose_error,
    rotation,
    seen_side,
)
from pipeline.evaluation.pose_metrics import angle_columns, baseline_figures, pose_columns, pose_figures
from pipeline.geometry.camera import CameraConfig, Pose, project


def degrees(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64).deg2rad()


def pose(azimuth: torch.Tensor, elevation: float = 0.0, roll: float = 0.0) -> Pose:
    count = len(azimuth)
    return Pose(
        azimuth,
        torch.full_like(azimuth, math.radians(elevation)),
        torch.full_like(azimuth, math.radians(roll)),
        torch.zeros(count, 2, dtype=torch.float64),
        torch.ones_like(azimuth),
    )


def random_pose(count: int, seed: int) -> Pose:
    rng = torch.Generator().manual_seed(seed)
    unit = torch.rand(3, count, generator=rng, dtype=torch.float64)
    azimuth, elevation, roll = unit[0] * 2 * math.pi, unit[1] * 0.5, (unit[2] - 0.5) * 0.2
    return pose(azimuth)._replace(elevation=elevation, roll=roll)


def test_geodesic_distance_is_the_angle_of_a_turn_about_any_axis() -> None:
    angles = degrees(0, 1e-4, 30, 90, 179.999, 180)
    axis = torch.tensor([2.0, -1, 0.5], dtype=torch.float64)
    x, y, z = axis / axis.norm()
    skew = torch.stack([torch.stack([0 * x, -z, y]), torch.stack([z, 0 * x, -x]), torch.stack([-y, x, 0 * x])])
    turns = torch.linalg.matrix_exp(angles[:, None, None] * skew)
    base = rotation(random_pose(len(angles), 0))
    torch.testing.assert_close(geodesic_distance(turns @ base, base), angles, atol=1e-7, rtol=0)


def test_geodesic_distance_equals_the_norm_of_the_logarithm() -> None:
    first, second = rotation(random_pose(5, 1)), rotation(random_pose(5, 2))
    eigenvalues = torch.linalg.eigvals(first @ second.transpose(1, 2))
    norm = eigenvalues.log().abs().square().sum(1).sqrt()
    torch.testing.assert_close(geodesic_distance(first, second), norm / math.sqrt(2))


def test_pairwise_distances_agree_with_single_ones() -> None:
    first, second = rotation(random_pose(4, 1)), rotation(random_pose(6, 2))
    expected = geodesic_distance(first[:, None].expand(4, 6, 3, 3), second.expand(4, 6, 3, 3))
    torch.testing.assert_close(pairwise_distance(first, second), expected)
    torch.testing.assert_close(pairwise_distance(first, first).diagonal(), torch.zeros(4).double(), atol=1e-7, rtol=0)


def test_pose_error_of_known_turns() -> None:
    truth = pose(degrees(10, 10, 350, 0))
    estimate = pose(degrees(10, 50, 10, 180))
    torch.testing.assert_close(pose_error(truth, estimate), degrees(0, 40, 20, 180))
    torch.testing.assert_close(pose_error(pose(degrees(70)), pose(degrees(70), roll=25)), degrees(25))
    torch.testing.assert_close(pose_error(pose(degrees(70)), pose(degrees(70), elevation=-12)), degrees(12))


def test_error_modes() -> None:
    truth = pose(degrees(50, 50, 50, 50, 50))
    estimate = pose(degrees(60, 225, -50, 135, 0))
    assert [MODES[mode] for mode in error_mode(truth, estimate)] == [
        "correct",
        "flipped",
        "mirrored",
        "front_back",
        "other",
    ]


def test_mirrored_estimate_has_opposite_roll() -> None:
    truth, estimate = pose(degrees(90), elevation=10, roll=20), pose(degrees(-90), elevation=10, roll=-20)
    assert MODES[error_mode(truth, estimate)[0]] == "mirrored"
    level, rolled = pose(degrees(50), roll=20), pose(degrees(-50), roll=20)
    assert MODES[error_mode(level, rolled)[0]] == "other"


def test_seen_side() -> None:
    assert seen_side(degrees(0, 44, 46, 90, 170, -100, 350)).tolist() == [0, 0, 1, 1, 2, 3, 0]


def test_alignment_recovers_the_turn_of_the_learned_frame() -> None:
    truth = random_pose(200, 3)
    estimate = turn_pose(truth, math.radians(-137))
    estimate = estimate._replace(azimuth=torch.where(torch.arange(200) % 3 == 0, -estimate.azimuth, estimate.azimuth))
    assert math.degrees(fit_alignment(truth, estimate)) % 360 == 137


def test_alignment_is_not_drawn_away_from_a_clear_peak_by_a_second_one() -> None:
    truth = random_pose(200, 3)
    wrong = torch.where(torch.arange(200) % 5 < 2, math.radians(60), 0)
    estimate = turn_pose(truth._replace(azimuth=truth.azimuth + wrong), math.radians(-137))
    assert math.degrees(fit_alignment(truth, estimate)) == pytest.approx(137)


def test_turned_vertices_seen_from_turned_pose_look_the_same() -> None:
    vertices = torch.rand(4, 10, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) - 0.5
    learned, camera = random_pose(4, 4), CameraConfig(distance=3.0, field_of_view=30.0)
    seen = project(turn_vertices(vertices, 1.1), turn_pose(learned, 1.1), camera)
    torch.testing.assert_close(seen, project(vertices, learned, camera))


def test_constant_is_the_most_frequent_view() -> None:
    azimuth = torch.cat([degrees(*([90.0] * 60)), degrees(*range(0, 360, 10))])
    truth = pose(azimuth, elevation=20, roll=5)
    errors = geodesic_distance(fit_constant(truth).expand(len(azimuth), 3, 3), rotation(truth))
    assert (errors[:60] <= ACCURATE).all()
    assert (errors <= ACCURATE).sum() >= 60 + 5


def test_the_constant_is_rolled_as_most_views_are() -> None:
    truth = pose(degrees(*[90.0] * 9), elevation=20, roll=40)
    truth.roll[:2] = math.radians(-80)
    errors = geodesic_distance(fit_constant(truth).expand(9, 3, 3), rotation(truth))
    assert errors[2:].max() < math.radians(0.01)


def test_chance_is_a_sixth_of_the_circle_when_only_azimuth_is_free() -> None:
    truth = pose(random_pose(250, 5).azimuth, elevation=0)
    errors = chance_errors(truth, truth, 360, torch.Generator().manual_seed(0))
    torch.testing.assert_close(
        (errors <= ACCURATE).double().mean(0), torch.full((250,), 1 / 6).double(), atol=1 / 360, rtol=0
    )


@pytest.mark.parametrize(("elevation", "roll"), [(40, 0), (0, 40)])
def test_chance_knows_no_elevation_and_no_roll_but_those_of_training(elevation: float, roll: float) -> None:
    truth, training = pose(degrees(*range(0, 360, 10)), elevation, roll), pose(degrees(0))
    errors = chance_errors(truth, training, 72, torch.Generator().manual_seed(0))
    assert errors.min() > math.radians(39.9)


def test_figures_of_ten_estimates() -> None:
    truth = pose(degrees(*range(0, 100, 10)))
    estimate = truth._replace(azimuth=truth.azimuth + degrees(0, 0, 0, 0, 0, 0, 10, 20, 180, 180))
    figures = pose_figures(truth, estimate, torch.Generator().manual_seed(0))
    assert figures["n"] == 10
    assert figures["acc_pi6"] == 0.8
    assert math.isclose(figures["standard_error"], math.sqrt(0.8 * 0.2 / 9))
    assert figures["flipped"]["value"] == 0.2
    assert abs(figures["median_error_degrees"]["value"]) < 1e-6


def test_columns_are_in_degrees_around_zero() -> None:
    columns = pose_columns(pose(degrees(350)), pose(degrees(340), elevation=5))
    torch.testing.assert_close(columns["azimuth"], torch.tensor([-20.0], dtype=torch.float64))
    torch.testing.assert_close(columns["elevation"], torch.tensor([5.0], dtype=torch.float64))
    assert angle_columns(pose(degrees(340)))["azimuth"].item() == pytest.approx(-20)


def test_constant_row_is_right_where_training_has_its_one_view() -> None:
    truth, training = pose(degrees(*[10] * 3, *[100] * 9)), pose(degrees(*[0] * 20))
    rows = baseline_figures(truth, training, 72, torch.Generator().manual_seed(0))
    assert rows["constant"]["acc_pi6"] == 0.25


def test_the_median_of_chance_is_that_of_all_guesses() -> None:
    """Where pictures are missed by different angles, half of all guesses are not half of each picture's."""
    truth = pose(degrees(*[0] * 30), elevation=0)._replace(elevation=degrees(*[0] * 20, *[89] * 10))
    rng = torch.Generator().manual_seed(0)
    row = baseline_figures(truth, truth, 400, rng)["chance"]["median_error_degrees"]
    pooled = torch.rad2deg(chance_errors(truth, truth, 400, torch.Generator().manual_seed(0)))
    assert row["value"] == pytest.approx(pooled.median().item())
    assert abs(row["value"] - pooled.quantile(0.5, dim=0).median().item()) > 1


def test_the_median_of_chance_is_as_certain_as_the_pictures_are_alike() -> None:
    def row(truth: Pose) -> dict[str, float]:
        return baseline_figures(truth, truth, 100, torch.Generator().manual_seed(0))["chance"]["median_error_degrees"]

    alike = pose(degrees(0, 90, 180, 270))
    unlike = alike._replace(elevation=degrees(-80, -30, 0, 60))
    assert row(alike)["n"] == 4
    assert row(alike)["standard_error"] < 1
    assert row(unlike)["standard_error"] > 6


def test_constant_row_beats_chance_where_views_are_biased() -> None:
    truth, training = (pose(random_pose(300, seed).azimuth * 0.2) for seed in (6, 7))
    rows = baseline_figures(truth, training, 72, torch.Generator().manual_seed(0))
    assert rows["constant"]["acc_pi6"] > 0.75 > 0.25 > rows["chance"]["acc_pi6"]
    assert rows["chance"]["n"] == rows["constant"]["n"] == 300
