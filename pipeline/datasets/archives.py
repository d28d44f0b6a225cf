"""Read trees of files from a folder or an archive, without unpacking anything."""

import bz2
import gzip
import lzma
import os
import re
import tarfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path, PurePath, PurePosixPath
from typing import NamedTuple

from pipeline.errors import DataError

DAMAGE = (
    tarfile.TarError,
    zipfile.BadZipFile,
    lzma.LZMAError,
    zlib.error,
    EOFError,
    NotImplementedError,  # of a zip that asks for a version that there is not
    OSError,
    UnicodeDecodeError,
)
"""What the readers of archives raise when bytes are missing or wrong."""

_ZIP = (b"PK\x03\x04", b"PK\x05\x06")
"""How zips begin."""
_UNPACKERS = {
    rb"\x1f\x8b": gzip.open,
    rb"BZh[1-9](1AY&SY|\x17rE8P\x90)": bz2.open,
    rb"\xfd7zXZ\0": lzma.open,
}
"""What unpacks a packed tar, by how it begins. tarfile itself would read the first of several streams alone, and
not look at gzip's checksum."""
_UTF8 = 0x800
"""The flag of a zip's member whose name is text in UTF-8."""
_ENCRYPTED = 1
"""The flag of a zip's member that needs a password."""

_LONG_HEADERS = (
    tarfile.GNUTYPE_LONGNAME,
    tarfile.GNUTYPE_LONGLINK,
    tarfile.XHDTYPE,
    tarfile.XGLTYPE,
    tarfile.SOLARIS_XHDTYPE,
)
"""Kinds of a tar's headers that are followed by text of any length."""
_LONGEST_HEADER = 2**20
LARGEST = 2**30
"""Bytes of a file in an archive that are unpacked at most: a small archive can hold files larger than memory."""

Wanted = Callable[[PurePosixPath], bool]


class Entry(NamedTuple):
    """One file or folder of a tree."""

    name: PurePosixPath
    """Path inside the tree."""
    content: bytes | None
    """What the file holds; None for a folder."""


class _Member(tarfile.TarInfo):
    """A tar's header that takes the end of the file for damage, as a whole tar ends with a block of zeros.

    Names and attributes beyond a mebibyte are damage too: tarfile reads them whole, however small they were packed.
    """

    @classmethod
    def frombuf(cls, buf: bytes | bytearray, encoding: str, errors: str) -> tarfile.TarInfo:
        if not buf:
            raise EOFError("it has no end")
        header = super().frombuf(buf, encoding, errors)
        if header.type in _LONG_HEADERS and header.size > _LONGEST_HEADER:
            raise tarfile.ReadError("it has a name or attributes of more than a mebibyte")
        return header


def read_tree(path: Path, wanted: Wanted = lambda _: True) -> Iterator[Entry]:
    """Yield every folder and every wanted file of a folder, a zip or a tar (plain, gz, bz2, xz), as they are stored.

    Raises DataError if the source is missing, truncated or damaged, or holds an entry that points outside of it: an
    absolute path, a path with `..`, a device or a link; in a folder, linked files are read, other links refused. So it
    does for a wanted file in an archive that is larger than a gibibyte.
    Files that are not wanted, by their path inside the tree, are not read. One file's content is held at a time, and
    besides it the names of one folder, or the table of a zip; a tar takes no memory that grows with its length.
    """
    if path.is_dir():
        for entry in walk(path):
            name = PurePosixPath(entry.relative_to(path))
            if entry.is_dir():
                yield Entry(name, None)
            elif wanted(name):
                if not entry.is_file():
                    raise DataError(f"{entry} is a link to nothing or a device; mend or remove it")
                yield Entry(name, entry.read_bytes())
        return
    if not path.is_file():
        raise DataError(f"{path} does not exist; expected a folder or a tar or zip archive")
    try:
        read = _read_zip if _start(path).startswith(_ZIP) else _read_tar
        yield from read(path, wanted)
    except DAMAGE as error:
        raise DataError(
            f"{path} is not a complete tar or zip archive ({error}); name one, or a folder, or download it again"
        ) from None


