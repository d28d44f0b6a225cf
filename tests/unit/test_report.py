import base64
import io
import math
import re
import zipfile
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy
import pytest
import torch
import trimesh
from PIL import Image

from pipeline.datasets.images import to_bytes
from pipeline.errors import DataError
from pipeline.export.picture import GAP, NAME_HEIGHT, data_uri, encode_png, enlarge, sheet
from pipeline.export.report import choose_examples, example_rows, reconstruction_rows, write_report
from pipeline.export.report_metrics import azimuth_chart, curve_section, headline, pose_table, seed_lines, shape_table
from pipeline.export.report_pictures import Gallery, example_section
from pipeline.export.viewer import three_js
from pipeline.export.views import on_white, render_clay, render_textured
from pipeline.geometry.icosphere import icosphere
from tests.report_inputs import BLUE, CAMERA, CONFIG, DIMENSIONS, ORANGE, VIEW, figure, inputs, pose_figures

EMPTY_ELEMENTS = {"meta", "img", "input"}


def read_png(content: bytes) -> torch.Tensor:
    with Image.open(io.BytesIO(content)) as picture:
        return torch.from_numpy(numpy.asarray(picture).copy())


class Outline(HTMLParser):
    """Collect addresses and anchors, and see that every element that opens closes again in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.addresses: list[str] = []
        self.anchors: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        self.addresses += [value for name in ("src", "href") if (value := values.get(name))]
        self.anchors += [value for name in ("id",) if (value := values.get(name))]
        if tag not in EMPTY_ELEMENTS:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        pass

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.mark.parametrize("truth", [True, False])
def test_page_is_whole_and_needs_nothing_beside_it(tmp_path: Path, truth: bool) -> None:
    write_report(inputs(truth), CONFIG, tmp_path / "page", tmp_path / "figures")
    assert [file.name for file in (tmp_path / "page").iterdir()] == ["index.html"]
    text = (tmp_path / "page/index.html").read_text()
    outline = Outline(text)
    assert outline.open == []
    assert all(address.startswith(("data:image/png;base64,", "#")) for address in outline.addresses)
    assert {address[1:] for address in outline.addresses if address.startswith("#")} == set(outline.anchors)
    assert "default-src 'none'" in text
    assert "://" not in re.sub("<script>.*?</script>", "", text, flags=re.DOTALL)
    assert "<h3>base shape</h3>" in text
    assert "<h3>features</h3>" not in text
    assert "<h1>Run toy&lt;car&gt;</h1>" in text
    assert "The table of all runs is index.html one folder up" in text
    assert ("poses within 30°" in text) == truth


def test_viewer_holds_every_mesh_as_it_is_exported(tmp_path: Path) -> None:
    write_report(inputs(truth=False), CONFIG, tmp_path / "page", tmp_path / "figures")
    text = (tmp_path / "page/index.html").read_text()
    meshes = dict(re.findall(r'value="([\w-]+)" [^>]*data-glb="([^"]+)"', text))
    assert list(meshes)[:2] == ["best-1", "best-3"]
    assert list(meshes)[4:] == ["base", "seed-0", "seed-1"]
    alone = inputs(truth=False)._replace(base=None)
    write_report(alone, CONFIG, tmp_path / "single-stage", tmp_path / "figures")
    text_alone = (tmp_path / "single-stage/index.html").read_text()
    assert 'id="base-shapes"' in text
    assert 'id="base-shapes"' not in text_alone
    assert re.findall(r'value="([\w-]+)" [^>]*data-glb="', text_alone) == list(meshes)[:4]
    assert set(re.findall('data-exhibit="([^"]+)"', text)) == set(meshes) - {"base"}
    (tmp_path / "base.glb").write_bytes(base64.b64decode(meshes["base"]))
    loaded = trimesh.load_mesh(tmp_path / "base.glb", process=False)
    torch.testing.assert_close(torch.tensor(loaded.extents).float(), DIMENSIONS, atol=0.01, rtol=0)


def test_viewer_starts_from_the_fine_tuned_viewpoints(tmp_path: Path) -> None:
    given = inputs(truth=False)
    raised = given.reconstructions.tuned.pose._replace(elevation=torch.tensor([1.0, 20, 3, -5]).deg2rad())
    found = given.reconstructions._replace(tuned=given.reconstructions.tuned._replace(pose=raised))
    config = replace(CONFIG, view=replace(VIEW, elevation=15.0))
    write_report(given._replace(reconstructions=found), config, tmp_path / "page", tmp_path / "figures")
    text = (tmp_path / "page/index.html").read_text()
    choices = re.findall(r'value="([\w-]+)" [^>]*data-azimuth="([^"]+)" data-elevation="([^"]+)"', text)
    viewpoints = {key: viewpoint for key, *viewpoint in choices}
    assert [viewpoints[key] for key in ("best-1", "best-3")] == [["0.0", "20.0"], ["30.0", "-5.0"]]
    assert [viewpoints[key] for key in ("base", "seed-0", "seed-1")] == [["45.0", "15.0"]] * 3


def test_rows_and_charts_tell_before_from_after_fine_tuning(tmp_path: Path) -> None:
    write_report(inputs(truth=True), CONFIG, tmp_path / "page", tmp_path / "figures")
    text = (tmp_path / "page/index.html").read_text()
    rows = first_cells(text)
    assert rows["reconstruction"] == ["0.500", "20.000", "0.500"]
    assert rows["fine-tuned"] == ["0.400", "22.000", "0.600"]
    assert rows["training photograph of the same colours"] == ["0.700", "15.000", "0.300"]
    assert "distance 6.0 → 1.0 · 180° off (flipped) → 5° off (front for back)" in text
    errors = text[text.index('aria-label="share of pictures over rotation error in degrees"') :]
    drawing, legend = errors.split('<div class="legend">')[:2]
    assert re.findall(r"</svg>([\w-]+)</span>", legend)[:2] == ["predicted", "fine-tuned"]
    bars = re.findall(r'class="bar series-(\d)" x="[^"]+" y="[^"]+" width="[^"]+" height="([^"]+)"', drawing)
    filled = [sum(series == one and float(height) > 0 for series, height in bars) for one in "01"]
    assert filled == [4, 2], "predicted errors are in four bars, those after fine-tuning in two"


def test_rows_of_poses_and_shapes_have_their_own_figures() -> None:
    figures = inputs(truth=True).figures
    poses, shapes = first_cells(pose_table(figures["pose"])), first_cells(shape_table(figures["shape"]))
    assert poses["test"][:3] == ["0.500", "20.0", "0.250"]
    assert poses["test, fine-tuned"][:3] == ["0.750", "10.0", "0.200"]
    assert [poses[name][0] for name in ("chance", "constant")] == ["0.150", "0.300"]
    assert {name: cells[0] for name, cells in shapes.items()} == {
        "test": "0.600",
        "test, fine-tuned": "0.650",
        "base shape": "0.500",
        "base shape after full training": "0.550",
        "constant": "0.400",
    }


def test_headline_compares_fine_tuned_pictures_with_those_before() -> None:
    notes = {tile.label: (tile.value, tile.note) for tile in headline(inputs(truth=True).figures)}
    assert notes == {
        "of predicted poses within 30°": ("0.500", "0.750 fine-tuned · chance 0.150 · constant 0.300 · n = 4"),
        "volume IoU of the base shape after full training": ("0.550", "constant 0.400"),
        "mask IoU, predicted": ("0.700", "0.750 fine-tuned · constant 0.450"),
        "of pictures improved by fine-tuning": ("75.0%", "feature distance 0.5 → 0.4 · n = 4"),
        "structural similarity, fine-tuned": ("0.600", "0.500 before fine-tuning"),
    }


def test_azimuths_are_plotted_over_true_ones() -> None:
    chart = azimuth_chart(inputs(truth=True).table)
    ends = re.search(r'<line class="guide[^"]*" x1="([^"]+)" y1="([^"]+)" x2="([^"]+)" y2="([^"]+)"', chart)
    assert ends is not None
    left, bottom, right, top = map(float, ends.groups())  # the diagonal, from -180 to 180 degrees
    dots = re.findall(r'<circle class="dot series-0" cx="([^"]+)" cy="([^"]+)" r="2.5"', chart)
    across = [(float(x) - left) / (right - left) * 360 - 180 for x, _ in dots]
    up = [(float(y) - bottom) / (top - bottom) * 360 - 180 for _, y in dots]
    assert across == pytest.approx([0, 90, -180, -90], abs=1)
    assert up == pytest.approx([0, -90, 170, 0], abs=1)


def test_each_kind_of_wrong_azimuth_lies_on_its_guide() -> None:
    chart = azimuth_chart(inputs(truth=True).table)
    names = dict(re.findall(r'<line class="guide ([^"]*)"[^>]*/></svg>([^<]*)</span>', chart))
    ends = 'x1="([^"]+)" y1="([^"]+)" x2="([^"]+)" y2="([^"]+)"'
    guides: dict[str, list[list[float]]] = {name: [] for name in names.values()}
    for style, *points in re.findall(f'<line class="guide ([^"]*)" {ends}', chart.partition("</svg>")[0]):
        guides[names[style]].append([float(point) for point in points])
    left, bottom, right, top = guides["correct"][0]  # from -180 to 180 degrees
    for truth in (-135, -45, 45, 135):
        x = left + (truth + 180) / 360 * (right - left)
        estimates = {"correct": truth, "flipped": truth + 180, "mirrored": -truth, "front for back": 180 - truth}
        for name, estimate in estimates.items():
            y = bottom + (estimate + 180) % 360 / 360 * (top - bottom)
            met = [y1 + (x - x1) / (x2 - x1) * (y2 - y1) for x1, y1, x2, y2 in guides[name] if x1 <= x <= x2]
            assert met == pytest.approx([y], abs=0.2), (name, truth)


def test_columns_of_poses_and_shapes_have_the_figures_of_their_headings() -> None:
    kinds = {"flipped": 0.11, "mirrored": 0.12, "front for back": 0.13, "other": 0.14}
    pose = {**kinds, "seen side": 0.15, "front or side": 0.16}
    given = pose_figures(0.5, 20) | {name.replace(" for", "").replace(" ", "_"): figure(pose[name]) for name in pose}
    expected = {"within 30°": "0.500", "median error, °": "20.0", **{name: f"{pose[name]:.3f}" for name in pose}}
    assert headed_rows(pose_table({"test": given})) == [{"poses": "test", **expected, "n": "4"}]
    columns = ("voxel_iou", "chamfer_l1", "mask_iou", "width_correlation", "height_correlation")
    shape = {name: figure(place / 10) for place, name in enumerate(columns)}
    assert headed_rows(shape_table({"base": shape})) == [
        {
            "shapes": "base shape",
            "volume IoU": "0.000",
            "Chamfer-L1": "0.100",
            "mask IoU": "0.200",
            "correlation of widths": "0.300",
            "of heights": "0.400",
        }
    ]


def test_curves_of_seeds_are_lines_of_their_own_averaged_over_stretches() -> None:
    rows = [(seed, iteration) for iteration in range(240) for seed in (0, 1)]
    columns = {
        "seed": [str(seed) for seed, _ in rows],
        "iteration": [str(iteration) for _, iteration in rows],
        "loss": [str((1 + seed) * iteration**2) for seed, iteration in rows],
    }
    averaged = [(place + 0.5, place**2 + place + 0.5) for place in range(0, 240, 2)]
    assert seed_lines(columns, "loss") == {"seed 0": averaged, "seed 1": [(x, 2 * y) for x, y in averaged]}
    charts = curve_section({"base_shape": columns}).body
    assert re.findall("</svg>(seed [^<]*)</span>", charts) == ["seed 0", "seed 1"]
    assert charts.partition("</svg>")[0].count("<polyline") == 2


def headed_rows(text: str) -> list[dict[str, str]]:
    """Read a table's rows, without standard errors, by the headings of their columns."""
    headings = re.findall("<th>(.*?)</th>", text)
    return [dict(zip(headings, (name, *cells), strict=True)) for name, cells in first_cells(text).items()]


