from pathlib import Path

import pytest
import torch

from pipeline.errors import DataError
from pipeline.evaluation.statistics import correlation_figure, mean_figure, median_figure
from pipeline.evaluation.tables import figure_rows, format_figures, read_table, write_table
from pipeline.seeding import generator

METRICS = {
    "alignment": {"degrees": 180.0, "n": 50},
    "pose": {
        "test": {
            "acc_pi6": 0.75,
            "n": 40,
            "standard_error": 0.07,
            "flipped": {"value": 0.2, "n": 40, "standard_error": 0.1},
        }
    },
}


def test_standard_error_of_a_mean() -> None:
    assert mean_figure(torch.tensor([1.0, 3.0])) == {"value": 2.0, "n": 2, "standard_error": 1.0}
    assert mean_figure(torch.tensor([True, True]))["standard_error"] == 0
    assert mean_figure(torch.tensor([True])) == {"value": 1.0, "n": 1, "standard_error": None}
    assert median_figure(torch.ones(1), generator(0))["standard_error"] is None


def test_correlation_of_what_varies_together_against_each_other_and_not_at_all() -> None:
    values = torch.randn(2000, generator=torch.Generator().manual_seed(0))
    noise = torch.randn(2000, generator=torch.Generator().manual_seed(1))
    assert correlation_figure(values, 3 * values + 1)["value"] == pytest.approx(1, abs=1e-9)
    assert correlation_figure(values, -values)["value"] == pytest.approx(-1, abs=1e-9)
    half = correlation_figure(values, values + noise)
    assert half["value"] == pytest.approx(0.5**0.5, abs=0.05)
    assert half["standard_error"] == pytest.approx(0.5 / 2000**0.5, abs=2e-3)
    for constant in (torch.zeros(2000), 1 + 1e-7 * values):
        assert correlation_figure(values, constant)["value"] == 0
    for count in (1, 2):
        assert correlation_figure(values[:count], values[:count])["value"] == 0, "two samples always lie on a line"


def test_standard_error_of_a_normal_median() -> None:
    rng = torch.Generator().manual_seed(0)
    figure = median_figure(torch.randn(2000, generator=rng), rng)
    assert figure["value"] == pytest.approx(0, abs=0.1)
    assert figure["standard_error"] == pytest.approx(1.2533 / 2000**0.5, abs=0.006)


def test_rows_carry_n_and_standard_error() -> None:
    assert figure_rows(METRICS) == [
        ("alignment.degrees", 180.0, None, None),
        ("pose.test.acc_pi6", 0.75, 0.07, 40),
        ("pose.test.flipped", 0.2, 0.1, 40),
    ]


def test_lists_have_a_row_a_number() -> None:
    figures = {"scores": [9.5, 8.0], "says": ["nothing"], "seeds": 2}
    assert figure_rows(figures) == [
        ("scores.0", 9.5, None, None),
        ("scores.1", 8.0, None, None),
        ("seeds", 2, None, None),
    ]


def test_text_has_one_line_a_figure() -> None:
    lines = format_figures(METRICS).splitlines()
    assert len(lines) == 4
    assert lines[2].split() == ["pose.test.acc_pi6", "0.7500", "0.0700", "40"]


def test_table_round_trip(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    write_table(
        path,
        {"test_index": torch.tensor([3, 1]), "error_mode_tuned": torch.tensor([0, 1]), "ssim": torch.tensor([0.5, 1])},
    )
    assert path.read_text() == "test_index,error_mode_tuned,ssim\n3,correct,0.500000\n1,flipped,1.000000\n"
    assert read_table(path)["error_mode_tuned"] == ["correct", "flipped"]


@pytest.mark.parametrize("content", [b"", b"a,b\n1,2,3\n4,5,6,7\n", "h\u00f6he\n1".encode("latin-1")])
def test_a_damaged_table_is_named(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "cars.csv").write_bytes(content)
    with pytest.raises(DataError, match=r"cars\.csv is damaged \(.*\); run the stage that writes it again"):
        read_table(tmp_path / "cars.csv")


def test_a_single_sample_is_printed_with_n_and_without_an_error() -> None:
    line = format_figures({"ssim": {"value": 0.5, "n": 1, "standard_error": None}}).splitlines()[-1]
    assert line.split() == ["ssim", "0.5000", "–", "1"]