def read_files(path: Path, wanted: Wanted) -> Iterator[tuple[PurePosixPath, bytes]]:
    """Yield path and content of every wanted file of `read_tree`."""
    for name, content in read_tree(path, wanted):
        if content is not None:
            yield name, content


def walk(folder: Path) -> Iterator[Path]:
    """Yield the paths of all files and folders below a folder, by name, but of hidden folders nothing that is in them.

    Raises DataError for a link to a folder.
    """
    with os.scandir(folder) as found:
        names = sorted(entry.name for entry in found)
    for name in names:
        path = folder / name
        yield path
        if path.is_dir() and not is_hidden(PurePath(name)):
            if path.is_symlink():
                raise DataError(f"{path} is a link to a folder; copy the folder there, or name it itself")
            yield from walk(path)


def is_hidden(name: PurePath) -> bool:
    """Tell whether a path inside a folder is of those that systems put there for themselves."""
    return any(part.startswith((".", "__MACOSX")) for part in name.parts)


def _read_zip(path: Path, wanted: Wanted) -> Iterator[Entry]:
    with zipfile.ZipFile(path) as archive:
        for member in archive.infolist():
            name = _inside(path, _name(member))
            if (member.external_attr >> 16) & 0o170000 == 0o120000:
                raise DataError(f"{path}: '{name}' is a link; expected only files and folders")
            if member.is_dir():
                yield Entry(name, None)
            elif wanted(name):
                _require_small(path, name, member.file_size)
                if member.flag_bits & _ENCRYPTED:
                    raise DataError(f"{path}: '{name}' is encrypted; unpack the archive and name the folder")
                try:
                    yield Entry(name, _unpack(archive, member))
                except NotImplementedError:
                    raise DataError(
                        f"{path}: '{name}' is packed in a way that cannot be read; unpack the archive and "
                        "name the folder"
                    ) from None


def _unpack(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> bytes:
    """Return what a zip's member holds, up to the size that the table says, whatever would follow.

    Raises NotImplementedError for ways of packing whose unpackers cannot stop there.
    """
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise NotImplementedError
    with archive.open(member) as stream:
        return stream.read(member.file_size)


def _name(member: zipfile.ZipInfo) -> str:
    """Return a member's name, which the `zip` of Linux writes as UTF-8 without saying so."""
    try:
        return member.filename if member.flag_bits & _UTF8 else member.filename.encode("cp437").decode()
    except UnicodeError:
        return member.filename


def _read_tar(path: Path, wanted: Wanted) -> Iterator[Entry]:
    with ExitStack() as opened:
        start = _start(path)
        unpack = next((unpack for form, unpack in _UNPACKERS.items() if re.match(form, start)), None)
        unpacked = unpack and opened.enter_context(unpack(path))
        form = "r|*" if unpacked is None else "r|"
        archive = opened.enter_context(tarfile.open(path, form, unpacked, tarinfo=_Member))
        for member in archive:
            # tarfile remembers every header it has met
            archive.members.clear()  # pyright: ignore[reportAttributeAccessIssue]
            name = _inside(path, member.name)
            if not (member.isfile() or member.isdir()):
                raise DataError(f"{path}: '{member.name}' is a link or a device; expected only files and folders")
            stream = archive.extractfile(member)
            if stream is None:
                yield Entry(name, None)
            elif wanted(name):
                _require_small(path, name, member.size)
                content = stream.read()
                if len(content) < member.size:
                    raise EOFError(f"'{name}' ends early")
                yield Entry(name, content)
        while unpacked and unpacked.read(2**20):
            pass  # the checksum stands at the end


def _start(path: Path) -> bytes:
    with path.open("rb") as stream:
        return stream.read(10)


def _require_small(path: Path, name: PurePosixPath, size: int) -> None:
    if size > LARGEST:
        found, most = (f"{bytes_ / 2**30:.1f} GiB" for bytes_ in (size, LARGEST))
        raise DataError(f"{path}: '{name}' has {found}; expected files of up to {most}; remove it")


def _inside(path: Path, name: str) -> PurePosixPath:
    inside = PurePosixPath(name.replace("\\", "/"))
    if inside.is_absolute() or ".." in inside.parts or re.match(r"[A-Za-z]:/", str(inside)):
        raise DataError(f"{path}: '{name}' points outside of the archive; expected only paths below its root")
    return inside
