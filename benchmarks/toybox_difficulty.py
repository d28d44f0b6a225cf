"""Compare the toybox with photographs: simple statistics, and how well colours alone find the object.

Run `python -m benchmarks.toybox_difficulty data/prepared/toybox data/truth/toybox [data/prepared/cifar10]
--out OUT.json --figure OUT.png`. Photographs are compared category by category under the names of CIFAR-10; the
figure shows the toybox alone.
"""

from argparse import ArgumentParser
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, UInt8

from pipeline.datasets.images import load_images
from pipeline.export.picture import enlarge, sheet, write_png
from pipeline.files import read_json, write_json

REAL_NAMES = {"aeroplane": "airplane", "car": "automobile", "horse": "horse"}
LUMA = np.array([0.299, 0.587, 0.114])


def statistics(pictures: UInt8[np.ndarray, "B H W 3"]) -> dict[str, float | list[float]]:
    """Measure means, spreads and edges of pictures in [0, 1]."""
    colors = pictures / 255.0
    luma = colors @ LUMA
    across, down = np.diff(luma, axis=2)[:, :-1], np.diff(luma, axis=1)[:, :, :-1]
    return {
        "mean_rgb": colors.mean(axis=(0, 1, 2)).round(3).tolist(),
        "deviation_rgb": colors.std(axis=(0, 1, 2)).round(3).tolist(),
        "deviation_within_a_picture": round(float(colors.std(axis=(1, 2)).mean()), 3),
        "saturation": round(float(np.ptp(colors, axis=-1).mean()), 3),
        "edge_density": round(float((np.hypot(across, down) > 0.1).mean()), 3),
        "share_with_constant_border": round(float((border(colors).std(axis=1).mean(axis=1) < 0.05).mean()), 3),
    }


def border(colors: Float[np.ndarray, "B H W 3"]) -> Float[np.ndarray, "B K 3"]:
    """Return the pixels along the four sides."""
    return np.concatenate([colors[:, 0], colors[:, -1], colors[:, :, 0], colors[:, :, -1]], axis=1)


def masks_by_color(pictures: UInt8[np.ndarray, "B H W 3"], masks: Bool[np.ndarray, "B H W"]) -> dict[str, float]:
    """Measure the mean IoU with the true masks of the best threshold on each channel, and of masks without a picture.

    A threshold is one for all pictures; the last entry lets every picture choose channel, threshold and side, which
    only the truth could tell.
    """
    colors = pictures / 255.0
    from_border = np.linalg.norm(colors - border(colors).mean(axis=1)[:, None, None], axis=-1)
    channels = {
        **dict(zip(("red", "green", "blue"), np.moveaxis(colors, -1, 0), strict=True)),
        "luma": colors @ LUMA,
        "saturation": np.ptp(colors, axis=-1),
        "distance_from_border_color": from_border,
    }
    oracle = np.zeros(len(pictures))
    figures = {"whole_picture": mean_iou(np.ones_like(masks), masks)}
    average = masks.mean(axis=0)
    figures["best_constant_mask"] = max(
        mean_iou(np.broadcast_to(average > level, masks.shape), masks) for level in np.linspace(0.2, 0.8, 13)
    )
    for name, channel in channels.items():
        chosen = [side * channel > side * level for level in np.linspace(0.03, 0.97, 32) for side in (1, -1)]
        scores = np.stack([iou(each, masks) for each in chosen])
        figures[name] = round(float(scores.mean(axis=1).max()), 3)
        oracle = np.maximum(oracle, scores.max(axis=0))
    return figures | {"best_for_each_picture": round(float(oracle.mean()), 3)}


def iou(first: Bool[np.ndarray, "B H W"], second: Bool[np.ndarray, "B H W"]) -> Float[np.ndarray, "B"]:
    """Return intersection over union picture by picture."""
    return (first & second).sum(axis=(1, 2)) / np.maximum((first | second).sum(axis=(1, 2)), 1)


def mean_iou(first: Bool[np.ndarray, "B H W"], second: Bool[np.ndarray, "B H W"]) -> float:
    """Return the mean intersection over union."""
    return round(float(iou(first, second).mean()), 3)


def main() -> None:
    """Write the comparison of the test splits as JSON and the contact sheet as PNG."""
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("toybox", type=Path)
    parser.add_argument("truth", type=Path)
    parser.add_argument("photographs", type=Path, nargs="?")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--figure", type=Path, required=True)
    arguments = parser.parse_args()
    figures, rows = {}, {}
    for category in read_json(arguments.truth / "index.json"):
        pictures = np.load(arguments.toybox / "test" / f"{category}.npy")
        with np.load(arguments.truth / "test" / f"{category}.npz") as truth:
            figures[category] = {"masks": masks_by_color(pictures, truth["masks"].astype(bool))}
        figures[category]["toybox"] = statistics(pictures)
        if arguments.photographs and category in REAL_NAMES:
            photographs = np.load(arguments.photographs / "test" / f"{REAL_NAMES[category]}.npy")
            figures[category]["photographs"] = statistics(photographs)
        shown = load_images(arguments.toybox / "test" / f"{category}.npy")[:48].float() / 255
        rows |= {f"{category}, row {number}": enlarge(row, 2) for number, row in enumerate(shown.split(16), 1)}
    write_json(arguments.out, figures)
    write_png(arguments.figure, sheet(rows))


if __name__ == "__main__":
    main()
