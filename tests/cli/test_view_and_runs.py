"""`kato3d view` and `kato3d runs`, on a project with a tiny trained model."""

from pathlib import Path
from unittest.mock import Mock

import pytest

from pipeline.cli.__main__ import main


def test_view_opens_the_page_and_says_where_it_is(
    project: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    page = project / "results/report/toybox-car/index.html"
    page.parent.mkdir(parents=True)
    page.touch()
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", lambda address: opened.append(address) or True)
    main(["view", "--project", str(project)])
    assert opened == [page.resolve().as_uri()]
    assert capsys.readouterr().out == f"open {page.resolve()}\n"  # it may have opened on a screen that nobody sees


def test_view_says_where_the_page_is_without_a_browser(
    project: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    page = project / "results/report/toybox-car/index.html"
    page.parent.mkdir(parents=True)
    page.touch()
    monkeypatch.setattr("webbrowser.open", lambda _: False)
    main(["view", "--project", str(project)])
    assert capsys.readouterr().out == f"open {page.resolve()}\n"


def test_runs_writes_a_table_of_all_runs(
    project: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, has_page in (("horse", True), ("car", False)):
        (project / "results/metrics").mkdir(parents=True, exist_ok=True)
        (project / f"results/metrics/{name}.json").write_text('{"pose": {"acc": 0.5}, "reconstruction": {}}')
        page = project / f"results/report/{name}/index.html"
        page.parent.mkdir(parents=True)
        if has_page:
            page.touch()
    browser = Mock()
    monkeypatch.setattr("webbrowser.open", browser)  # `make` calls it too, perhaps where nobody sits
    main(["runs", "--project", str(project)])
    browser.assert_not_called()
    page = project / "results/report/index.html"
    assert capsys.readouterr().out == f"open {page.resolve()}\n"
    text = page.read_text()
    assert '<td><a href="horse/index.html">horse</a></td>' in text
    assert "<td>car</td>" in text


def test_runs_names_a_file_that_holds_no_figures(project: Path) -> None:
    (project / "results/metrics").mkdir(parents=True)
    (project / "results/metrics/car.json").write_text("0.5")
    with pytest.raises(SystemExit, match=r"^error: \S*car\.json is damaged: it holds no figures by name; remove it"):
        main(["runs", "--project", str(project)])
