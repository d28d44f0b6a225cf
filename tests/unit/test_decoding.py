"""Pictures become square arrays by a stated rule."""

import io
import struct
import tracemalloc
import warnings

import numpy as np
import pytest
from PIL import Image, ImageCms

from pipeline.datasets.decoding import Fit, cut_boxes, decode, decode_up_to
from pipeline.errors import DataError
from tests.picture_trees import noise, picture, swapped


def halves(width: int, height: int) -> bytes:
    """Encode a picture whose left half is red and whose right half is blue."""
    pixels = np.zeros((height, width, 3), np.uint8)
    pixels[:, : width // 2, 0] = pixels[:, width // 2 :, 2] = 255
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "PNG")
    return stream.getvalue()


def test_a_picture_of_the_right_size_keeps_its_bytes() -> None:
    expected = np.asarray(Image.open(io.BytesIO(noise(0))))
    np.testing.assert_array_equal(decode(noise(0), "1.jpg", 32, "crop"), expected)
    np.testing.assert_array_equal(decode(noise(0), "1.jpg", 32, "pad"), expected)


def test_crop_fits_the_short_side() -> None:
    pixels = decode(halves(200, 64), "1.png", 32, "crop")
    assert pixels.shape == (32, 32, 3)
    assert tuple(pixels[5, 5]) == (255, 0, 0)
    assert tuple(pixels[5, -5]) == (0, 0, 255)


def test_pictures_too_small_for_the_wanted_size_keep_theirs() -> None:
    assert decode_up_to(halves(200, 64), "1.png", 128, 32, "crop").shape == (64, 64, 3)
    assert decode_up_to(halves(200, 64), "1.png", 128, 32, "pad").shape == (128, 128, 3)
    for fit in ("crop", "pad"):
        expected = decode(halves(200, 64), "1.png", 32, fit)
        np.testing.assert_array_equal(decode_up_to(halves(200, 64), "1.png", 32, 32, fit), expected)


def middle(pixels: np.ndarray) -> np.ndarray:
    """Return the centre of brightness, in sides of the picture."""
    weights = pixels[..., 0].astype(float)
    places = (np.arange(len(weights)) + 0.5) / len(weights)
    return np.array([(weights * place).sum() for place in (places[:, None], places)]) / weights.sum()


@pytest.mark.parametrize("fit", ["crop", "pad"])
@pytest.mark.parametrize("sides", [(640, 480), (480, 640), (640, 620), (65, 64), (1000, 563), (3000, 1700)])
def test_a_larger_square_shows_what_the_small_one_shows(fit: Fit, sides: tuple[int, int]) -> None:
    x, y = (np.arange(side) / side - 0.5 for side in sides)
    spot = 255 * np.exp(-60 * (y[:, None] ** 2 + x**2))
    stream = io.BytesIO()
    Image.fromarray(spot.astype(np.uint8)).convert("RGB").save(stream, "PNG")
    small = decode(stream.getvalue(), "1.png", 32, fit)
    larger = decode_up_to(stream.getvalue(), "1.png", 128, 32, fit)
    assert len(larger) == min(128, min(sides) if fit == "crop" else max(sides))
    np.testing.assert_allclose(middle(larger), middle(small), atol=0.001)


def test_the_square_of_a_panorama_takes_little_memory() -> None:
    panorama = picture(width=12_000, height=100)
    tracemalloc.start()
    decode_up_to(panorama, "1.png", 128, 32, "pad")
    assert tracemalloc.get_traced_memory()[1] < 12_000**2 // 20
    tracemalloc.stop()


def test_pad_fits_the_long_side_and_continues_the_border() -> None:
    stripes = np.zeros((32, 64, 3), np.uint8)
    stripes[:16] = 255
    stream = io.BytesIO()
    Image.fromarray(stripes).save(stream, "PNG")
    pixels = decode(stream.getvalue(), "1.png", 32, "pad")
    assert pixels.shape == (32, 32, 3)
    assert (pixels[:14] > 240).all()
    assert (pixels[-14:] < 15).all()


def test_a_photograph_is_turned_upright() -> None:
    exif = Image.Exif()
    exif[0x0112] = 6
    stream = io.BytesIO()
    Image.open(io.BytesIO(halves(32, 32))).save(stream, "PNG", exif=exif)
    pixels = decode(stream.getvalue(), "1.png", 32, "crop")
    assert tuple(pixels[0, 16]) == (255, 0, 0)
    assert tuple(pixels[-1, 16]) == (0, 0, 255)


def test_colours_become_those_of_srgb() -> None:
    pixels = decode(swapped("RGB"), "1.png", 32, "crop")
    assert np.abs(pixels.astype(int) - (40, 200, 90)).max() < 3
    assert (cut_boxes(swapped("RGB"), "1.png", [(0, 0, 32, 32)], 32)[0] == pixels).all()