def first_cells(text: str) -> dict[str, list[str]]:
    """Read the values of a page's table rows, without their standard errors, by the row's name."""
    rows = [re.findall("<td>(.*?)(?: <small>.*?)?</td>", row) for row in re.findall("<tr[^>]*>(<td>.*?)</tr>", text)]
    return {name: cells for name, *cells in rows}


def test_a_trimesh_without_three_js_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "viewer.zip", "w") as file:
        file.writestr("viewer.html.template", "<script>var camera</script>")
    monkeypatch.setattr("pipeline.export.viewer.TEMPLATE", tmp_path / "viewer.zip")
    with pytest.raises(DataError, match=r"brings no three\.js .* install that of constraints\.txt"):
        three_js()


def test_figures_hold_renderings_and_no_photograph(tmp_path: Path) -> None:
    write_report(inputs(truth=False), CONFIG, tmp_path / "page", tmp_path / "figures")
    files = sorted((tmp_path / "figures").iterdir())
    assert [file.name for file in files] == ["examples.png", "reconstructions.png", "steps.png"]
    assert not any(shows_magenta(file) for file in files)


def test_figures_show_photographs_that_the_project_draws(tmp_path: Path) -> None:
    for drawn in (False, True):
        given = inputs(truth=False)._replace(drawn=drawn)
        write_report(given, CONFIG, tmp_path / "page", tmp_path / f"figures_{drawn}")
    shown = sorted(file.name for file in (tmp_path / "figures_True").iterdir() if shows_magenta(file))
    assert shown == ["examples.png", "reconstructions.png"]
    without, beside = (read_png((tmp_path / f"figures_{drawn}/examples.png").read_bytes()) for drawn in (False, True))
    assert without.shape[1] == beside.shape[1]
    assert beside.shape[0] - without.shape[0] == NAME_HEIGHT + GAP + VIEW.size


