"""The report's sections of numbers: headline, poses, curves, tables."""

from collections.abc import Mapping
from html import escape
from statistics import mean
from typing import Any

from pipeline.evaluation.tables import figure_rows
from pipeline.export.charts import Axis, Point, histogram, line_chart, scatter
from pipeline.export.report_page import Section, Tile, error_of, figure_cell, folded, grid, table

BASELINES = ("chance", "constant")
ROW_NAMES = {
    "test": "test",
    "test_tuned": "test, fine-tuned",
    "train": "train, recorded best",
    "base": "base shape",
    "final_base": "base shape after full training",
}
POSE_COLUMNS = {
    "flipped": "flipped",
    "mirrored": "mirrored",
    "front_back": "front for back",
    "other": "other",
    "seen_side": "seen side",
    "front_or_side": "front or side",
}
LINE_POINTS = 120
RETRIEVED = "training photograph of the same colours"
SHAPES = (
    "IoU is the part that two shapes, or two masks, share of what they cover together: 1 where they are the same. "
    "Chamfer-L1 is the mean distance between two surfaces, in a cube of side 1: lower is better. Shapes are compared "
    "after each is scaled into that cube; the correlations say whether objects that are wide or high for their length "
    "are reconstructed so. The constant is the one shape, or mask, that suits the training split best."
)
ANGLE_TICKS = (-180, -90, 0, 90, 180)


def headline(figures: Mapping[str, Any]) -> list[Tile]:
    """Choose the figures a reader looks for first, each with what to compare it to."""
    pictures = figures["reconstruction"]
    before, after = (pictures[stage]["feature_distance"]["value"] for stage in ("predicted", "tuned"))
    improved, similarity = pictures["improved"], pictures["tuned"]["ssim"]
    tiles = [
        Tile(
            f"{improved['value']:.1%}",
            "",
            "of pictures improved by fine-tuning",
            f"feature distance {before:.1f} → {after:.1f} · n = {improved['n']}",
        ),
        _tile(
            similarity,
            "structural similarity, fine-tuned",
            f"{pictures['predicted']['ssim']['value']:.3f} before fine-tuning",
        ),
    ]
    if "pose" not in figures:
        return tiles
    pose = figures["pose"]
    accuracy = {"value": pose["test"]["acc_pi6"], "standard_error": pose["test"]["standard_error"]}
    chance, constant = (f"{name} {pose[name]['acc_pi6']:.3f}" for name in BASELINES)
    tuned = f"{pose['test_tuned']['acc_pi6']:.3f} fine-tuned"
    note = f"{tuned} · {chance} · {constant} · n = {pose['test']['n']}"
    tiles.insert(0, _tile(accuracy, "of predicted poses within 30°", note))
    if "shape" not in figures:
        return tiles
    shape = figures["shape"]
    constant_shape, constant_mask = (shape["constant"][name]["value"] for name in ("voxel_iou", "mask_iou"))
    tuned = f"{shape['test_tuned']['mask_iou']['value']:.3f} fine-tuned"
    tiles.insert(1, _tile(shape["test"]["mask_iou"], "mask IoU, predicted", f"{tuned} · constant {constant_mask:.3f}"))
    if "final_base" in shape:  # which single-stage training does not have
        volume = shape["final_base"]["voxel_iou"]
        name = "volume IoU of the base shape after full training"
        tiles.insert(1, _tile(volume, name, f"constant {constant_shape:.3f}"))
    return tiles


def pose_section(figures: Mapping[str, Any], rows: Mapping[str, list[str]]) -> list[Section]:
    """Show poses and shapes against the truth; nothing where there is none."""
    if "pose" not in figures:
        return []
    errors = {
        name: [float(value) for value in rows[f"rotation_error_{stage}"]]
        for name, stage in (("predicted", "predicted"), ("fine-tuned", "tuned"))
    }
    angle = Axis(0, 180, range(0, 181, 30), "rotation error in degrees")
    charts = [histogram(errors, range(0, 181, 10), angle), azimuth_chart(rows)]
    introduction = (
        "A pose counts as right within 30 degrees of rotation. The learned frame is turned about the vertical axis by "
        f"{figures['alignment']['degrees']:.0f} degrees to fit the true poses of the training split. Chance guesses "
        "the azimuth; the constant is the one pose that suits the training split best. Wrong poses are flipped where a "
        "half turn mends them, mirrored where they fit the mirrored picture, front for back where they fit with "
        "these two exchanged. The seen side is which of front, left, rear and right faces the camera; front or side "
        "asks only whether that is an end or a flank."
    )
    body = grid("charts", charts) + pose_table(figures["pose"])
    if "shape" in figures:
        body += f"<h3>Shapes</h3><p>{SHAPES}</p>{shape_table(figures['shape'])}"
    return [Section("poses", "Poses and shapes", introduction, body)]


