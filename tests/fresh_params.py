"""The parameters of a new checkout, whatever its user has turned on since."""

from functools import cache
from io import BytesIO
from pathlib import Path

from pipeline.rows.params_file import round_trip_yaml

ROOT = Path(__file__).parents[1]
RUN = {
    "row": "toybox-car",
    "size": "laptop",
    "ablation": "none",
    "seed": 0,
    "dataset": "toybox",
    "category": "car",
    "features": "toybox-laptop",
}
ON = {
    "datasets": {"toybox": {"kind": "toybox", "source": "pipeline/datasets/toybox"}},
    "features": {
        "toybox-laptop": {
            "dataset": "toybox",
            "size": "laptop",
            "seed": 0,
            "weights": "data/raw/wide_resnet_16_2_cifar10.safetensors",
        }
    },
    "base_shapes": {"toybox-car": {**RUN, "chosen": "score"}},
    "runs": {"toybox-car": {**RUN, "base_shape": "toybox-car"}},
    "hologan": {},
    "colmap": {},
    "pretrained": {},
}


def write_fresh_params(path: Path) -> Path:
    """Write the project's parameters with the toybox car alone turned on."""
    path.write_bytes(_fresh_params())
    return path


@cache
def _fresh_params() -> bytes:
    yaml, text = round_trip_yaml(), BytesIO()
    document = yaml.load(ROOT / "params.yaml")
    for section, entries in ON.items():
        document[section].clear()
        document[section].update(entries)
    yaml.dump(document, text)
    return text.getvalue()
