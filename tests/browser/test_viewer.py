"""The report's viewer in a real browser: what is on the canvas, what turns it, and that nothing leaves the page."""

import io
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy
import pytest
import torch
from PIL import Image
from playwright.sync_api import Browser, BrowserContext, Locator, Page, expect

from pipeline.cli.gallery import write_gallery
from pipeline.cli.photographs import Target
from pipeline.export.glb import write_glb
from pipeline.export.picture import write_png
from pipeline.export.report import write_report
from pipeline.export.seam import cut_open
from pipeline.files import write_json
from tests.report_inputs import BLUE, CAMERA, CONFIG, ORANGE, inputs

pytestmark = pytest.mark.browser

STILL = {"reduced_motion": "reduce"}
PHONE = {"viewport": {"width": 360, "height": 740}, "has_touch": True, "is_mobile": True, **STILL}
PATIENCE = 60_000  # milliseconds: a busy machine draws slowly
NEXT_FRAMES = "() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"
Open = Callable[..., Page]


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("report")
    write_report(inputs(truth=True), CONFIG, folder / "page", folder / "figures")
    return (folder / "page/index.html").as_uri()


@pytest.fixture
def open_page(chromium: Browser, address: str) -> Iterator[Open]:
    """Open the report, or another page; in the end, see that no error was reported and nothing asked of the network."""
    contexts: list[BrowserContext] = []
    complaints: list[str] = []
    requests: list[str] = []

    def open_(address: str = address, **options: object) -> Page:
        contexts.append(chromium.new_context(**options))  # pyright: ignore[reportArgumentType]
        contexts[-1].set_default_timeout(PATIENCE)
        page = contexts[-1].new_page()
        page.on("console", lambda message: complaints.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("request", lambda request: requests.append(request.url))
        page.goto(address)
        page.locator("canvas").scroll_into_view_if_needed()
        page.locator("canvas[aria-busy=false]").wait_for()
        return page

    yield open_
    for context in contexts:
        context.close()
    assert complaints == []
    assert all(url.startswith(("file:", "data:", "blob:")) for url in requests)


def seen(page: Page) -> numpy.ndarray:
    """Return what the canvas shows, in [0, 1], once it has been drawn again."""
    page.evaluate(NEXT_FRAMES)
    with Image.open(io.BytesIO(page.locator("canvas").screenshot())) as picture:
        return numpy.asarray(picture.convert("RGB")) / 255


def color(picture: numpy.ndarray, across: float) -> numpy.ndarray:
    """Return the colour half way down the picture, at a share of its width."""
    return picture[picture.shape[0] // 2, round(across * picture.shape[1])]


def slider(page: Page, name: str) -> Locator:
    return page.get_by_role("slider", name=name)


def angles(page: Page) -> tuple[str, str]:
    return slider(page, "azimuth").input_value(), slider(page, "elevation").input_value()


def test_the_mesh_is_drawn_in_its_own_colours(open_page: Open) -> None:
    picture = seen(open_page(**STILL))
    numpy.testing.assert_allclose(color(picture, 0.5), ORANGE, atol=0.03)
    background = picture[5, picture.shape[1] // 2]
    covered = numpy.abs(picture - background).max(axis=2) > 0.1
    assert 0.05 < covered.mean() < 0.6
    assert background.min() > 0.9


def test_the_azimuth_slider_goes_round_the_object_as_the_conventions_say(open_page: Open) -> None:
    page = open_page(**STILL)
    slider(page, "azimuth").fill("180")
    numpy.testing.assert_allclose(color(seen(page), 0.5), BLUE, atol=0.03)
    assert slider(page, "azimuth").input_value() == "180"
    slider(page, "azimuth").fill("90")  # the camera is at +x: the front, +z, is on the left
    picture = seen(page)
    numpy.testing.assert_allclose(color(picture, 0.4), ORANGE, atol=0.03)
    numpy.testing.assert_allclose(color(picture, 0.6), BLUE, atol=0.03)


def test_a_slider_stays_where_it_is_moved(open_page: Open) -> None:
    page = open_page(**STILL)
    slider(page, "azimuth").focus()
    page.keyboard.press("Home")
    assert angles(page)[0] == "-180"
    numpy.testing.assert_allclose(color(seen(page), 0.5), BLUE, atol=0.03)


def test_a_context_that_was_lost_is_drawn_again(open_page: Open) -> None:
    page = open_page(**STILL)
    page.evaluate(
        """async () => {
            const context = document.querySelector('canvas').getContext('webgl2').getExtension('WEBGL_lose_context');
            context.loseContext();
            await new Promise(done => setTimeout(done, 200));
            context.restoreContext();
            await new Promise(done => setTimeout(done, 200));
        }"""
    )
    numpy.testing.assert_allclose(color(seen(page), 0.5), ORANGE, atol=0.03)


def test_a_camera_from_afar_sees_the_mesh(open_page: Open, address: str, tmp_path: Path) -> None:
    text = Path(address.removeprefix("file://")).read_text()
    usual = f'data-field-of-view="{CAMERA.field_of_view:g}"'
    assert usual in text
    (tmp_path / "index.html").write_text(text.replace(usual, 'data-field-of-view="2"'))
    page = open_page((tmp_path / "index.html").as_uri(), **STILL)
    numpy.testing.assert_allclose(color(seen(page), 0.5), ORANGE, atol=0.03)


def test_a_narrow_window_shows_the_whole_page(open_page: Open) -> None:
    page = open_page(viewport={"width": 320, "height": 640}, **STILL)
    assert page.evaluate("document.documentElement.scrollWidth") == 320
    table = page.locator(".scroll").first
    table.focus()
    page.keyboard.press("ArrowRight")
    page.wait_for_function("() => document.querySelector('.scroll').scrollLeft > 0")


def test_the_elevation_slider_changes_the_picture(open_page: Open) -> None:
    page = open_page(**STILL)
    level = seen(page)
    slider(page, "elevation").fill("60")
    assert numpy.abs(seen(page) - level).max() > 0.3


def test_arrow_keys_turn_and_home_goes_back(open_page: Open) -> None:
    page = open_page(**STILL)
    page.locator("canvas").focus()
    page.keyboard.press("Home")
    first = seen(page)
    for key in ("ArrowRight", "ArrowRight", "ArrowUp"):
        page.keyboard.press(key)
    assert angles(page) == ("10", "5")
    assert numpy.abs(seen(page) - first).max() > 0.3
    page.keyboard.press("Home")
    numpy.testing.assert_allclose(seen(page), first, atol=0.02)


def test_dragging_turns_the_object_with_the_pointer(open_page: Open) -> None:
    page = open_page(**STILL)
    first = seen(page)
    box = page.locator("canvas").bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 40, y + 20, steps=4)
    page.mouse.up()
    page.mouse.move(x, y)
    assert angles(page) == ("-20", "10")
    assert numpy.abs(seen(page) - first).max() > 0.3


def test_a_phone_shows_the_whole_page_and_a_finger_turns_the_mesh(open_page: Open) -> None:
    page = open_page(**PHONE)
    assert page.evaluate("document.documentElement.scrollWidth") == 360
    first = seen(page)
    box = page.locator("canvas").bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    touch = page.context.new_cdp_session(page)
    touch.send("Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": [{"x": x, "y": y}]})
    for step in range(1, 9):
        touch.send("Input.dispatchTouchEvent", {"type": "touchMove", "touchPoints": [{"x": x - 10 * step, "y": y}]})
    touch.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    assert float(angles(page)[0]) > 20
    assert numpy.abs(seen(page) - first).max() > 0.3


def test_a_card_leads_to_its_mesh_and_a_shape_without_colours_is_clay(open_page: Open) -> None:
    page = open_page(**STILL)
    page.locator("a[data-exhibit=seed-1]").click()
    page.locator("canvas[aria-busy=false]").wait_for()
    assert page.locator(".shown").inner_text() == "seed 1"
    assert "score 0.2500 · before" in page.locator(".beside:visible").inner_text()
    assert page.get_by_role("radio", name="texture").is_disabled()
    shade = color(seen(page), 0.5)
    assert numpy.ptp(shade) < 0.1
    page.get_by_role("radio", name="polygons").check()
    assert len(numpy.unique(seen(page).reshape(-1, 3), axis=0)) > 100
    page.get_by_role("radio", name="seed 1").press("ArrowLeft")
    assert page.locator(".shown").inner_text() == "seed 0"
    assert "score 0.5000 chosen · before" in page.locator(".beside:visible").inner_text()


@pytest.mark.parametrize("follow", ["click", "Enter"])
def test_arrow_keys_turn_the_mesh_that_a_card_led_to(open_page: Open, follow: str) -> None:
    page = open_page(**STILL)
    link = page.locator("a[data-exhibit=seed-1]")
    link.click() if follow == "click" else link.press(follow)
    page.wait_for_timeout(200)  # a followed link takes the focus only now
    azimuth, elevation = map(float, angles(page))
    page.keyboard.press("ArrowRight")
    assert tuple(map(float, angles(page))) == (azimuth + 5, elevation)
    expect(page.locator("canvas")).to_be_in_viewport(ratio=0.9)


TAKING_OVER: dict[str, Callable[[Page], None]] = {
    "button": lambda page: page.get_by_role("button", name="spin").click(),
    "key": lambda page: page.locator("canvas").press("ArrowLeft"),
    "slider": lambda page: slider(page, "elevation").fill("20"),
    "drag": lambda page: page.locator("canvas").drag_to(page.locator("canvas"), target_position={"x": 30, "y": 30}),
    "choice": lambda page: page.locator("a[data-exhibit=seed-1]").click(),
}


@pytest.mark.parametrize("way", TAKING_OVER)
def test_it_spins_until_someone_takes_over(open_page: Open, way: str) -> None:
    page = open_page()
    page.wait_for_function("() => Math.abs(document.querySelector('[name=azimuth]').value) > 2")
    TAKING_OVER[way](page)
    stopped = angles(page)
    page.wait_for_timeout(400)  # more than nine degrees of a spin
    assert angles(page) == stopped


def test_a_mesh_that_a_card_led_to_from_afar_stays_at_home(chromium: Browser, address: str) -> None:
    context = chromium.new_context(viewport={"width": 800, "height": 200})
    page = context.new_page()
    page.goto(f"{address}#random")
    assert page.evaluate("() => document.querySelector('.viewer').getBoundingClientRect().bottom") < -200
    page.locator("a[data-exhibit]").last.click()
    page.locator("canvas[aria-busy=false]").wait_for(timeout=PATIENCE)
    home = angles(page)
    page.wait_for_timeout(400)
    assert angles(page) == home
    assert page.get_by_role("button", name="spin").get_attribute("aria-pressed") == "false"
    context.close()


def test_a_mesh_that_cannot_be_read_is_said(chromium: Browser, address: str) -> None:
    context = chromium.new_context(reduced_motion="reduce")
    page = context.new_page()
    page.goto(address)
    page.evaluate("() => { document.querySelector('[name=exhibit][value=seed-1]').dataset.glb = 'AAAA'; }")
    page.locator("a[data-exhibit=seed-1]").click()
    complaint = page.get_by_text("The mesh of seed 1 cannot be read; write the page anew.")
    expect(complaint).to_be_visible(timeout=PATIENCE)
    page.locator("a[data-exhibit=seed-0]").click()
    expect(page.locator("canvas[aria-busy=false]")).to_be_visible(timeout=PATIENCE)
    expect(complaint).to_be_hidden()
    context.close()


def test_keys_and_buttons_of_the_browser_turn_nothing(open_page: Open) -> None:
    page = open_page(**STILL)
    before = angles(page)
    page.locator("canvas").press("Control+ArrowLeft")
    box = page.locator("canvas").bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 50, box["y"] + 50)
    page.mouse.down(button="right")
    page.mouse.move(box["x"] + 150, box["y"] + 50, steps=4)
    page.mouse.up(button="right")
    assert angles(page) == before


