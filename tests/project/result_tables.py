"""Keep the tables of README.md and docs/ equal to results/metrics, as git would commit those now.

`python -m tests.project.result_tables` rewrites them. A page holds a table between `<!-- table: NAME -->` and
`<!-- end of table -->`. Runs that differ in their seed alone are one row: the mean and the standard deviation over the
seeds, or one seed's value and its standard error.
"""

import re
import statistics
import subprocess
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from pipeline.evaluation.tables import read_table
from pipeline.export.runs_page import Cell, MeasuredRun
from pipeline.files import read_json
from tests.project.import_closure import ROOT

SIDES = ("front", "left", "rear", "right")
PAGES = ["README.md", "data/README.md", *sorted(str(path.relative_to(ROOT)) for path in ROOT.glob("docs/**/*.md"))]
MARKED = re.compile(r"(?<=<!-- table: )([\w-]+)( -->\n).*?(?=<!-- end of table -->)", re.DOTALL)


class Table(NamedTuple):
    """What a table shows of which runs.

    Attributes:
        folder: where the runs' files are, below results/metrics.
        runs: pattern of the names of its runs, without their seeds.
        columns: heading and dotted key of each figure; runs without the first one are left out.
    """

    folder: str
    runs: str
    columns: dict[str, str]

    def rows(self, results: Path) -> Iterator[list[str]]:
        """Yield the heading and one row an experiment."""
        yield ["run", "seeds", "n", *self.columns]
        first, *_ = self.columns.values()
        for name, runs in sorted(self._seeds(results).items()):
            if first in runs[0]:
                counts = sorted({str(run[first]["n"]) for run in runs if first in run})
                cells = [_cell([run[key] for run in runs if key in run]) for key in self.columns.values()]
                yield [f"`{name}`", str(len(runs)), ", ".join(counts), *cells]

    def _seeds(self, results: Path) -> dict[str, list[Mapping[str, Cell]]]:
        seeds: defaultdict[str, list[Mapping[str, Cell]]] = defaultdict(list)
        for path in sorted((results / "metrics" / self.folder).glob("*.json")):
            run = MeasuredRun(path.stem, None, read_json(path))
            if re.fullmatch(self.runs, run.experiment):
                seeds[run.experiment].append(run.by_name())
        return seeds


class Confusion(NamedTuple):
    """Which sides of the object test pictures show and which are read off them, over all seeds of one experiment.

    A side is the quarter of the azimuths around it.
    """

    experiment: str
    azimuth: str

    def rows(self, results: Path) -> Iterator[list[str]]:
        """Yield the heading and one row a true side."""
        yield ["true side", "n", *(f"read as {side}" for side in SIDES)]
        counts: Counter[tuple[int, int]] = Counter()
        for path in results.glob(f"tables/{self.experiment}*.csv"):
            if MeasuredRun(path.stem, None, {}).experiment == self.experiment:
                table = read_table(path)
                counts.update(zip(_sides(table["truth_azimuth"]), _sides(table[self.azimuth]), strict=True))
        for true, side in enumerate(SIDES):
            total = sum(counts[true, read] for read in range(4))
            yield [side, str(total), *(f"{counts[true, read] / max(total, 1):.2f}" for read in range(4))]


def _sides(degrees: list[str]) -> list[int]:
    return [round(float(azimuth) / 90) % 4 for azimuth in degrees]


