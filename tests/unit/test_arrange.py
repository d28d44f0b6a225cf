"""A folder of photographs becomes what `prepare_data` reads."""

import io
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from PIL.PngImagePlugin import PngInfo
from PIL.TiffImagePlugin import PHOTOMETRIC_INTERPRETATION

from pipeline.cli.__main__ import main
from pipeline.cli.arrange import LONGEST, arrange
from pipeline.datasets.folder import FolderConfig, read_folder
from pipeline.datasets.survey import survey
from pipeline.errors import DataError
from tests.picture_trees import noise, picture, swapped, write_folder


def test_every_tenth_photograph_is_for_testing(tmp_path: Path) -> None:
    photos = write_folder(tmp_path / "photos", {f"{number % 3}/{number:02}.jpg": noise(number) for number in range(21)})
    (photos / "notes.txt").write_text("no photograph")
    assert arrange(photos, "ship", tmp_path / "mine", 32) == (18, 3, [], {".txt": 1})
    pictures = list(read_folder(tmp_path / "mine", FolderConfig(32, "crop")))
    assert [sum(one.split == split for one in pictures) for split in ("train", "test")] == [18, 3]
    assert {one.category for one in pictures} == {"ship"}
    assert survey(tmp_path / "mine") == (tmp_path / "mine", "folder", {"ship"})


def test_a_table_says_which_photograph_each_picture_is_of(tmp_path: Path) -> None:
    names = ("b, c.jpg", os.fsdecode(b"sub/caf\xe9.jpg"), "a.jpg", "broken.jpg")
    files = {name: noise(number) for number, name in enumerate(names)} | {"broken.jpg": b""}
    arrange(write_folder(tmp_path / "photos", files), "ship", tmp_path / "mine", 32)
    assert (tmp_path / "mine/originals.csv").read_text(encoding="utf-8").splitlines() == [
        "picture,original",
        "test/ship/000000.jpg,a.jpg",
        'train/ship/000001.jpg,"b, c.jpg"',
        r"train/ship/000002.jpg,sub/caf\udce9.jpg",
    ]


