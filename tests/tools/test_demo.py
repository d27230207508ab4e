"""The demo as a user runs it: hardware, daemon and watcher, a picture and a line with the error."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
from harness import free_endpoint

from drd.config.file import load_config
from drd_tools import demo
from drd_tools.emulate.hardware import Truth

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
    assert demo.main(["--config", str(config_in(tmp_path)), "--seconds", "14", "--output", str(picture)]) == 0
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