def azimuth_chart(rows: Mapping[str, list[str]]) -> str:
    """Plot estimated over true azimuth: right ones lie on the diagonal, each kind of mistake on a line of its own."""
    truth, estimates = ([float(value) for value in rows[name]] for name in ("truth_azimuth", "azimuth_predicted"))
    guides = {
        "correct": [((-180, -180), (180, 180))],
        "flipped": [((-180, 0), (0, 180)), ((0, -180), (180, 0))],
        "mirrored": [((-180, 180), (180, -180))],
        "front for back": [((-180, 0), (0, -180)), ((0, 180), (180, 0))],
    }
    axes = (
        Axis(-180, 180, ANGLE_TICKS, "true azimuth in degrees"),
        Axis(-180, 180, ANGLE_TICKS, "predicted azimuth in degrees"),
    )
    return scatter(list(zip(truth, estimates, strict=True)), guides, axes)


def pose_table(pose: Mapping[str, Any]) -> str:
    """Lay out one row for each split, chance and constant last."""
    header = ["poses", "within 30°", "median error, °", *POSE_COLUMNS.values(), "n"]
    rows = []
    for name in (*ROW_NAMES, *BASELINES):
        if name in pose:
            figures = pose[name]
            median = figure_cell(figures["median_error_degrees"], digits=1)
            cells = [figure_cell(figures.get(column)) for column in POSE_COLUMNS]
            rows.append([ROW_NAMES.get(name, name), figure_cell(figures, "acc_pi6"), median, *cells, str(figures["n"])])
    return table(header, rows, BASELINES)


def shape_table(shape: Mapping[str, Any]) -> str:
    """Lay out one row for each kind of shape, the constant last."""
    columns = ("voxel_iou", "chamfer_l1", "mask_iou", "width_correlation", "height_correlation")
    rows = [
        [ROW_NAMES.get(name, name), *(figure_cell(shape[name].get(column)) for column in columns)]
        for name in (*ROW_NAMES, *BASELINES)
        if name in shape
    ]
    heading = ["shapes", "volume IoU", "Chamfer-L1", "mask IoU", "correlation of widths", "of heights"]
    return table(heading, rows, BASELINES)


def curve_section(curves: Mapping[str, Mapping[str, list[str]]]) -> Section:
    """Plot every column of every stage's curve over the iteration, one line for each seed where there are several.

    A stage that trained nothing has a curve without rows and is left out, and so are losses that are not in use, which
    are 0 throughout.
    """
    parts = []
    for stage, columns in curves.items():
        if not columns["iteration"]:
            continue
        names = [name for name in columns if name not in ("iteration", "seed") and any(map(float, columns[name]))]
        charts = [line_chart(seed_lines(columns, name), _words(name)) for name in names]
        parts.append(f"<h3>{escape(_words(stage))}</h3>{grid('charts', charts)}")
    introduction = (
        "Losses and accuracies as recorded during training; terms of a loss stand here without their weights of "
        "params.yaml. Not all of them fall: two networks work against each other on the view prior."
    )
    return Section("curves", "Training curves", introduction, "".join(parts))


def seed_lines(columns: Mapping[str, list[str]], name: str) -> dict[str, list[Point]]:
    """Split one column into a line for each seed, averaged over stretches of iterations to at most 120 points."""
    seeds = columns.get("seed", ["0"] * len(columns["iteration"]))
    lines: dict[str, list[Point]] = {}
    for seed, iteration, value in zip(seeds, columns["iteration"], columns[name], strict=True):
        lines.setdefault(f"seed {float(seed):g}", []).append((float(iteration), float(value)))
    return {seed: _averaged(line) for seed, line in lines.items()}


def _averaged(line: list[Point]) -> list[Point]:
    stretch = -(-len(line) // LINE_POINTS)
    parts = [line[start : start + stretch] for start in range(0, len(line), stretch)]
    return [(mean(x for x, _ in part), mean(y for _, y in part)) for part in parts]


def metrics_section(figures: Mapping[str, Any], stage_figures: Mapping[str, Mapping[str, Any]]) -> Section:
    """List every figure of the chain, stage by stage."""
    reconstruction = figures["reconstruction"]
    stages = {"reconstruction": "predicted", "fine-tuned": "tuned", RETRIEVED: "retrieved"}
    rows = [
        [name, *(figure_cell(reconstruction[stage][column]) for column in ("feature_distance", "psnr", "ssim"))]
        for name, stage in stages.items()
    ]
    body = table(["pictures", "feature distance", "PSNR (dB)", "SSIM"], rows, [RETRIEVED])
    for name, values in {**stage_figures, "evaluate": figures}.items():
        lines = [
            [escape(label), f"{value:.5g}", "" if error is None else f"{error:.2g}", "" if n is None else str(n)]
            for label, value, error, n in figure_rows(values)
        ]
        body += folded(_words(name), table(["figure", "value", "standard error", "n"], lines))
    introduction = (
        "Reconstructions beside the photographs: distance of their features (lower is better), peak signal-to-noise "
        "ratio and structural similarity (higher is better). Below is every figure that the stages wrote; fine-tuning "
        "measures in the precision that it trains in, so that its distances differ a little from those of evaluation. "
        "The table of all runs is index.html one folder up, which make repro, make run and kato3d runs write."
    )
    return Section("metrics", "All figures", introduction, body)


def _words(name: str) -> str:
    return name.replace("_", " ")


def _tile(figure: Mapping[str, Any], label: str, note: str) -> Tile:
    return Tile(f"{figure['value']:.3f}", error_of(figure), label, note)