def shows_magenta(picture: Path) -> bool:
    """Say whether a photograph of `inputs` is in a picture."""
    return bool((read_png(picture.read_bytes()) == torch.tensor([255, 0, 255])).all(-1).any())


def test_boxed_objects_fill_their_other_views() -> None:
    given = inputs(truth=False)
    far = given.reconstructions.tuned.pose._replace(scale=torch.full((4,), 0.3))
    found = given.reconstructions._replace(tuned=given.reconstructions.tuned._replace(pose=far))
    reach = {}
    for framing in ("free", "box"):
        gallery = Gallery(found, given.photographs, CAMERA, framing, VIEW)
        other = gallery.renderings(torch.tensor([0]), other_view=90.0)[0, 2]
        drawn = (other - 0.5).abs().amax(dim=0) > 0.1
        reach[framing] = max(drawn.any(dim=0).sum().item(), drawn.any(dim=1).sum().item())
    assert reach["free"] < 8
    assert reach["box"] >= 15


def test_other_views_are_turned_on_from_the_fine_tuned_viewpoint() -> None:
    given = inputs(truth=False)
    gallery, last = Gallery(given.reconstructions, given.photographs, CAMERA, "free", VIEW), torch.tensor([3])
    turned = gallery.renderings(last, 60.0)[0, 2]  # 30 + 60 degrees: the left side, its front in the left half
    torch.testing.assert_close(turned[:, 8, [5, 10]].T, torch.stack([ORANGE, BLUE]), atol=0.02, rtol=0)
    row = reconstruction_rows(gallery, last, "best", False, 60.0)["best: fine-tuned and turned by 60 degrees"]
    assert torch.equal(row[0, :, ::3, ::3], turned[:, ::2, ::2])  # 16 pixels enlarged to 24
    shown = re.findall(
        'src="data:image/png;base64,([^"]+)"', example_section("a", "", gallery, last, given.table, 60).body
    )
    assert torch.equal(read_png(base64.b64decode(shown[3])).permute(2, 0, 1), to_bytes(turned))


