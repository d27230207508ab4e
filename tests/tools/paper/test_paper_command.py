import json
from pathlib import Path

import numpy as np
import pytest

from drd.cli import main
from drd_tools.paper import experiment
from drd_tools.paper.printed import TABLE_II_CM
from drd_tools.paper.results import factors
from drd_tools.paper.text import printed_gain


def test_the_printed_table_has_the_paper_s_averages_and_factors() -> None:
    assert TABLE_II_CM[:5].mean(axis=0) == pytest.approx((83.0, 21.5, 14.0, 9.5), abs=0.06)
    assert TABLE_II_CM[5:].mean(axis=0) == pytest.approx((132.4, 64.8, 18.5, 15.0), abs=0.06)
    assert [round(printed_gain(cell), 1) for cell in (1, 2, 3)] == [2.5, 6.6, 8.8]


def test_a_factor_is_a_ratio_of_means_with_an_interval_that_covers() -> None:
    random = np.random.default_rng(1)
    inside = 0
    for trial in range(100):
        error = random.gamma(4.0, 1.0, size=(40, 10, 1)) * np.array([8.0, 4.0, 2.0, 1.0])
        error *= random.gamma(6.0, 1.0 / 6.0, size=(40, 1, 4))
        gain, low, high = factors(error, 2, seed=trial)
        assert low < gain < high
        inside += low <= 4.0 <= high
    assert 88 <= inside <= 100


def test_the_command_prints_the_table_and_draws_again_from_what_it_saved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(experiment, "RUNS_EACH_WAY", 1)
    folder = tmp_path / "paper"
    assert main(["paper", "--output", str(folder), "--gyros", "2"]) == 0
    first = capsys.readouterr().out
    assert "average ccw  132.4 |" in first
    assert "robot.skid" in first
    pictures = ("path.png", "table2.png", "figure3.png", "onway.png", "variances.png")
    assert {p.name for p in folder.iterdir()} == {*pictures, "report.html", "results.json"}
    assert json.loads((folder / "results.json").read_text())["format"] == "drd-paper/2"
    for name in (*pictures, "report.html"):
        (folder / name).unlink()
    assert main(["paper", "--output", str(folder), "--draw"]) == 0
    again = capsys.readouterr().out
    assert again.splitlines() == first.splitlines()[2:]
    html = (folder / "report.html").read_text(encoding="utf-8")
    assert html.count("data:image/png;base64,") == len(pictures)


@pytest.mark.parametrize(
    ("content", "complaint"), [(None, "results of an earlier"), ("[]", "drd-paper/2"), ('{"format": 1}', "drd-paper/2")]
)
def test_nothing_to_draw_again_is_a_clear_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: str | None, complaint: str
) -> None:
    if content is not None:
        (tmp_path / "results.json").write_text(content)
    assert main(["paper", "--output", str(tmp_path), "--draw"]) == 2
    assert complaint in capsys.readouterr().err


def test_bad_usage(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["paper", "--output", str(tmp_path), "--gyros", "1"])
    assert "--gyros: expected a whole number of at least 2, got '1'" in capsys.readouterr().err
    (tmp_path / "file").write_text("")
    assert main(["paper", "--output", str(tmp_path / "file")]) == 2
    assert f"{tmp_path / 'file'}: expected a folder to write to" in capsys.readouterr().err
