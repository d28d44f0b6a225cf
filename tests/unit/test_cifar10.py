"""The official archive of CIFAR-10 is read without running anything that a pickle asks for."""

import hashlib
import io
import pickle  # noqa: TID251 - to write what the reader must refuse
import tarfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.datasets.cifar10 import Cifar10Config, load_plain, read_cifar10
from pipeline.errors import DataError
from tests.picture_trees import write_tar

NAMES = [b"airplane", b"automobile", b"bird", b"cat", b"deer", b"dog", b"frog", b"horse", b"ship", b"truck"]


def python2_pickle(value: dict[bytes, Any]) -> bytes:
    """Pickle as Python 2 did: byte strings as they are, and NumPy's old module name."""
    return b"\x80\x02" + Python2Pickler().dictionary(value) + b"."


class Python2Pickler:
    """Write the few opcodes that the official batches use."""

    def dictionary(self, value: dict[bytes, Any]) -> bytes:
        return b"}(" + b"".join(self.text(key) + self.value(item) for key, item in value.items()) + b"u"

    def text(self, value: bytes) -> bytes:
        return b"T" + len(value).to_bytes(4, "little") + value

    def value(self, value: Any) -> bytes:
        if isinstance(value, np.ndarray):
            return self.array(value)
        if isinstance(value, bytes):
            return self.text(value)
        if isinstance(value, int):
            return b"J" + value.to_bytes(4, "little", signed=True)
        return b"](" + b"".join(map(self.value, value)) + b"e"

    def array(self, value: np.ndarray) -> bytes:
        """Write _reconstruct(ndarray, (0,), 'b') and its state: version, shape, dtype, Fortran order, bytes."""
        made = b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(K\x00t" + self.text(b"b") + b"tR"
        dtype = b"cnumpy\ndtype\n(" + self.text(b"u1") + b"K\x00K\x01tR"
        dtype += b"(K\x03" + self.text(b"|") + b"NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb"
        shape = b"(" + b"".join(map(self.value, value.shape)) + b"t"
        return made + b"(K\x01" + shape + dtype + b"\x89" + self.text(value.tobytes()) + b"tb"


def batch(seed: int, width: int = 3072) -> dict[bytes, Any]:
    rows = np.random.default_rng(seed).integers(0, 256, (20, width), dtype=np.uint8)
    return {b"batch_label": b"some", b"labels": [index % 10 for index in range(20)], b"data": rows}


def archive(path: Path, **changes: bytes | None) -> Cifar10Config:
    """Write a small archive of the official layout and return the config that expects it."""
    files: dict[str, bytes | None] = {f"data_batch_{number}": python2_pickle(batch(number)) for number in range(1, 6)}
    files |= {"test_batch": python2_pickle(batch(6)), "batches.meta": python2_pickle({b"label_names": NAMES})}
    files = {f"cifar-10-batches-py/{name}": content for name, content in (files | changes).items()}
    write_tar(path, {name: content for name, content in files.items() if content is not None})
    return Cifar10Config(md5=hashlib.md5(path.read_bytes()).hexdigest())


def test_the_official_layout_is_read(tmp_path: Path) -> None:
    path = tmp_path / "cifar-10-python.tar.gz"
    dataset = read_cifar10(path, archive(path))
    assert {name: images.shape for name, images in dataset.images["train"].items()} == {
        name.decode(): (10, 32, 32, 3) for name in NAMES
    }
    automobile = batch(6)[b"data"][1].reshape(3, 32, 32)
    np.testing.assert_array_equal(dataset.images["test"]["automobile"][0], automobile.transpose(1, 2, 0))


def test_a_wrong_checksum_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "cifar-10-python.tar.gz"
    archive(path)
    with pytest.raises(
        DataError, match=r"has the md5 checksum [0-9a-f]{32}; expected c58f30108f718f92721af3b95e74349a"
    ):
        read_cifar10(path, Cifar10Config(md5="c58f30108f718f92721af3b95e74349a"))


def test_a_missing_archive_says_how_to_get_it(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"does not exist; fetch it with `dvc update"):
        read_cifar10(tmp_path / "cifar-10-python.tar.gz", Cifar10Config(md5=""))


def test_a_missing_batch_is_named(tmp_path: Path) -> None:
    path = tmp_path / "cifar-10-python.tar.gz"
    config = archive(path, data_batch_3=None)
    with pytest.raises(DataError, match=r"has no data_batch_3"):
        read_cifar10(path, config)


def test_rows_of_another_size_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "cifar-10-python.tar.gz"
    config = archive(path, test_batch=python2_pickle(batch(6, width=300)))
    with pytest.raises(DataError, match=r"rows of shape \(300,\), uint8; expected \(3072,\)"):
        read_cifar10(path, config)


class Payload:
    """Would write a file when unpickled."""

    def __init__(self, call: Callable[..., Any], *arguments: Any) -> None:
        self.call, self.arguments = call, arguments

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return self.call, self.arguments


def test_code_in_a_pickle_is_not_run(tmp_path: Path) -> None:
    target = tmp_path / "written"
    content = pickle.dumps({b"data": Payload(Path.touch, target)}, protocol=2)
    with pytest.raises(DataError, match=r"test_batch is not a pickle of plain arrays \(it names "):
        load_plain(content, "test_batch")
    assert not target.exists()
    with pytest.raises(DataError, match=r"it names (__builtin__|builtins)\.eval"):
        load_plain(pickle.dumps(Payload(eval, "1"), protocol=2), "test_batch")


@pytest.mark.parametrize("content", [b"", b"junk", python2_pickle(batch(0))[:2000], pickle.dumps([1], protocol=2)])
def test_a_damaged_batch_is_refused(content: bytes) -> None:
    with pytest.raises(DataError, match=r"test_batch (is not a pickle|holds a list)"):
        load_plain(content, "test_batch")


def test_a_truncated_archive_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "cifar-10-python.tar.gz"
    archive(path)
    path.write_bytes(path.read_bytes()[:-2000])
    with pytest.raises(DataError, match="not a complete"):
        read_cifar10(path, Cifar10Config(md5=hashlib.md5(path.read_bytes()).hexdigest()))


def test_the_archive_can_be_listed_by_tarfile(tmp_path: Path) -> None:
    path = tmp_path / "cifar-10-python.tar.gz"
    archive(path)
    with tarfile.open(fileobj=io.BytesIO(path.read_bytes())) as opened:
        assert len(opened.getnames()) == 7