WHOLE = r"(?!.*(no-|fixed-base|single-stage|longer|sharper|-200-|-500-)).*"
"""Runs of all photographs, without an ablation, and baselines."""
ABLATIONS = r"toybox-car(-fixed-base|-no-(additions|ends|exploration|first-poses|view-prior)|-single-stage.*)?"
WHOLE_CHAIN = {
    "acc_pi/6 predicted": "pose.test.acc_pi6",
    "fine-tuned": "pose.test_tuned.acc_pi6",
    "recorded": "pose.train.acc_pi6",
    "shape IoU": "shape.test.voxel_iou",
    "mask IoU": "shape.test.mask_iou",
    "fine-tuned mask IoU": "shape.test_tuned.mask_iou",
    "feature distance": "reconstruction.predicted.feature_distance",
    "fine-tuned distance": "reconstruction.tuned.feature_distance",
}
IN_SHORT = ("acc_pi/6 predicted", "fine-tuned", "shape IoU", "mask IoU", "fine-tuned mask IoU")
WHOLE_CHAIN_IN_SHORT = {heading: WHOLE_CHAIN[heading] for heading in IN_SHORT}
CONSISTENCY = {
    "azimuths read within 30°": "multiview.acc_pi6",
    "error, °": "multiview.error_degrees",
    "by its own network": "multiview.own_network.acc_pi6",
    "identity drift": "multiview.identity_drift",
    "drift of different objects": "multiview.chance.identity_drift",
}
CONFUSED = ("toybox-car", "toybox-horse", "toybox-aeroplane", "toybox-chair", "stanford-car", "stanford-car-no-ends")
TABLES: dict[str, Table | Confusion] = {
    "viewpoints": Table(
        "",
        WHOLE,
        {
            "predicted": "pose.test.acc_pi6",
            "fine-tuned": "pose.test_tuned.acc_pi6",
            "recorded in training": "pose.train.acc_pi6",
            "best constant": "pose.constant.acc_pi6",
            "chance": "pose.chance.acc_pi6",
            "turned by 180°": "pose.test.flipped",
            "median error, °": "pose.test.median_error_degrees",
        },
    ),
    "mistakes": Table(
        "",
        WHOLE,
        {
            "turned by 180°": "pose.test.flipped",
            "mirrored": "pose.test.mirrored",
            "front and rear swapped": "pose.test.front_back",
            "other": "pose.test.other",
            "nearest side": "pose.test.seen_side",
            "lengthwise or from a side": "pose.test.front_or_side",
            "recorded: turned": "pose.train.flipped",
            "mirrored, recorded": "pose.train.mirrored",
            "median error recorded, °": "pose.train.median_error_degrees",
        },
    ),
    "shapes": Table(
        "",
        WHOLE,
        {
            "base shape": "shape.base.voxel_iou",
            "after full training": "shape.final_base.voxel_iou",
            "predicted": "shape.test.voxel_iou",
            "shapes differ by": "vertex_deviation.predicted",
            "correlation of widths": "shape.test.width_correlation",
            "of heights": "shape.test.height_correlation",
            "best constant shape": "shape.constant.voxel_iou",
            "masks predicted": "shape.test.mask_iou",
            "masks fine-tuned": "shape.test_tuned.mask_iou",
            "best constant mask": "shape.constant.mask_iou",
        },
    ),
    "reconstructions": Table(
        "",
        WHOLE,
        {
            "predicted": "reconstruction.predicted.feature_distance",
            "fine-tuned": "reconstruction.tuned.feature_distance",
            "lowered by fine-tuning": "reconstruction.improved",
            "retrieved by colours": "reconstruction.retrieved.feature_distance",
        },
    ),
    "consistency": Table("", WHOLE, CONSISTENCY),
    "consistency-of-all": Table("", r".*", CONSISTENCY),
    "colmap": Table(
        "",
        r".*-colmap",
        {
            "features a picture": "colmap.features",
            "verified pairs": "colmap.verified_pairs",
            "registered pictures": "colmap.registered",
        },
    ),
    "base-shape-ablations": Table("evaluate_base_shape", r"toybox-car.*", {"base-shape IoU": "voxel_iou"}),
    "ablations": Table("", ABLATIONS, WHOLE_CHAIN),
    "ablations-in-short": Table("", ABLATIONS, WHOLE_CHAIN_IN_SHORT),
    "ablations-stanford-car": Table(
        "",
        r"stanford-car(-no-.*)?",
        {
            "acc_pi/6 predicted": "pose.test.acc_pi6",
            "fine-tuned": "pose.test_tuned.acc_pi6",
            "recorded": "pose.train.acc_pi6",
            "turned by 180°": "pose.test.flipped",
            "median error, °": "pose.test.median_error_degrees",
            "feature distance": "reconstruction.predicted.feature_distance",
            "fine-tuned distance": "reconstruction.tuned.feature_distance",
        },
    ),
    "longer": Table(
        "",
        r"(toybox-car|toybox-chair|stanford-car|cifar10-automobile|cifar10-horse|mine-ship)(-longer|-no-copying-cost)?",
        {
            "feature distance": "reconstruction.predicted.feature_distance",
            "fine-tuned": "reconstruction.tuned.feature_distance",
            "SSIM": "reconstruction.predicted.ssim",
            "SSIM fine-tuned": "reconstruction.tuned.ssim",
            "views right": "pose.test.acc_pi6",
            "shape IoU": "shape.test.voxel_iou",
            "mask IoU": "shape.test.mask_iou",
        },
    ),
    "sharper": Table(
        "",
        r"(toybox-car|stanford-car)-no-copying-cost|toybox-horse|toybox64-(car|horse)-sharper|stanford64-car-sharper.*",
        {
            "views right": "pose.test.acc_pi6",
            "fine-tuned": "pose.test_tuned.acc_pi6",
            "recorded in training": "pose.train.acc_pi6",
            "turned by 180°": "pose.test.flipped",
            "median error, °": "pose.test.median_error_degrees",
            "base shape after full training": "shape.final_base.voxel_iou",
            "shape IoU": "shape.test.voxel_iou",
            "mask IoU": "shape.test.mask_iou",
            "fine-tuned mask IoU": "shape.test_tuned.mask_iou",
            "azimuths read off own drawings": "multiview.acc_pi6",
        },
    ),
    "fewer": Table(
        "",
        r"toybox-(200-car|500-car|car)|cifar10-(200-car|automobile-no-copying-cost)",
        {
            "feature distance": "reconstruction.predicted.feature_distance",
            "fine-tuned": "reconstruction.tuned.feature_distance",
            "views right": "pose.test.acc_pi6",
            "turned by 180°": "pose.test.flipped",
            "base shape": "shape.base.voxel_iou",
            "shape IoU": "shape.test.voxel_iou",
            "mask IoU": "shape.test.mask_iou",
        },
    ),
    **{f"sides-{name}": Confusion(name, "azimuth_tuned") for name in CONFUSED},
}