def test_corners_are_of_the_front_of_the_rear_and_of_the_shape_in_grey() -> None:
    given = inputs(truth=False)
    gallery = Gallery(given.reconstructions, given.photographs, CAMERA, "free", VIEW)
    *corners, clay = on_white(gallery.corners(0))[:, :, 12, 12]
    torch.testing.assert_close(torch.stack(corners), torch.stack([ORANGE, BLUE]), atol=0.02, rtol=0)
    torch.testing.assert_close(clay, clay.mean().expand(3))
    front, rear, grey = list(example_rows(gallery, torch.tensor([0]), drawn=False).values())[1:]
    assert torch.equal(torch.cat([front, rear, grey]), on_white(gallery.corners(0)))


def test_same_inputs_give_the_same_bytes(tmp_path: Path) -> None:
    for name in ("first", "second"):
        write_report(inputs(truth=True), CONFIG, tmp_path / name, tmp_path / f"{name}_figures")
    first, second = (tmp_path / name / "index.html" for name in ("first", "second"))
    assert first.read_bytes() == second.read_bytes()


def test_single_stage_training_has_no_volume_of_a_base_shape_in_its_headline() -> None:
    figures = inputs(truth=True).figures
    single_stage = {**figures, "shape": {name: value for name, value in figures["shape"].items() if "base" not in name}}
    dropped = {tile.label for tile in headline(figures)} - {tile.label for tile in headline(single_stage)}
    assert dropped == {"volume IoU of the base shape after full training"}


