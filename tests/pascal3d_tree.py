"""A tiny PASCAL3D+ release: files in its own structure, for tests."""

import io
from typing import Any

import numpy as np
from PIL import Image
from scipy.io import savemat

VOC = "PASCAL/VOCdevkit/VOC2012/ImageSets/Main"
CAMERA = {"focal": 1.0, "px": 40.0, "py": 30.0, "viewport": 3000.0, "distance": 5.0}


def viewpoint(azimuth: float, elevation: float = 10.0, theta: float = -2.0, **changes: float) -> dict[str, float]:
    """Describe a camera, its coarse angles beside the fine ones."""
    coarse = {"azimuth_coarse": 30.0, "elevation_coarse": 0.0}
    return {**coarse, "azimuth": azimuth, "elevation": elevation, "theta": theta, **CAMERA, **changes}


def car(box: tuple[float, ...], view: dict[str, float] | None, **changes: Any) -> dict[str, Any]:
    """Annotate an object; `view` None leaves its viewpoint empty, as the release does where there is none."""
    fields = {"class": "car", "view": "", "bbox": np.array(box), "truncated": 0, "occluded": 0, "difficult": 0}
    fields |= {"anchors": np.zeros((0, 0)), "cad_index": 1}
    return fields | {"viewpoint": np.zeros((0, 0)) if view is None else view} | changes


def annotation(name: str, *objects: dict[str, Any]) -> bytes:
    """Write a picture's struct `record`."""
    listed = np.zeros((1, len(objects)), dtype=[(field, object) for field in objects[0]])
    for position, found in enumerate(objects):
        for field, value in found.items():
            listed[0, position][field] = value
    record = {"filename": name, "folder": "VOC2012", "imgname": name, "imgsize": np.array([80, 60, 3]), "segmented": 0}
    stream = io.BytesIO()
    savemat(stream, {"record": record | {"objects": listed, "source": {"database": "PASCAL3D+"}}}, do_compression=True)
    return stream.getvalue()


def photograph(mode: str = "RGB") -> bytes:
    """Draw a picture of 80 x 60 pixels whose red is the column and whose green is the row, times three."""
    columns, rows = np.meshgrid(3 * np.arange(80), 3 * np.arange(60))
    pixels = np.stack([columns, rows, 128 + 0 * rows], axis=2).astype(np.uint8)
    stream = io.BytesIO()
    Image.fromarray(pixels).convert(mode).save(stream, "JPEG", quality=95, subsampling=0)
    return stream.getvalue()


def release(**changes: bytes | None) -> dict[str, bytes]:
    """Return a release with one usable car in each of four pictures and unusable ones beside them.

    `changes` replaces files or, by None, removes them.
    """
    box = (11.0, 21.0, 50.4, 40.0)
    partly = [car(box, viewpoint(1.0), **{flag: 1}) for flag in ("truncated", "occluded", "difficult")]
    unseen = [car(box, None), car(box, viewpoint(1.0, distance=0.0)), car(box, viewpoint(1.0), **{"class": "bus"})]
    imagenet = {name: value for name, value in car(box, viewpoint(200.0)).items() if name != "difficult"}
    files: dict[str, bytes | None] = {
        "Annotations/car_pascal/2008_1.mat": annotation("2008_1.jpg", *partly, car(box, viewpoint(90.0)), *unseen),
        "Annotations/car_pascal/2008_2.mat": annotation("2008_2.jpg", *partly),
        "Annotations/car_pascal/2009_1.mat": annotation("2009_1.jpg", car((41.0, 1.0, 60.0, 60.0), viewpoint(355.0))),
        "Annotations/car_imagenet/n02_1.mat": annotation("n02_1.JPEG", imagenet),
        "Annotations/car_imagenet/n02_2.mat": annotation("n02_2.JPEG", imagenet | {"viewpoint": viewpoint(20.0)}),
        "Annotations/chair_pascal/2008_1.mat": b"another category",
        "Image_sets/car_imagenet_train.txt": b"n02_1\n",
        "Image_sets/car_imagenet_val.txt": b"n02_2\n",
        f"{VOC}/train.txt": b"2008_1\n2008_2\n2008_3\n",
        f"{VOC}/val.txt": b"2009_1\n2009_2\n",
        "Images/car_imagenet/n02_2.JPEG": photograph("L"),
    }
    files |= {f"Images/car_pascal/{name}.jpg": photograph() for name in ("2008_1", "2008_2", "2009_1")}
    files |= {"Images/car_imagenet/n02_1.JPEG": photograph(), "CAD/car.mat": b"not read"}
    return {name: content for name, content in (files | changes).items() if content is not None}