def test_lightness_and_two_colours_become_srgb() -> None:
    stream = io.BytesIO()
    picture = Image.new("RGB", (32, 32), (40, 200, 90)).convert("LAB")
    picture.save(stream, "TIFF")
    assert picture.info["icc_profile"]
    pixels = cut_boxes(stream.getvalue(), "1.tif", [(0, 0, 32, 32)], 32)[0]
    assert np.abs(pixels.astype(int) - (40, 200, 90)).max() < 5


def test_a_profile_of_other_than_rgb_colours_changes_no_rgb_picture() -> None:
    stream, of_lab = io.BytesIO(), ImageCms.ImageCmsProfile(ImageCms.createProfile("LAB")).tobytes()
    Image.new("RGB", (32, 32), (220, 40, 0)).save(stream, "PNG", icc_profile=of_lab)
    assert (decode(stream.getvalue(), "1.png", 32, "crop") == (220, 40, 0)).all()


def test_a_damaged_colour_profile_is_refused() -> None:
    stream = io.BytesIO()
    Image.new("RGB", (32, 32)).save(stream, "PNG", icc_profile=b"no profile")
    with pytest.raises(DataError, match=r"^1\.png has a colour profile that cannot be used \(.*\); convert or remove"):
        decode(stream.getvalue(), "1.png", 32, "crop")


def test_a_transparent_colour_is_refused() -> None:
    stream = io.BytesIO()
    Image.new("RGB", (32, 32), (9, 9, 9)).save(stream, "PNG", transparency=(9, 9, 9))
    with pytest.raises(
        DataError, match=r"^1\.png has the colour mode RGB with a transparent colour; expected RGB; conv"
    ):
        decode(stream.getvalue(), "1.png", 32, "crop")


def test_a_gif_is_not_sent_to_a_command_that_passes_it_over() -> None:
    stream = io.BytesIO()
    Image.new("P", (32, 32)).save(stream, "GIF")
    with pytest.raises(DataError, match=r"^1\.gif has the colour mode P; expected RGB; convert it or remove it$"):
        decode(stream.getvalue(), "1.gif", 32, "crop")


@pytest.mark.parametrize("mode", ["L", "RGBA", "P", "1"])
def test_another_colour_mode_is_refused(mode: str) -> None:
    with pytest.raises(
        DataError, match=rf"car/7.png has the colour mode {mode}; expected RGB; .*`kato3d arrange` does"
    ):
        decode(picture(mode=mode), "car/7.png", 32, "crop")


@pytest.mark.parametrize("content", [b"", b"not a picture", noise(0)[:300], noise(0)[:-300]])
def test_an_unreadable_picture_is_refused(content: bytes) -> None:
    with pytest.raises(DataError, match=r"car/7.jpg cannot be read as a picture"):
        decode(content, "car/7.jpg", 32, "crop")


def test_a_picture_of_a_telephone_is_read_or_refused() -> None:
    stream = io.BytesIO()
    Image.fromarray(np.random.default_rng(0).integers(0, 256, (40, 60, 3), dtype=np.uint8)).save(stream, "HEIF")
    content = stream.getvalue()
    assert decode(content, "1.heic", 32, "crop").shape == (32, 32, 3)
    for kept in range(0, len(content) - 1, 97):
        with pytest.raises(DataError, match=r"1\.heic cannot be read as a picture"):
            decode(content[:kept], "1.heic", 32, "crop")


def test_a_picture_that_would_fill_the_memory_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 100)
    with pytest.raises(DataError, match=r"car/7.jpg is too large .* \(1024 pixels\) exceeds limit of 200 pixels; make"):
        decode(noise(0), "car/7.jpg", 32, "crop")


def test_a_large_picture_is_read_without_a_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 1000)
    with warnings.catch_warnings(record=True, action="always") as told:
        assert decode(noise(0), "car/7.jpg", 32, "crop").shape == (32, 32, 3)
    assert told == []


def test_a_picture_that_is_too_small_is_refused() -> None:
    with pytest.raises(DataError, match=r"7.png is 64x20 px; expected at least 32 px along the short side"):
        decode(picture(width=64, height=20), "7.png", 32, "crop")
    with pytest.raises(DataError, match=r"7.png is 31x20 px; expected at least 32 px along the long side"):
        decode(picture(width=31, height=20), "7.png", 32, "pad")


def test_exif_data_of_the_wrong_type_is_said() -> None:
    short, text = 3, 2
    tags = [(0x0112, short, 1, 6 << 16), (0x0128, text, 2, int.from_bytes(b"2\0\0\0"))]  # to be turned; a unit as text
    entries = b"".join(struct.pack(">HHII", *tag) for tag in tags)
    exif = b"Exif\0\0MM\0*" + struct.pack(">IH", 8, len(tags)) + entries + bytes(4)
    stream = io.BytesIO()
    Image.fromarray(np.zeros((64, 64, 3), np.uint8)).save(stream, "JPEG", exif=exif)
    with pytest.raises(DataError, match=r"1\.jpg cannot be read as a picture"):
        decode(stream.getvalue(), "1.jpg", 32, "crop")