def test_the_seed_that_was_chosen_is_marked(tmp_path: Path) -> None:
    write_report(inputs(truth=False), CONFIG, tmp_path / "page", tmp_path / "figures")
    text = (tmp_path / "page/index.html").read_text()
    assert "seed 0 · score 0.5000 <b>chosen</b>" in text
    assert text.count("<b>chosen</b>") == 2  # there, and beside its mesh


def test_best_examples_have_the_least_distance() -> None:
    best, random = choose_examples(inputs(truth=False), CONFIG)
    assert best.tolist() == [1, 3]
    assert len(random.unique()) == len(random) == 2


def test_sheets_keep_pictures_in_their_places_and_leave_white_out() -> None:
    pictures = torch.full((2, 3, 9, 5), 0.5)
    pictures[1, :, :, 4] = 0.25
    objects = torch.ones(2, 3, 8, 5)
    objects[0, :, 3:5, 1], objects[1, :, 4:6, 2] = 0.0, 0.75
    laid = sheet({"photograph": pictures, "shape": objects})
    first, second = NAME_HEIGHT + GAP, 2 * (NAME_HEIGHT + GAP) + 9
    assert laid.shape[1] == second + 3 + GAP
    assert torch.equal(laid[:, first : first + 9, GAP : GAP + 5], pictures[0])
    assert torch.equal(laid[:, first : first + 9, 2 * GAP + 5 : 2 * GAP + 10], pictures[1])
    assert torch.equal(laid[:, second : second + 3, GAP : GAP + 5], objects[0, :, 3:6])
    assert torch.equal(laid[:, second : second + 3, 2 * GAP + 5 : 2 * GAP + 10], objects[1, :, 3:6])
    assert (laid[:, first : first + 9, GAP + 5 : 2 * GAP + 5] == 1).all()