def test_copies_of_a_file_are_left_out_so_that_none_is_in_both_splits(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = {"a.jpg": noise(1), "b.jpg": noise(1), "c.jpg": noise(2), "x/a.jpg": noise(1)}
    photos = write_folder(tmp_path / "photos", files)
    main(["arrange", str(photos), "--category", "ship", "--out", str(tmp_path / "mine")])
    said = capsys.readouterr().out.splitlines()
    assert said[:2] == [
        f"left out: {photos / name} is the same file as {photos / 'a.jpg'}" for name in ("b.jpg", "x/a.jpg")
    ]
    assert said[2].startswith("1 for training and 1 for testing")


def test_what_was_made_of_photographs_hides_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = ("reconstruct.json", "a.glb", "a_photograph.png", "a_texture.png", "sub/b_reconstruction.png")
    names = (*made, "x/a.jpg", "x/b.jpg", "c.jpg")
    photos = write_folder(tmp_path / "photos", {name: noise(number) for number, name in enumerate(names)})
    main(["arrange", str(photos), "--category", "ship", "--out", str(tmp_path / "mine")])
    assert capsys.readouterr().out.splitlines() == [
        "passed over: 1 with the ending '.glb'",
        "passed over: 1 with the ending '.json'",
        "passed over: 3 with the ending '.png' that `kato3d reconstruct` has written",
        f"2 for training and 1 for testing written to {tmp_path / 'mine'}, 0 left out",
        "fewer than 200 for training were not tried; 2,000 are good (docs/your-own-photos.md)",
    ]


def test_a_link_to_nothing_is_said(tmp_path: Path) -> None:
    photos = write_folder(tmp_path / "photos", {"a.jpg": noise(1), "b.jpg": noise(2)})
    (photos / "moved.jpg").symlink_to(tmp_path / "nothing.jpg")
    (photos / "turning.jpg").symlink_to(photos / "turning.jpg")
    found = arrange(photos, "ship", tmp_path / "mine", 32)
    assert (found.train, found.test) == (1, 1)
    for reason, name in zip(found.left_out, ("moved.jpg", "turning.jpg"), strict=True):
        assert reason.startswith(f"{photos / name} cannot be read as a picture")


@pytest.fixture(params=[signal.SIGTERM, signal.SIGHUP])
def number(request: pytest.FixtureRequest) -> Iterator[signal.Signals]:
    """Name a signal, which nobody has taken care of yet, and put things as they were in the end."""
    before = signal.signal(request.param, signal.SIG_DFL)
    yield request.param
    signal.signal(request.param, before)


def test_a_stopped_command_leaves_nothing_half_written(
    tmp_path: Path, number: signal.Signals, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    photos = write_folder(tmp_path / "photos", {"a.jpg": noise(1), "b.jpg": noise(2)})
    monkeypatch.setattr(Image.Image, "save", lambda *_, **__: signal.raise_signal(number))
    with pytest.raises(SystemExit) as caught:
        main(["arrange", str(photos), "--category", "ship", "--out", str(tmp_path / "mine")])
    assert caught.value.code == 128 + number
    assert "stopped; the same command goes on" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == [photos]
    assert signal.getsignal(number) == signal.SIG_DFL


def test_a_signal_that_is_ignored_stops_nothing(
    tmp_path: Path, number: signal.Signals, monkeypatch: pytest.MonkeyPatch
) -> None:
    photos, save = write_folder(tmp_path / "photos", {"a.jpg": noise(1), "b.jpg": noise(2)}), Image.Image.save

    def save_and_signal(picture: Image.Image, path: Path, **options: Any) -> None:
        signal.raise_signal(number)
        save(picture, path, **options)

    monkeypatch.setattr(Image.Image, "save", save_and_signal)
    signal.signal(number, signal.SIG_IGN)  # as nohup does
    main(["arrange", str(photos), "--category", "ship", "--out", str(tmp_path / "mine")])
    assert len(list((tmp_path / "mine").rglob("*.jpg"))) == 2


def test_hidden_files_are_no_photographs(tmp_path: Path) -> None:
    names = ("a.jpg", "b.jpg", ".thumbnails/a.jpg", "._a.jpg", "__MACOSX/b.jpg")
    photos = write_folder(
        tmp_path / "photos", {name: noise(number) for number, name in enumerate(names)} | {".DS_Store": b""}
    )
    assert arrange(photos, "ship", tmp_path / "mine", 32) == (1, 1, [], {})


def test_what_is_written_lies_outside_of_the_photographs(tmp_path: Path) -> None:
    photos = write_folder(tmp_path / "photos", {"a.jpg": noise(1), "b.jpg": noise(2)})
    with pytest.raises(DataError, match=r"mine is inside of .*photos; name a folder outside of it"):
        arrange(photos, "ship", photos / "mine", 32)


def test_a_least_side_below_one_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for side in ("0", "-3", "many"):
        with pytest.raises(SystemExit):
            main(["arrange", str(tmp_path), "--category", "ship", "--out", "mine", f"--least-side={side}"])
        assert f"'{side}' is no number of pixels; expected a whole number from 1" in capsys.readouterr().err


def test_photographs_become_upright_rgb_and_not_too_large(tmp_path: Path) -> None:
    lying = Image.new("RGB", (80, 40), "red")
    lying.getexif()[0x0112] = 6  # to be turned by a quarter
    stream = io.BytesIO()
    lying.save(stream, "JPEG", exif=lying.getexif())
    clear = io.BytesIO()
    Image.new("RGBA", (40, 40), (255, 0, 0, 0)).save(clear, "PNG")
    files = {
        "a.jpg": stream.getvalue(),
        "b.png": picture(mode="L"),
        "c.PNG": clear.getvalue(),
        "d.png": picture(width=2000, height=500),
        "e.png": picture(width=4000, height=100),
        "f.png": grey_of_16_bits(),
        "g.HEIC": picture_of_a_telephone(),
        "h.png": grey_of_16_bits(transparency=0),
        "i.tif": from_white_to_black(),
    }
    arrange(write_folder(tmp_path / "photos", files), "ship", tmp_path / "mine", 32)
    paths = sorted((tmp_path / "mine").rglob("*.jpg"), key=lambda path: path.name)
    written = [Image.open(io.BytesIO(path.read_bytes())) for path in paths]
    assert [image.mode for image in written] == ["RGB"] * 9
    sizes = [(40, 80), (32, 32), (40, 40), (LONGEST, LONGEST // 4), (1280, 32), (40, 40), (60, 40), (40, 40), (40, 40)]
    assert [image.size for image in written] == sizes
    assert np.asarray(written[2]).min() > 250
    assert abs(np.asarray(written[5]).mean() - 127.5) < 2
    assert abs(np.asarray(written[7]).mean() - 127.5) < 2
    assert np.asarray(written[7])[0, 0].min() > 200
    assert np.asarray(written[8])[0].min() > 200
    assert np.asarray(written[8])[-1].max() < 55


def picture_of_a_telephone() -> bytes:
    """Encode a picture as HEIC."""
    stream = io.BytesIO()
    Image.new("RGB", (60, 40), "green").save(stream, "HEIF")
    return stream.getvalue()


def grey_of_16_bits(transparency: int | None = None) -> bytes:
    """Encode a ramp from black to white, of which one value may be transparent."""
    ramp = np.linspace(0, 65535, 1600).round().astype(np.uint16).reshape(40, 40)
    stream = io.BytesIO()
    Image.fromarray(ramp).save(stream, "PNG", transparency=transparency)
    return stream.getvalue()


def from_white_to_black() -> bytes:
    """Encode a ramp of 16 bits in whose file 0 is white."""
    stream = io.BytesIO()
    Image.open(io.BytesIO(grey_of_16_bits())).save(stream, "TIFF", tiffinfo={PHOTOMETRIC_INTERPRETATION: 0})
    return stream.getvalue()


def of_32_bits() -> bytes:
    """Encode grey values beyond 16 bits."""
    stream = io.BytesIO()
    Image.fromarray(np.full((40, 40), 100_000, dtype=np.int32)).save(stream, "TIFF")
    return stream.getvalue()


def fractions() -> bytes:
    """Encode grey values between 0 and 1."""
    stream = io.BytesIO()
    Image.fromarray(np.full((40, 40), 0.5, dtype=np.float32)).save(stream, "TIFF")
    return stream.getvalue()


def test_colours_become_those_of_srgb(tmp_path: Path) -> None:
    files = {f"{name}.png": swapped(mode) for name, mode in (("a", "RGB"), ("b", "RGBA"), ("c", "P"))}
    arrange(write_folder(tmp_path / "photos", files), "ship", tmp_path / "mine", 32)
    for path in (tmp_path / "mine").rglob("*.jpg"):
        with Image.open(path) as written:
            assert np.abs(np.asarray(written).astype(int) - (40, 200, 90)).max() < 5


def test_what_was_written_about_a_photograph_is_left_behind(tmp_path: Path) -> None:
    stream, text = io.BytesIO(), PngInfo()
    text.add_text("comment", 70_000 * "x")  # more than a JPEG can hold
    Image.new("RGB", (40, 40)).save(stream, "PNG", pnginfo=text)
    arrange(
        write_folder(tmp_path / "photos", {"a.png": stream.getvalue(), "b.png": noise(1)}),
        "ship",
        tmp_path / "mine",
        32,
    )
    with Image.open(tmp_path / "mine/test/ship/000000.jpg") as written:
        assert "comment" not in written.info


def test_what_cannot_be_used_is_named_and_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = {f"{number}.jpg": noise(number) for number in range(3)}
    files |= {"broken.jpg": noise(9)[:300], "small.png": picture(width=31), "a.CR2": b"", "b.cr2": b""}
    files |= {"depth.tif": fractions(), "far.tif": of_32_bits(), "wide.png": picture(width=70_000)}
    files |= {"drawing.jpg": b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 40 40\n%%EndComments\n"}
    photos, out = write_folder(tmp_path / "photos", files), tmp_path / "mine"
    main(["arrange", str(photos), "--category", "ship", "--out", str(out)])
    said = capsys.readouterr().out.splitlines()
    assert said[0].startswith(f"left out: {photos / 'broken.jpg'} cannot be read as a picture")
    assert said[1:] == [
        f"left out: {photos / 'depth.tif'} has grey values that are fractions; expected 8 or 16 bits",
        f"left out: {photos / 'drawing.jpg'} cannot be read as a picture (unknown format); replace or remove it",
        f"left out: {photos / 'far.tif'} has grey values of 32 bits; expected 8 or 16 bits",
        f"left out: {photos / 'small.png'} is 31x32 px; expected at least 32 px along the short side",
        f"left out: {photos / 'wide.png'} would be written 70000x32 px; expected at most 65500 px",
        "passed over: 2 with the ending '.cr2'",
        f"2 for training and 1 for testing written to {out}, 6 left out",
        "fewer than 200 for training were not tried; 2,000 are good (docs/your-own-photos.md)",
    ]


def test_a_name_that_is_no_text_is_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    photos = write_folder(tmp_path / "photos", {f"{number}.jpg": noise(number) for number in range(3)})
    (photos / os.fsdecode(b"caf\xe9.jpg")).write_bytes(b"")
    main(["arrange", str(photos), "--category", "ship", "--out", str(tmp_path / "mine")])
    assert r"caf\udce9.jpg cannot be read as a picture" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("files", "category", "out", "message"),
    [
        ({"a.jpg": noise(0)}, "ship", "mine", "1 of the photographs can be used; expected at least 2"),
        (
            {"a.jpg": noise(0)[:300], "b.jpg": noise(0)},
            "ship",
            "mine",
            r"1 of the photographs can be used \(.*a\.jpg cannot be read as a picture",
        ),
        ({"a.txt": b""}, "ship", "mine", "holds no photographs"),
        ({"a.jpg": noise(0)}, "my ship", "mine", "the category is 'my ship'; expected a name of letters"),
        ({"a.jpg": noise(0)}, "café", "mine", "the category is 'café'; expected a name of letters"),
        ({"a.jpg": noise(0)}, "ship", "photos", "photos exists; name a folder that does not"),
        ({"a.jpg": noise(0)}, "ship", "link", "link exists; name a folder that does not"),
    ],
)
def test_what_is_wrong_is_one_sentence_and_leaves_nothing(
    tmp_path: Path, files: dict[str, bytes], category: str, out: str, message: str
) -> None:
    photos = write_folder(tmp_path / "photos", files)
    (tmp_path / "link").symlink_to("nothing")
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(DataError, match=message):
        arrange(photos, category, tmp_path / out, 32)
    assert sorted(tmp_path.rglob("*")) == before


def test_what_appears_meanwhile_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    photos, save = write_folder(tmp_path / "photos", {"a.jpg": noise(1), "b.jpg": noise(2)}), Image.Image.save

    def save_beside_another(picture: Image.Image, path: Path, **options: Any) -> None:
        (tmp_path / "mine").mkdir(exist_ok=True)
        save(picture, path, **options)

    monkeypatch.setattr(Image.Image, "save", save_beside_another)
    with pytest.raises(DataError, match="mine exists; name a folder that does not"):
        arrange(photos, "ship", tmp_path / "mine", 32)
    assert sorted(tmp_path.iterdir()) == [tmp_path / "mine", photos]
    assert not list((tmp_path / "mine").iterdir())


def test_two_commands_do_not_write_one_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    photos, save = write_folder(tmp_path / "photos", {"a.jpg": noise(1), "b.jpg": noise(2)}), Image.Image.save

    def save_beside_another(picture: Image.Image, path: Path, **options: Any) -> None:
        with pytest.raises(DataError, match=r"another process is writing .*mine; wait for it"):
            arrange(photos, "ship", tmp_path / "mine", 32)
        save(picture, path, **options)

    monkeypatch.setattr(Image.Image, "save", save_beside_another)
    assert arrange(photos, "ship", tmp_path / "mine", 32) == (1, 1, [], {})
    assert sorted(tmp_path.iterdir()) == [tmp_path / "mine", photos]


def test_an_archive_is_no_folder(tmp_path: Path) -> None:
    (tmp_path / "photos.zip").write_bytes(b"")
    with pytest.raises(DataError, match=r"photos\.zip is no folder; give one of photographs"):
        arrange(tmp_path / "photos.zip", "ship", tmp_path / "mine", 32)
