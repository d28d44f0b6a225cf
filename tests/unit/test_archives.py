"""Folders and archives are read alike, and nothing outside of them is reachable."""

import bz2
import gzip
import lzma
import tarfile
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path, PurePosixPath

import pytest

from pipeline.datasets import archives
from pipeline.datasets.archives import read_files, read_tree
from pipeline.errors import DataError
from pipeline.seeding import numpy_generator
from tests.picture_trees import tree, write_folder, write_tar, write_zip


def contents(path: Path) -> dict[str, bytes]:
    return {str(name): content for name, content in read_tree(path) if content is not None}


def test_every_form_holds_the_same(tmp_path: Path) -> None:
    files = tree()
    assert contents(write_folder(tmp_path / "folder", files)) == files
    assert contents(write_zip(tmp_path / "pictures.zip", files)) == files
    for ending in ("tar", "tar.gz", "tar.xz", "tar.bz2"):
        assert contents(write_tar(tmp_path / f"pictures.{ending}", files)) == files


@pytest.mark.parametrize("compress", [gzip.compress, bz2.compress, lzma.compress])
def test_a_tar_may_be_packed_in_several_streams(tmp_path: Path, compress: Callable[[bytes], bytes]) -> None:
    whole = write_tar(tmp_path / "whole.tar", tree()).read_bytes()
    streams = [compress(whole[start : start + 5000]) for start in range(0, len(whole), 5000)]
    (tmp_path / "packed").write_bytes(b"".join(streams))
    assert contents(tmp_path / "packed") == tree()
    (tmp_path / "packed").write_bytes(b"".join(streams[:2]))
    with pytest.raises(DataError, match="packed is not a complete tar or zip archive"):
        contents(tmp_path / "packed")


def test_names_in_a_zip_may_be_utf8_without_a_word_of_it(tmp_path: Path) -> None:
    content = write_zip(tmp_path / "pictures.zip", {"train/bateau/été.jpg": b"x"}).read_bytes()
    for start, flags in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        place = content.index(start) + flags
        assert content[place + 1] & 8
        content = content[: place + 1] + b"\0" + content[place + 2 :]  # as Info-ZIP writes them
    (tmp_path / "linux.zip").write_bytes(content)
    assert contents(tmp_path / "linux.zip") == {"train/bateau/été.jpg": b"x"}
    flagged = {"train/bateau/├⌐.jpg": b"x"}  # which would be another name without the flag
    assert contents(write_zip(tmp_path / "flagged.zip", flagged)) == flagged
    dos = content.replace("été".encode(), "été".encode("cp437") + b"12")
    (tmp_path / "dos.zip").write_bytes(dos)
    assert contents(tmp_path / "dos.zip") == {"train/bateau/été12.jpg": b"x"}


@pytest.mark.parametrize("write", [write_folder, write_tar])
def test_a_longer_tree_takes_hardly_more_memory(
    tmp_path: Path, write: Callable[[Path, dict[str, bytes]], Path]
) -> None:
    peaks = []
    for count in (100, 2000):
        files = {f"train/car/{number}.jpg": b"x" for number in range(count)}
        source = write(tmp_path / f"{count}.tar", files)
        known = [PurePosixPath(name) for name in files]  # parts of paths stand in one table, which grows by doubling
        tracemalloc.start()
        assert sum(content is not None for _, content in read_tree(source)) == len(known)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] - peaks[0] < 2000 * 150  # bytes a file: its name at most


def test_what_lies_in_hidden_folders_is_not_looked_at(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "folder", tree() | {".venv/bin/python": b"x", "__MACOSX/1.jpg": b"x"})
    (folder / ".venv/lib64").symlink_to(folder)
    assert contents(folder) == tree()


def test_a_tar_may_begin_with_any_name(tmp_path: Path) -> None:
    for name in ("PKW", "BZhang", "BZh9"):
        files = {f"{name}/1.jpg": b"x"}
        assert contents(write_tar(tmp_path / "cars.tar", files)) == files


def test_what_is_not_wanted_is_left_out(tmp_path: Path) -> None:
    sources = [write_folder(tmp_path / "folder", tree()), write_zip(tmp_path / "pictures.zip", tree())]
    for source in (*sources, write_tar(tmp_path / "pictures.tar.gz", tree())):
        wanted = [str(name) for name, _ in read_files(source, lambda name: name.match("test/car/*.jpg"))]
        assert sorted(wanted) == ["test/car/1.jpg", "test/car/2.jpg"]


