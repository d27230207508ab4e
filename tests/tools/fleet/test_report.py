"""The page of a fleet: of a thousand robots, in a table's words, with links."""

import re
from pathlib import Path
from typing import Any

import pytest
from fleet_tables import day, made_table

from drd_tools.fleet import report
from drd_tools.fleet.report import write_report
from drd_tools.fleet.statistics import analyse


def rows_of(table: dict[str, list[Any]], uri: str = "") -> list[dict[str, Any]]:
    labels = ("recording", "robot", "place", "start_utc")
    return [
        {**{c: table[c][i] for c in labels}, "verdict": "explained", "uri": uri} for i in range(len(table["recording"]))
    ]


def test_a_page_of_a_thousand_robots(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report, "TRENDS", 2)
    table = made_table(1000, 10, 0, lambda r, k, *_: 0.008 * (r == 500 and k >= 5))
    found = analyse(table)
    assert [e.robot for e in found.found] == ["500"]
    files = write_report(found, table, rows_of(table), tmp_path / "out")
    page = files[0].read_text()
    assert page.count("<details id=") == 1000
    assert page.count('class="found"') == 1
    assert "Robot 500, left tyre +0.8" in page
    assert "10000 recordings of 1000 robots" in page
    assert not re.search(r'(src|href)="https?:', page)  # it needs no server
    assert len(files) == 4


def test_links_go_to_the_recordings_own_reports(tmp_path: Path) -> None:
    recording = tmp_path / "a & b"
    recording.mkdir()
    (recording / "report.html").write_text("")
    table = made_table(2, 3, 0)
    files = write_report(analyse(table), table, rows_of(table, str(recording)), tmp_path / "out")
    assert files[0].read_text().count('href="../a%20%26%20b/report.html"') == 6


def test_names_are_escaped(tmp_path: Path) -> None:
    table = made_table(2, 3, 0)
    table["robot"] = ["<script>x</script>"] * len(table["robot"])
    files = write_report(analyse(table), table, rows_of(table), tmp_path)
    assert "<script>x" not in files[0].read_text()


def test_a_page_of_nothing(tmp_path: Path) -> None:
    page = write_report(analyse({c: [] for c in made_table(1, 1, 0)}), made_table(0, 0, 0), [], tmp_path)[0].read_text()
    assert "nothing has changed" in page


def test_what_is_over_is_not_to_be_inspected(tmp_path: Path) -> None:
    table = made_table(8, 40, 1, lambda r, k, *_: 0.01 * (r == 2 and 10 <= k < 25))
    log = [{"date": day(25), "robot": "2", "what": "left tyre changed"}]
    page = write_report(analyse(table, log), table, rows_of(table), tmp_path)[0].read_text()
    assert "back as it was" in page
    changed = page.index("left tyre changed 26 March 2026")
    assert page.index("nothing has changed") < page.index("back as it was") < changed
