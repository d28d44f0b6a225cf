import base64
import io
import math
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy
import pytest
import torch
from PIL import Image

from pipeline.evaluation.artifacts import Reconstruction, Reconstructions
from pipeline.export.picture import data_uri, encode_png, enlarge, tile
from pipeline.export.report import ReportConfig, ReportInputs, choose_examples, write_report
from pipeline.export.views import ViewConfig, on_white, render_clay, render_textured
from pipeline.geometry.camera import CameraConfig, Pose
from pipeline.geometry.icosphere import icosphere

CAMERA = CameraConfig(distance=2.7, field_of_view=30.0)
VIEW = ViewConfig(size=24, supersampling=2, elevation=0.0)
CONFIG = ReportConfig(seed=0, examples=2, turntables=1, frames=4, other_view=90.0, view=VIEW)
COUNT = 4
EMPTY_ELEMENTS = {"meta", "img", "input"}


def figure(value: float) -> dict[str, float]:
    return {"value": value, "n": COUNT, "standard_error": 0.1}


def inputs(truth: bool) -> ReportInputs:
    sphere, faces = icosphere(1)
    directions = sphere.float()
    zeros = torch.zeros(COUNT)
    pose = Pose(zeros, zeros, zeros, torch.zeros(COUNT, 2), zeros + 1)
    vertices = directions.expand(COUNT, -1, -1) / 2
    found = Reconstruction(pose, vertices, *[torch.full((COUNT, 3, 16, 16), 0.5)] * 2)
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
        figures["shape"] = {"test": ious, "base": {"voxel_iou": figure(0.6)}, "constant": ious}
        table |= {"truth_azimuth": ["0", "90", "180", "270"], "azimuth_predicted": ["0", "-90", "170", "0"]}
        table |= {f"rotation_error_{stage}": ["0", "180", "10", "90"] for stage in ("predicted", "tuned")}
        table["error_mode_predicted"] = ["correct", "flipped", "correct", "other"]
    photographs = torch.tensor([1.0, 0, 1])[:, None, None].expand(COUNT, 3, 16, 16)
    textures = torch.full((COUNT, 3, 4, 4), 0.25)
    curve = {"iteration": ["0", "1"], "seed": ["0", "0"], "loss": ["2", "1"]}
    return ReportInputs(
        run="toy<car>",
        photographs=photographs,
        reconstructions=Reconstructions(found, found, textures, faces, directions, torch.arange(7, 11)),
        seeds=torch.stack([directions / 2, directions / 3]),
        seed_faces=faces,
        seed_scores=torch.tensor([0.5, 0.25]),
        base=directions / 2,
        camera=CAMERA,
        figures=figures,
        stage_figures={"remesh": {"area_variation": 0.1}},
        curves={"base_shape": curve},
        table=table,
    )


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
    assert "://" not in re.sub("base64,[^\"')]*", "", text)
    assert "<h1>Run toy&lt;car&gt;</h1>" in text
    assert ("poses within 30°" in text) == truth


def test_figures_hold_renderings_and_no_photograph(tmp_path: Path) -> None:
    write_report(inputs(truth=False), CONFIG, tmp_path / "page", tmp_path / "figures")
    files = sorted((tmp_path / "figures").iterdir())
    assert [file.name for file in files] == ["base_shapes.png", "reconstructions.png", "steps.png"]
    magenta = torch.tensor([255, 0, 255])
    for file in files:
        assert not (read_png(file.read_bytes()) == magenta).all(-1).any()
    assert read_png(files[0].read_bytes()).shape == (2 * (24 + 4) + 4, 4 * (24 + 4) + 4, 3)


def test_same_inputs_give_the_same_bytes(tmp_path: Path) -> None:
    for name in ("first", "second"):
        write_report(inputs(truth=True), CONFIG, tmp_path / name, tmp_path / f"{name}_figures")
    first, second = (tmp_path / name / "index.html" for name in ("first", "second"))
    assert first.read_bytes() == second.read_bytes()


def test_lowest_score_is_marked_as_chosen(tmp_path: Path) -> None:
    write_report(inputs(truth=False), CONFIG, tmp_path / "page", tmp_path / "figures")
    assert "seed 1 · score 0.2500 <b>chosen</b>" in (tmp_path / "page/index.html").read_text()


def test_best_examples_have_the_least_distance() -> None:
    best, random = choose_examples(inputs(truth=False), CONFIG)
    assert best.tolist() == [1, 3]
    assert len(set(random.tolist())) == 2


def test_tiles_keep_their_places() -> None:
    pictures = torch.arange(6.0).reshape(2, 3, 1, 1, 1).expand(2, 3, 3, 2, 2)
    sheet = tile(pictures, gap=1, shade=9.0)
    assert sheet.shape == (3, 7, 10)
    assert sheet[0, 1::3, 1::3].tolist() == [[0, 1, 2], [3, 4, 5]]
    assert sheet[0, 0].tolist() == [9.0] * 10


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


def test_textured_view_keeps_its_colour_up_to_the_edge() -> None:
    sphere, faces = icosphere(2)
    red = torch.tensor([1.0, 0, 0])[:, None, None].expand(3, 4, 4)
    view = render_textured(sphere.float() / 2, faces, sphere.float(), red, [math.degrees(1)], CAMERA, VIEW)[0]
    covered = view[3] > 0.05
    torch.testing.assert_close(view[0][covered], torch.ones(int(covered.sum())), atol=1e-3, rtol=0)