@pytest.mark.parametrize("ending", ["tar", "tar.gz", "tar.xz", "zip"])
@pytest.mark.parametrize("share", [0.1, 0.5, 0.65])
def test_a_truncated_archive_is_refused(tmp_path: Path, ending: str, share: float) -> None:
    path = tmp_path / f"pictures.{ending}"
    (write_zip if ending == "zip" else write_tar)(path, tree())
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(DataError, match=f"{path.name} is not a complete tar or zip archive"):
        contents(path)


def test_an_encrypted_zip_is_refused(tmp_path: Path) -> None:
    content = bytearray(write_zip(tmp_path / "pictures.zip", {"train/car/1.jpg": b"x"}).read_bytes())
    content[content.index(b"PK\x01\x02") + 8] |= 1  # the flag, in the table at the end
    (tmp_path / "locked.zip").write_bytes(content)
    with pytest.raises(DataError, match=r"'train/car/1\.jpg' is encrypted; unpack the archive and name the folder"):
        contents(tmp_path / "locked.zip")


@pytest.mark.parametrize("write", [write_zip, write_tar])
def test_a_file_that_would_fill_memory_is_refused_if_it_is_wanted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, write: Callable[[Path, dict[str, bytes]], Path]
) -> None:
    monkeypatch.setattr(archives, "LARGEST", 2**16)
    source = write(tmp_path / "pictures.tar", {"train/car/1.jpg": bytes(2**16), "train/car/2.jpg": bytes(2**17)})
    assert [len(content or b"") for _, content in read_tree(source, lambda name: name.stem == "1")] == [2**16]
    with pytest.raises(DataError, match=r"'train/car/2\.jpg' has 0\.0 GiB; expected files of up to .*; remove it"):
        contents(source)