def with_tables(text: str, results: Path) -> str:
    """Return a page with every table made anew."""
    return MARKED.sub(lambda found: f"{found[1]}{found[2]}\n{render(TABLES[found[1]], results)}\n", text)


def render(table: Table | Confusion, results: Path) -> str:
    """Write a table as Markdown."""
    heading, *rows = table.rows(results)
    return "".join(f"| {' | '.join(row)} |\n" for row in [heading, ["---"] * len(heading), *rows])


def _cell(found: list[Cell]) -> str:
    if not found:
        return "–"
    values = [figure["value"] for figure in found]
    spread = statistics.stdev(values) if len(values) > 1 else found[0]["standard_error"]
    decimals = 3 if max(values) < 2 else 1
    mean = f"{statistics.fmean(values):.{decimals}f}"
    return mean if spread is None else f"{mean} ± {spread:.{decimals}f}"


def unpack_staged(folder: Path, *parts: str) -> None:
    """Unpack parts of the repository as git would commit them now; runs of one's own change the working tree's."""
    staged = subprocess.run(["git", "write-tree"], cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True).stdout
    words = ["git", "archive", staged.strip(), *parts]
    archive = subprocess.run(words, cwd=ROOT, check=True, stdout=subprocess.PIPE).stdout
    # Not by tarfile, whose 3.11.2 trusts every path.
    subprocess.run(["tar", "--extract", "--directory", folder], input=archive, check=True)


def main() -> None:
    """Write all tables anew."""
    with TemporaryDirectory() as folder:
        unpack_staged(Path(folder), "results/metrics", "results/tables")
        for page in PAGES:
            text = (ROOT / page).read_text()
            (ROOT / page).write_text(with_tables(text, Path(folder) / "results"))


if __name__ == "__main__":
    main()