def test_sheets_name_their_rows() -> None:
    row = torch.full((4, 3, 8, 64), 0.5)
    named, other = (sheet({name: row}) for name in ("photograph", "fine-tuned"))
    assert named.shape[2] == 4 * (64 + GAP) + GAP
    assert named[:, :NAME_HEIGHT].min() < 0.1
    assert not torch.equal(named[:, :NAME_HEIGHT], other[:, :NAME_HEIGHT])
    assert torch.equal(named[:, NAME_HEIGHT:], other[:, NAME_HEIGHT:])
    narrow = sheet({"a long name above one narrow picture": row[:1]})
    assert narrow[:, :NAME_HEIGHT, 64:].min() < 0.1
    assert (narrow[:, :, -GAP:] == 1).all()


def test_enlarged_pixels_are_squares() -> None:
    assert enlarge(torch.tensor([[1.0, 2.0]]), 2).tolist() == [[1, 1, 2, 2], [1, 1, 2, 2]]


def test_data_uri_round_trip() -> None:
    picture = torch.rand(4, 5, 6, generator=torch.Generator().manual_seed(0))
    encoded = base64.b64decode(data_uri(picture).removeprefix("data:image/png;base64,"))
    decoded = read_png(encoded).permute(2, 0, 1).float() / 255
    torch.testing.assert_close(decoded, picture, atol=0.5 / 255 + 1e-6, rtol=0)
    assert encoded == encode_png(picture)


def test_clay_is_transparent_around_the_shape_and_solid_inside() -> None:
    sphere, faces = icosphere(2)
    views = render_clay(sphere.float() / 2, faces, [0.0, 120.0], CAMERA, VIEW)
    assert views.shape == (2, 4, 24, 24)
    assert (views[:, 3, 0, 0] == 0).all()
    assert (views[:, 3, 12, 12] == 1).all()
    torch.testing.assert_close(on_white(views)[:, :, 0, 0], torch.ones(2, 3))


def test_what_would_be_cut_off_is_drawn_smaller_from_all_sides() -> None:
    sphere, faces = icosphere(2)
    tall = sphere.float() * torch.tensor([0.5, 1.2, 0.3])
    views = render_clay(tall, faces, [0.0, 45.0, 90.0], CAMERA, VIEW)[:, 3]
    heights, widths = ((views > 0.5).any(dim=axis).sum(dim=1) for axis in (2, 1))
    assert heights.tolist() == [VIEW.size] * 3
    torch.testing.assert_close(widths[[0, 2]] / VIEW.size, torch.tensor([0.5, 0.3]) / 1.2, atol=1 / VIEW.size, rtol=0)


def test_textured_view_keeps_its_colour_up_to_the_edge() -> None:
    sphere, faces = icosphere(2)
    red = torch.tensor([1.0, 0, 0])[:, None, None].expand(3, 4, 4)
    view = render_textured(sphere.float() / 2, faces, sphere.float(), red, [math.degrees(1)], CAMERA, VIEW)[0]
    covered = view[3] > 0.05
    torch.testing.assert_close(view[0][covered], torch.ones(int(covered.sum())), atol=1e-3, rtol=0)


def test_clay_is_lit_from_the_upper_left() -> None:
    sphere, faces = icosphere(3)
    for view in render_clay(sphere / 2, faces, [0.0, 120.0], CAMERA, VIEW):
        brightness, covered = view[0], view[3] == 1
        rows, columns = torch.meshgrid(torch.arange(24) - 11.5, torch.arange(24) - 11.5, indexing="ij")
        left, right, upper, lower = (
            brightness[covered & half].mean() for half in (columns < 0, columns > 0, rows < 0, rows > 0)
        )
        assert left > right + 0.05
        assert upper > lower + 0.05


def test_random_examples_are_drawn_by_the_seed() -> None:
    given = inputs(truth=False)
    chosen = {tuple(choose_examples(given, replace(CONFIG, seed=seed))[1].tolist()) for seed in range(8)}
    assert len(chosen) > 1