def _peak(path: Path) -> int:
    """Return the most bytes that are held until an archive is refused as damaged."""
    tracemalloc.start()
    with pytest.raises(DataError, match="not a complete tar or zip archive"):
        contents(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


def test_a_zip_that_says_less_than_it_holds_takes_no_more_memory(tmp_path: Path) -> None:
    path = tmp_path / "pictures.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("train/car/1.jpg", bytes(2**25))
    content = bytearray(path.read_bytes())
    size = content.index(b"PK\x01\x02") + 24
    content[size : size + 4] = (10).to_bytes(4, "little")
    path.write_bytes(content)
    assert _peak(path) < 2**21


@pytest.mark.parametrize("kind", [tarfile.GNUTYPE_LONGNAME, tarfile.GNUTYPE_LONGLINK, tarfile.XHDTYPE, tarfile.XGLTYPE])
def test_a_name_that_would_fill_memory_is_refused(tmp_path: Path, kind: bytes) -> None:
    header = tarfile.TarInfo("././@LongLink")
    header.type, header.size = kind, 2**25
    (tmp_path / "pictures.tar.gz").write_bytes(gzip.compress(header.tobuf(tarfile.GNU_FORMAT) + bytes(2**25)))
    assert _peak(tmp_path / "pictures.tar.gz") < 2**21


@pytest.mark.parametrize("form", [tarfile.GNU_FORMAT, tarfile.PAX_FORMAT])
def test_a_name_may_be_longer_than_a_header(tmp_path: Path, form: int) -> None:
    name = "train/car/" + 50 * "long/" + "1.jpg"
    with tarfile.open(tmp_path / "pictures.tar", "w", format=form) as archive:
        archive.addfile(tarfile.TarInfo(name))
    assert contents(tmp_path / "pictures.tar") == {name: b""}


@pytest.mark.parametrize("method", [b"\x09\x00", b"\x0c\x00"], ids=["deflate64", "bzip2"])
def test_a_zip_that_is_packed_in_another_way_is_named(tmp_path: Path, method: bytes) -> None:
    content = bytearray(write_zip(tmp_path / "pictures.zip", {"train/car/1.jpg": b"x"}).read_bytes())
    table = content.index(b"PK\x01\x02")
    content[8:10] = content[table + 10 : table + 12] = method
    (tmp_path / "other.zip").write_bytes(content)
    with pytest.raises(DataError, match=r"'train/car/1\.jpg' is packed in a way that cannot be read; unpack"):
        contents(tmp_path / "other.zip")


@pytest.mark.parametrize("ending", ["tar.gz", "tar.xz", "tar.bz2", "zip"])
def test_a_flipped_bit_in_a_picture_is_noticed(tmp_path: Path, ending: str) -> None:
    files = {"train/car/1.jpg": numpy_generator(0, "picture").bytes(20_000)}  # as incompressible as a picture
    path = (write_zip if ending == "zip" else write_tar)(tmp_path / f"pictures.{ending}", files)
    content = bytearray(path.read_bytes())
    content[10_000] ^= 1
    path.write_bytes(content)
    with pytest.raises(DataError, match="not a complete"):
        contents(path)


def test_a_name_of_a_zip_that_is_no_text_is_noticed(tmp_path: Path) -> None:
    path = write_zip(tmp_path / "pictures.zip", {"train/müll/1.jpg": b"x"})
    path.write_bytes(path.read_bytes().replace("ü".encode(), b"\xff\xff"))
    with pytest.raises(DataError, match="not a complete"):
        contents(path)


def test_a_tar_that_ends_with_a_zip_is_a_tar(tmp_path: Path) -> None:
    inner = write_zip(tmp_path / "labels.zip", {"notes.txt": b"x"}).read_bytes()
    assert set(contents(write_tar(tmp_path / "pictures.tar", {**tree(), "z/labels.zip": inner}))) > set(tree())


@pytest.mark.parametrize(
    "name", ["../outside.jpg", "/etc/passwd", "train/../../outside.jpg", "C:\\pictures\\1.jpg", "..\\1.jpg"]
)
def test_a_path_that_leaves_the_archive_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(DataError, match="points outside of the archive"):
        contents(write_tar(tmp_path / "pictures.tar", {name: b"x"}))
    with pytest.raises(DataError, match="points outside of the archive"):
        contents(write_zip(tmp_path / "pictures.zip", {name: b"x"}))


def test_a_colon_in_a_name_is_no_drive(tmp_path: Path) -> None:
    assert "a:b/1.jpg" in contents(write_tar(tmp_path / "pictures.tar", {"a:b/1.jpg": b"x"}))


def test_a_link_to_a_folder_is_refused_and_a_linked_file_is_read(tmp_path: Path) -> None:
    write_folder(tmp_path / "cars", {"1.jpg": b"one"})
    (tmp_path / "tree/train").mkdir(parents=True)
    (tmp_path / "tree/2.jpg").symlink_to(tmp_path / "cars/1.jpg")
    assert [content for _, content in read_tree(tmp_path / "tree")] == [b"one", None]
    (tmp_path / "tree/train/car").symlink_to(tmp_path / "cars")
    with pytest.raises(DataError, match=r"train/car is a link to a folder; copy the folder there"):
        list(read_tree(tmp_path / "tree"))


def test_a_link_to_nothing_is_refused(tmp_path: Path) -> None:
    (tmp_path / "1.jpg").symlink_to(tmp_path / "gone.jpg")
    with pytest.raises(DataError, match=r"1\.jpg is a link to nothing or a device; mend or remove it"):
        list(read_tree(tmp_path))
    assert list(read_tree(tmp_path, lambda name: name.suffix == ".png")) == []


def test_a_link_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"'train/car/1.jpg' is a link"):
        contents(write_tar(tmp_path / "pictures.tar", {}, {"train/car/1.jpg": "/etc/passwd"}))
    link = zipfile.ZipInfo("train/car/1.jpg")
    link.external_attr = 0o120777 << 16
    with zipfile.ZipFile(tmp_path / "pictures.zip", "w") as archive:
        archive.writestr(link, "/etc/passwd")
    with pytest.raises(DataError, match=r"'train/car/1.jpg' is a link"):
        contents(tmp_path / "pictures.zip")


def test_a_missing_source_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"pictures.tar does not exist"):
        contents(tmp_path / "pictures.tar")


def test_folders_are_entries_too(tmp_path: Path) -> None:
    (tmp_path / "train" / "car").mkdir(parents=True)
    assert [entry.name for entry in read_tree(tmp_path)] == [PurePosixPath("train"), PurePosixPath("train/car")]


def test_a_zip_of_a_version_that_there_is_not_is_one_sentence(tmp_path: Path) -> None:
    path = write_zip(tmp_path / "a.zip", {"train/car/1.jpg": b""})
    content = bytearray(path.read_bytes())
    content[content.index(b"PK\x01\x02") + 6] = 200
    path.write_bytes(content)
    with pytest.raises(DataError, match=r"a\.zip is not a complete tar or zip archive \(zip file version 20\.0\)"):
        list(read_tree(path))
