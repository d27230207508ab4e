"""The demo as a user runs it: hardware, daemon and watcher, a picture and a line with the error."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
from links import free_endpoint

from drd.config.file import load_config
from drd_tools import demo
from drd_tools.emulate.hardware import Truth
from drd_tools.simulate.missions import demo_drive

DEMO = Path(__file__).resolve().parents[2] / "config" / "demo.yaml"


def config_in(folder: Path) -> Path:
    text = DEMO.read_text().replace("/tmp/drd-demo", str(folder))
    assert "# listen: [tcp/127.0.0.1:7447]" in text
    file = folder / "demo.yaml"
    file.write_text(text.replace("# listen: [tcp/127.0.0.1:7447]", f"listen: [{free_endpoint()}]"))
    return file


@pytest.mark.process
def test_a_short_demo_writes_the_picture_and_the_error(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    picture = tmp_path / "pictures" / "demo.png"
    assert demo.main(["--config", str(config_in(tmp_path)), "--seconds", "20", "--output", str(picture)]) == 0
    assert picture.read_bytes().startswith(b"\x89PNG")
    out = capfd.readouterr().out
    found = re.search(r"after ([\d.]+) m: position error ([\d.]+) m .*99 % bound ([\d.]+) m", out)
    assert found is not None
    length_m, error_m, bound_m = map(float, found.groups())
    assert length_m > 2.0
    assert error_m < bound_m < 0.1 * length_m
    assert not list(tmp_path.glob("fog")), "the emulator's links stay behind"


def test_too_short_a_demo_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert demo.main(["--config", str(config_in(tmp_path)), "--seconds", "3"]) == 2
    assert "--seconds" in capsys.readouterr().err


def test_the_figures_are_those_of_the_paths(tmp_path: Path) -> None:
    config = load_config(config_in(tmp_path)).value
    s = 1_000_000_000
    truth = [Truth(i * s, float(i), 0.0, 0.0, 1.01 * i, 1.01 * i) for i in range(11)]
    bound = "position_bound_99_m"
    poses = [
        {"monotonic_ns": i * s // 2, "x_m": i / 2, "y_m": 0.1, "heading_rad": 0.01, bound: 0.5} for i in range(2, 21)
    ]
    result = demo.evaluate(truth, poses, config, 10.0)
    np.testing.assert_allclose(result.errors_m, 0.1, atol=1e-12)
    assert result.wheels[-1, 1] == pytest.approx(10.1)
    assert f"heading error {math.degrees(0.01):.2f} deg" in result.sentence()
    assert "wheels alone 0.100 m, largest 0.100 m" in result.sentence()


def test_an_effect_is_planted_from_the_middle_on_as_large_as_it_is_to_be() -> None:
    config, drive = load_config(DEMO).value, demo_drive(240.0, 12.0)
    planted = demo.plant("tyre_deflation", drive, config, 1)
    assert planted is not None
    assert 80.0 < planted.begin_s < 140.0
    assert not planted.fault.by(planted.begin_s - 1.0).any()
    left, right, gyro = np.abs(planted.fault.by(240.0))
    assert max(left, right) > 0.5
    assert (min(left, right), gyro) == (0.0, 0.0)
    assert demo.plant("wheel_radius_error", demo_drive(15.0, 12.0), config, 1) is None


def test_what_the_monitor_says_of_a_fault_is_told_and_marked() -> None:
    config, drive = load_config(DEMO).value, demo_drive(240.0, 12.0)
    planted = demo.plant("tyre_deflation", drive, config, 1)
    assert planted is not None
    zero_ns = 5_000_000_000
    since_ns, named_ns = (zero_ns + round((planted.begin_s + later_s) * 1e9) for later_s in (-3.0, 40.0))
    size = {"value": 0.021, "std": 0.001, "low": 0.0194, "high": 0.0226, "unit": "1"}
    finding = {
        "effect": "tyre_deflation", "parameters": {"side": "left", "total": size}, "probability": 0.97,
        "also_fits": [["unknown", 0.02]], "since_ns": since_ns, "since_std_s": 4.0, "named_ns": named_ns,
    }  # fmt: skip
    text, marks = demo.told(planted, [finding], zero_ns, 0.0)
    assert "named after 40 s: tyre_deflation (side left, total 0.021 [0.0194, 0.0226]), 0.97, or unknown" in text
    assert [round(m.time_s - planted.begin_s) for m in marks] == [0, -3, 40]
    assert marks[1].std_s == 4.0
    assert "names nothing" in demo.told(planted, [], zero_ns, 0.0)[0]


def test_a_fault_needs_the_monitor(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = config_in(tmp_path)
    before, _, monitor = file.read_text().partition("\nmonitor:\n")
    file.write_text(f"{before}\nmonitor:\n{monitor.replace('# enabled: true', 'enabled: false', 1)}")
    assert demo.main(["--config", str(file), "--fault", "tyre_deflation"]) == 2
    assert "monitor.enabled: true" in capsys.readouterr().err
