"""`drd import` of tables whose times or headings are not those of a tidy log: unset, of bundles, sparse."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from import_files import EPOCH_NS, ROBOT

from drd.cli import main
from drd_tools.recordings.folder import read_recording, read_reference_log


def run(*words: Any) -> int:
    return main(["import", *map(str, words)])


@pytest.mark.parametrize("first_s", [0, 5])
def test_rows_before_the_clock_was_set(first_s: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = {name: tmp_path / f"{name}.csv" for name in ("gyro", "wheels")}
    for file in files.values():
        later = (f"{EPOCH_NS // 10**9 + 0.1 * k:.1f},{k}.5,1\n" for k in range(300))
        file.write_text("".join(["t,a,b\n", f"{first_s},0.0,0.0\n", *later]))
    words = ("--gyro", "b", "--gyro-unit", "deg_s", "--wheels-file", files["wheels"], "--wheels", "a,b", *ROBOT)
    code = run(files["gyro"], *words, "--wheels-unit", "rad_s", "--output", tmp_path / "out")
    told = capsys.readouterr()
    assert code == (2 if first_s else 0)
    if first_s:
        assert "--gyro: expected rows at most 86400 s apart, got 1.7e+09 s after 5 s" in told.err
    else:
        assert told.out.count("1 rows had the time 0, none, and were left out") == 2
        assert read_recording(tmp_path / "out").encoders.time_s[-1] == pytest.approx(29.9)


def test_angles_that_came_in_one_bundle_add_up(tmp_path: Path) -> None:
    table, out = tmp_path / "gyro.csv", tmp_path / "out"
    table.write_text("t,a\n" + "".join(f"{0.02 * (k // 2)},{0.1 + 0.01 * k}\n" for k in range(100)))
    assert run(table, "--gyro", "a", "--gyro-unit", "deg", "--output", out) == 0
    rate_deg_s = np.loadtxt(out / "fog.csv", delimiter=",", skiprows=1)[:, 1]
    assert 0.02 * rate_deg_s.sum() == pytest.approx(59.5)
    said = yaml.safe_load((out / "import.yaml").read_text())["streams"]["gyro"]["notes"]
    assert said == ["50 rows had the time of another one and were added to it"]


@pytest.mark.parametrize("unit", ["deg", "rad"])
@pytest.mark.parametrize("wrapped", [False, True])
def test_a_sparse_reference_keeps_its_turns_and_millimetres(tmp_path: Path, unit: str, wrapped: bool) -> None:
    heading_deg = 36.0 * np.arange(20) if wrapped else 200.0 * np.arange(20)
    written = (heading_deg + 180.0) % 360.0 - 180.0 if wrapped else heading_deg
    rows = zip(range(20), np.radians(written) if unit == "rad" else written, strict=True)
    table, gyro = tmp_path / "reference.csv", tmp_path / "gyro.csv"
    table.write_text("t,x,y,h\n" + "".join(f"{10 * k},{k},{5e6 + 0.001 * k:.3f},{h:.3f}\n" for k, h in rows))
    gyro.write_text("t,w\n" + "".join(f"{k},0.1\n" for k in range(200)))
    words = ("--reference-file", table, "--reference", "x,y,h", "--heading-unit", unit)
    assert run(gyro, "--gyro", "w", "--gyro-unit", "deg_s", *words, "--output", tmp_path / "out") == 0
    made = read_reference_log(tmp_path / "out" / "reference.csv")
    assert np.degrees(made.heading_rad) == pytest.approx(heading_deg, abs=0.1)
    assert made.y_m - 5e6 == pytest.approx(0.001 * np.arange(20), abs=1e-6)
