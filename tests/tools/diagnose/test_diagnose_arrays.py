"""The Python interface: arrays in, typed findings and files out; and what it does not need."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnosis_drives import SLALOM, recorded, selected

from drd import ConfigError, Robot
from drd_tools.diagnose import Amount, Diagnosis, Verdict, diagnose
from drd_tools.simulate.robot import DEFAULT

Frame = dict[str, Any]
ROBOT = Robot(
    name="simulated",
    wheel_radius_m=0.11,
    tread_m=0.52,
    counts_per_revolution=20000,
    gyro_rate_hz=10,
    gyro_range_deg_s=100,
    gyro_angle_random_walk_deg_per_sqrt_h=0.0833,
    gyro_bias_repeatability_deg_s=0.02,
    gyro_bias_random_walk_deg_per_h_per_sqrt_h=3.7,
    gyro_resolution_deg_s=0.004,
    encoders_rate_hz=20,
    slip_noise_m_per_sqrt_m=0.002,
    reference_position_sigma_m=0.01,
    reference_heading_sigma_deg=0.15,
    standstill_at_start_s=10,
)
ROOT = Path(__file__).parents[3]
NUMERICS = ("drd_tools.diagnose", "drd_tools.simulate.simulator", "drd_tools.recordings.folder")
BLOCKED = f"""
import sys
for name in ("zenoh", "can", "serial"):
    sys.modules[name] = None
import {", ".join(NUMERICS)}
assert not {{"drd.service.daemon", "drd.output.zenoh_link"}} & sys.modules.keys()
"""


@pytest.fixture(scope="module")
def columns() -> tuple[Frame, Frame, Frame]:
    """A robot whose gyro's scale is 1 % off, as a data frame would have it."""
    recording = recorded(SLALOM, 1, selected("gyro_scale_error", k=0.01))
    fog, log, pose = recording.fog, recording.encoders, recording.reference
    assert fog is not None
    assert pose is not None
    return (
        {"time_s": fog.time_s, "rate_deg_s": np.degrees(fog.rate_rad_s), "temperature_c": fog.temperature_c},
        {"time_s": log.time_s, "left_counts": log.left_counts, "right_counts": log.right_counts},
        {"time_s": pose.time_s, "x_m": pose.x_m, "y_m": pose.y_m, "heading_deg": np.degrees(pose.heading_rad)},
    )


@pytest.fixture(scope="module")
def diagnosis(columns: tuple[Frame, Frame, Frame]) -> Diagnosis:
    gyro, wheels, reference = columns
    assert ROBOT == DEFAULT
    return diagnose(gyro, wheels, ROBOT, reference=reference)


def test_findings_have_names_sizes_and_probabilities(diagnosis: Diagnosis) -> None:
    assert diagnosis.verdict is Verdict.EXPLAINED
    (finding,) = diagnosis.findings
    k = finding.parameters["k"]
    assert isinstance(k, Amount)
    assert "gyro_scale_error" in (finding.effect, *finding.also_fits)
    assert abs(k.value - 0.01) < 4.0 * k.std
    assert 1.0 / (2 + len(finding.also_fits)) < finding.probability <= 1.0
    assert sum(finding.probabilities.values()) == pytest.approx(1.0)
    assert set(finding.also_fits) <= finding.probabilities.keys()
    assert finding.windows[0] == pytest.approx((0.1, 120.0), abs=0.2)
    assert [term.effect.id for term in diagnosis.model.terms] == [finding.effect]


def test_the_report_is_that_of_the_command(diagnosis: Diagnosis, tmp_path: Path) -> None:
    files = diagnosis.report(tmp_path / "out")
    assert {f.name for f in files} >= {"diagnosis.json", "model.yaml", "report.html"}
    content = json.loads((tmp_path / "out/diagnosis.json").read_text())
    assert content["verdict"] == "explained"
    assert content["findings"][0]["probabilities"] == diagnosis.findings[0].probabilities
    assert content["findings"][0]["parameters"]["k"]["value"] == diagnosis.findings[0].parameters["k"].value


def test_without_a_gyro_the_reference_tells(columns: tuple[Frame, Frame, Frame]) -> None:
    _, wheels, reference = columns
    said = diagnose(None, wheels, ROBOT, reference=reference)
    assert said.verdict is Verdict.NOTHING
    assert {row.effect for row in said.result.unobservable} >= {"gyro_scale_error"}


def test_what_is_wrong_with_a_column_is_said(columns: tuple[Frame, Frame, Frame]) -> None:
    gyro, wheels, reference = columns
    with pytest.raises(ConfigError, match=r"reference.*y_m.*a column of numbers.*none"):
        diagnose(gyro, wheels, ROBOT, reference={k: v for k, v in reference.items() if k != "y_m"})
    with pytest.raises(ConfigError, match=r"gyro.*rate_deg_s.*finite"):
        diagnose({**gyro, "rate_deg_s": np.full(len(gyro["time_s"]), np.nan)}, wheels, ROBOT)
    with pytest.raises(ConfigError, match=r"wheels.*time_s.*rising"):
        diagnose(gyro, {**wheels, "time_s": wheels["time_s"][::-1]}, ROBOT)
    with pytest.raises(ConfigError, match="a gyro alone"):
        diagnose(gyro, None, ROBOT)


def ran(*arguments: str) -> str:
    paths = {"PYTHONPATH": f"{ROOT}:{ROOT / 'tools'}", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run([sys.executable, *arguments], capture_output=True, text=True, env=paths, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_example_finds_what_it_has_put_in(tmp_path: Path) -> None:
    told = ran(str(ROOT / "tools/examples/diagnose_arrays.py"), str(tmp_path))
    assert told.startswith("explained\n")
    assert "tread_error" in told
    assert (tmp_path / "report.html").exists()


def test_the_numerics_need_no_zenoh_no_python_can_and_no_pyserial() -> None:
    ran("-c", BLOCKED)