def test_nothing_moves_by_itself_where_less_motion_is_wished(open_page: Open) -> None:
    page = open_page(**STILL)
    page.wait_for_timeout(300)
    assert angles(page) == ("0", "0")
    assert page.get_by_role("button", name="spin").get_attribute("aria-pressed") == "false"


def test_a_browser_without_webgl_says_so(chromium: Browser, address: str) -> None:
    context = chromium.new_context()
    context.add_init_script("HTMLCanvasElement.prototype.getContext = () => null;")
    page = context.new_page()
    page.goto(address)
    sentence = page.get_by_text("it offers no WebGL")
    sentence.wait_for()
    assert sentence.is_visible()
    assert page.locator("canvas").is_hidden()
    context.close()


def test_reconstructed_photographs_are_turned_on_a_page_of_their_own(open_page: Open, tmp_path: Path) -> None:
    found = inputs(truth=False).reconstructions
    texture = found.textures[0]
    mesh = cut_open(found.faces, found.directions).unwrap(found.tuned.vertices[0], texture.shape[-1])
    targets = [Target(tmp_path / "photographs" / name) for name in ("first", "second")]
    for target, azimuth in zip(targets, (180.0, 0.0), strict=True):
        for kind in ("photograph", "reconstruction"):
            write_png(target.file(f"_{kind}.png"), torch.zeros(3, 32, 32))
        write_glb(target.file(".glb"), mesh, texture)
        write_json(target.file("_pose.json"), {"azimuth_degrees": azimuth, "elevation_degrees": 0.0})
    write_gallery(tmp_path / "index.html", targets, CAMERA, "the model of 'toybox-car'")
    page = open_page((tmp_path / "index.html").as_uri(), **STILL)
    numpy.testing.assert_allclose(color(seen(page), 0.5), BLUE, atol=0.03)
    page.get_by_role("radio", name="photographs/second").check()
    numpy.testing.assert_allclose(color(seen(page), 0.5), ORANGE, atol=0.03)
