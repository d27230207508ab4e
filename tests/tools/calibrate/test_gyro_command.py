"""`drd calibrate gyro` as a user runs it: from CSV files to the file that the daemon loads, or to a clear refusal."""

import hashlib
import math
import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import yaml
from rate_table_data import samples, write_csv, write_table

from drd import __version__
from drd.arrays import Array
from drd.estimation.calibration import load_calibration
from drd.samples import GyroSample
from drd_tools.calibrate.command import main as calibrate
from drd_tools.calibrate.gyro.command import main

Columns = tuple[Array, Array, Array, Array]
PICTURES = ("figure1.png", "figure2.png", "figure3.png")
FEW_RATES = tuple(range(-100, 101, 25))
FEW_TEMPERATURES = (-10, 10, 30, 50)


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rng = np.random.default_rng(1)
    return write_table(tmp_path_factory.mktemp("table"), rng, FEW_TEMPERATURES, rates=FEW_RATES, spikes=0.02)


@pytest.fixture(scope="module")
def again(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rng = np.random.default_rng(2)
    return write_table(tmp_path_factory.mktemp("again"), rng, (0, 20, 40), rates=tuple(range(-90, 91, 15)))


def test_a_folder_becomes_a_calibration_that_is_ten_times_better_on_new_data(
    table: Path, again: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = [str(table), "--held-out", str(again), "--output", str(tmp_path / "deep/gyro"), "--latitude", "48.1"]
    assert calibrate(["gyro", *arguments]) == 0
    out = capsys.readouterr().out
    calibration = load_calibration(tmp_path / "deep/gyro/calibration.yaml")
    found = re.search(r"rms error falls from ([\d.]+) to ([\d.]+) deg/s on 39 new data sets", out)
    assert found is not None
    before, after = map(float, found.groups())
    assert before > 10.0 * after
    assert calibration.residual_before_deg_s == pytest.approx(before, rel=0.01)
    assert calibration.residual_deg_s == pytest.approx(after, rel=0.01)
    assert calibration.rate_range_deg_s == pytest.approx((-100.0, 100.0), abs=3.0)
    assert calibration.temperature_range_c == pytest.approx((-10.0, 50.6), abs=0.5)
    assert len(calibration.covariance) == 12
    _, _, g, T = samples(np.random.default_rng(9), (70.0,), 35.0, seconds=60.0)
    mean = GyroSample(0, 60.0, math.radians(float(g[10:].mean())), float(T.mean()))
    corrected = calibration.correct(mean)
    assert abs(math.degrees(corrected.rate_rad_s) - 70.0) < 4.0 * math.degrees(corrected.sigma_rad_s)
    assert "recommended" in out
    assert "11.2 deg/h" in out


def test_the_file_says_where_it_comes_from(table: Path, tmp_path: Path) -> None:
    assert main([str(table), "--output", str(tmp_path)]) == 0
    data = yaml.safe_load((tmp_path / "calibration.yaml").read_text())
    provenance = data["provenance"]
    assert provenance["tool"] == f"drd calibrate gyro {__version__}"
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\+00:00", provenance["created"])
    assert provenance["data_sets"].startswith("36, ")
    assert "held out" in provenance["residual_from"]
    assert provenance["earth_rate"] == "in the constant coefficient"
    file = table / "rates_+10c.csv"
    assert provenance[f"sha256 {file}"] == hashlib.sha256(file.read_bytes()).hexdigest()
    assert load_calibration(tmp_path / "calibration.yaml").provenance == provenance


def test_the_report_is_one_page_with_the_papers_figures(table: Path, tmp_path: Path) -> None:
    assert main([str(table), "--output", str(tmp_path), "--order", "2,1"]) == 0
    for name in PICTURES:
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64") == 3
    for text in (
        "Figure 1",
        "Figure 2",
        "Figure 3",
        "b_21",
        "Order 2,1 was requested and written",
        "condition number",
        "times better",
    ):
        assert text in page
    assert hashlib.sha256((table / "rates_+10c.csv").read_bytes()).hexdigest() in page
    order = np.array(list(yaml.safe_load((tmp_path / "calibration.yaml").read_text())["error_deg_s"].values()))
    assert np.count_nonzero(order) == 6


def test_a_rejected_data_set_is_named(table: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    t, w, g, T = samples(np.random.default_rng(1), FEW_RATES, 20.0)
    bumped = write_csv(tmp_path / "bumped.csv", (t, w, np.where(w == 25.0, g + 3.0, g), T))
    assert main([str(table), str(bumped), "--output", str(tmp_path)]) == 0
    assert "Rejected: bumped.csv, " in capsys.readouterr().out
    assert "bumped.csv, " in (tmp_path / "report.html").read_text(encoding="utf-8")


def one_temperature(folder: Path) -> Path:
    return write_table(folder / "one", np.random.default_rng(1), (25,), rates=FEW_RATES)


def test_one_temperature_is_refused_and_accepted_with_the_option_that_the_refusal_names(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = one_temperature(tmp_path)
    assert main([str(data), "--output", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert said.startswith("drd calibrate gyro: refused: only one temperature (25.3 degC)")
    assert "`--order 3,0` accepts a calibration for this temperature only" in said
    assert not (tmp_path / "calibration.yaml").exists()
    assert main([str(data), "--output", str(tmp_path), "--order", "3,0"]) == 0
    assert "No term in temperature" in capsys.readouterr().out
    calibration = load_calibration(tmp_path / "calibration.yaml")
    low, high = calibration.temperature_range_c
    assert low <= 25.0
    assert 25.6 <= high < low + 1.5
    inside, warm = (calibration.correct(GyroSample(0, 0.1, 1.0, T)) for T in (25.3, 45.0))
    assert warm.sigma_rad_s > 2.0 * inside.sigma_rad_s


def test_two_temperatures_are_refused_for_the_quadratic_term(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = write_table(tmp_path / "two", np.random.default_rng(1), (10, 40), rates=FEW_RATES)
    assert main([str(data), "--output", str(tmp_path)]) == 2
    assert "only two temperatures" in (said := capsys.readouterr().err)
    assert "the quadratic term in temperature is not observable" in said
    assert main([str(data), "--output", str(tmp_path), "--order", "3,1"]) == 0


def with_nan(t: Array, w: Array, g: Array, T: Array) -> Columns:
    return t, w, np.where(t == 5.0, np.nan, g), T


def swapped(t: Array, w: Array, g: Array, T: Array) -> Columns:
    return t, g, w, T


def never_turning(t: Array, w: Array, g: Array, T: Array) -> Columns:
    return t, 0.0 * w, 0.001 * g, T


BAD = {
    with_nan: "25c.csv:51: rate_deg_s: expected a finite number",
    swapped: "the two columns look swapped",
    never_turning: "`drd calibrate noise`",
}


@pytest.mark.parametrize("spoil", BAD)
def test_bad_input_ends_it_with_code_2_and_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], spoil: Callable[..., Columns]
) -> None:
    write_csv(tmp_path / "25c.csv", spoil(*samples(np.random.default_rng(1))))
    assert main([str(tmp_path / "25c.csv"), "--output", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert BAD[spoil] in error
    assert error.count("\n") == 1


def test_data_that_was_fitted_is_no_new_data(table: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    copy = tmp_path / "copy.csv"
    copy.write_bytes((table / "rates_+10c.csv").read_bytes())
    assert main([str(table), "--held-out", str(copy), "--output", str(tmp_path)]) == 2
    assert "copy.csv: --held-out: expected data that the fit has not seen" in capsys.readouterr().err


def test_new_data_outside_the_range_is_not_counted(
    table: Path, again: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    hot = write_csv(tmp_path / "hot.csv", samples(np.random.default_rng(3), FEW_RATES, 70.0))
    assert main([str(table), "--held-out", str(again), str(hot), "--output", str(tmp_path)]) == 0
    assert "9 new data sets lie outside the valid range and were not counted" in capsys.readouterr().out
    assert main([str(table), "--held-out", str(hot), "--output", str(tmp_path)]) == 2
    assert "no new data set lies within" in capsys.readouterr().err


def test_live_records_first_and_fits_with_what_was_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked: list[object] = []

    def record_steps(config_file: Path, folder: Path, rates_deg_s: Sequence[float], seconds: float) -> list[Path]:
        asked.extend([config_file, list(rates_deg_s), seconds])
        return list(write_table(folder, np.random.default_rng(1), (0,), rates=tuple(rates_deg_s)).glob("*.csv"))

    live = ModuleType("gyro_live")
    monkeypatch.setattr(live, "record_steps", record_steps, raising=False)
    monkeypatch.setitem(sys.modules, "drd_tools.calibrate.gyro.live", live)
    earlier = write_table(tmp_path / "earlier", np.random.default_rng(2), (20, 40), rates=FEW_RATES)
    options = ["--live", "robot.yaml", "--rates", "-100,-50,0,50,100", "--seconds", "8"]
    assert main([*options, str(earlier), "--output", str(tmp_path / "out")]) == 0
    assert asked == [Path("robot.yaml"), [-100.0, -50.0, 0.0, 50.0, 100.0], 8.0]
    assert "Recorded 1 steps in" in capsys.readouterr().out
    monkeypatch.setattr(live, "record_steps", lambda *_: [])
    assert main([*options, "--output", str(tmp_path / "out")]) == 2
    assert "at least one that was recorded, got none" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ([], "expected DATA, or --live"),
        (["x.csv", "--rates", "1,2"], "--live and --rates go together"),
        (["--live", "c.yaml"], "--live and --rates go together"),
        (["--live", "c.yaml", "--rates", "-1,fast"], "expected a finite number"),
        (["x.csv", "--order", "4,2"], "expected 1,0 to 3,2"),
        (["x.csv", "--order", "cubic"], "expected 1,0 to 3,2"),
        (["x.csv", "--latitude", "91"], "expected a number from -90 to 90"),
        (["x.csv", "--settle", "-1"], "expected a number from 0"),
    ],
)
def test_bad_usage_is_explained(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], said: str
) -> None:
    with pytest.raises(SystemExit) as refused:
        main([*options, "--output", str(tmp_path)])
    assert refused.value.code == 2
    assert said in capsys.readouterr().err


def test_a_folder_that_cannot_be_made_is_reported(
    table: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("precious")
    assert main([str(table), "--output", str(tmp_path / "file")]) == 1
    assert "cannot write" in capsys.readouterr().err
    assert (tmp_path / "file").read_text() == "precious"


def test_help_names_every_option(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--help"])
    text = capsys.readouterr().out
    for option in (
        "DATA",
        "--output",
        "--held-out",
        "--order",
        "--latitude",
        "--settle",
        "--live",
        "--rates",
        "--seconds",
    ):
        assert option in text
