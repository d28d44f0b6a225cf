"""Small datasets of pictures, whole or broken, for the tests of prepare_data."""

import io
import tarfile
import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from PIL import Image, ImageCms


def picture(color: tuple[int, int, int] = (200, 30, 30), width: int = 32, height: int = 32, mode: str = "RGB") -> bytes:
    """Encode a picture of one colour as PNG."""
    stream = io.BytesIO()
    Image.new("RGB", (width, height), color).convert(mode).save(stream, "PNG")
    return stream.getvalue()


def swapped(mode: str) -> bytes:
    """Encode a picture of (40, 200, 90) in sRGB as PNG, with a colour profile in which red and green are swapped."""
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    profile = profile.replace(b"rXYZ", b"?XYZ").replace(b"gXYZ", b"rXYZ").replace(b"?XYZ", b"gXYZ")
    flat, stream = Image.new("RGB", (32, 32), (200, 40, 90)), io.BytesIO()
    (flat.quantize(2) if mode == "P" else flat.convert(mode)).save(stream, "PNG", icc_profile=profile)
    return stream.getvalue()


def noise(seed: int) -> bytes:
    """Encode a picture that does not compress."""
    stream = io.BytesIO()
    pixels = np.random.default_rng(seed).integers(0, 256, (32, 32, 3), dtype=np.uint8)
    Image.fromarray(pixels).save(stream, "JPEG", quality=95)
    return stream.getvalue()


def tree(**changes: bytes | None) -> dict[str, bytes]:
    """Return two categories of two pictures a split; `changes` replaces files or, by None, removes them."""
    files: dict[str, bytes | None] = {
        f"{split}/{category}/{number}.jpg": noise(10 * number + len(split) + len(category))
        for split in ("train", "test")
        for category in ("car", "horse")
        for number in (1, 2)
    }
    return {name: content for name, content in (files | changes).items() if content is not None}


def write_folder(path: Path, files: Mapping[str, bytes]) -> Path:
    for name, content in files.items():
        (path / name).parent.mkdir(parents=True, exist_ok=True)
        (path / name).write_bytes(content)
    return path


def write_tar(path: Path, files: Mapping[str, bytes], links: Mapping[str, str] | None = None) -> Path:
    compression = path.suffix.removeprefix(".")
    with tarfile.open(path, "w" if compression == "tar" else f"w:{compression}") as archive:  # pyright: ignore[reportArgumentType, reportCallIssue]
        for name, content in files.items():
            member = tarfile.TarInfo(name)
            member.size = len(content)
            archive.addfile(member, io.BytesIO(content))
        for name, target in (links or {}).items():
            member = tarfile.TarInfo(name)
            member.type, member.linkname = tarfile.SYMTYPE, target
            archive.addfile(member)
    return path


def write_zip(path: Path, files: Mapping[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return path


def empty_pictures(*categories: str) -> dict[str, bytes]:
    """Return a tree of files that are named as pictures and hold nothing."""
    return {f"{split}/{category}/1.jpg": b"" for split in ("train", "test") for category in categories}
