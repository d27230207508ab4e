"""The gyro's calibration file and equation 6, inside and outside its range."""

import math
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from drd.calibration import FORMAT, Calibration, load_calibration
from drd.samples import GyroSample
from drd.schema import ConfigError

GOOD = {
    "format": FORMAT,
    "error_deg_s": {
        "a0": [0.01, 1e-3, 2e-5],
        "a1": [0.002, 1e-4, -1e-6],
        "a2": [1e-5, 0, 0],
        "a3": [-3e-7, 1e-9, 0],
    },
    "rate_range_deg_s": [-90, 90],
    "temperature_range_c": [-10, 45],
    "residual_deg_s": 0.002,
    "provenance": {"created": "2026-01-01", "tool": "by hand"},
}


def write(folder: Path, data: object) -> Path:
    file = folder / "gyro.yaml"
    file.write_text(yaml.safe_dump(data) if not isinstance(data, str) else data)
    return file


def sample(rate_deg_s: float, temperature_c: float) -> GyroSample:
    return GyroSample(1, 0.1, math.radians(rate_deg_s), temperature_c)


@pytest.fixture(scope="module")
def calibration(tmp_path_factory: pytest.TempPathFactory) -> Calibration:
    return load_calibration(write(tmp_path_factory.mktemp("calibration"), GOOD))


@settings(deadline=None)
@given(st.floats(-90, 90), st.floats(-10, 45))
def test_inside_its_range_the_error_function_is_taken_off(calibration: Calibration, w: float, T: float) -> None:
    a0, a1, a2, a3 = 0.01 + 1e-3 * T + 2e-5 * T * T, 0.002 + 1e-4 * T - 1e-6 * T * T, 1e-5, -3e-7 + 1e-9 * T
    corrected = calibration.correct(sample(w, T))
    assert math.degrees(corrected.rate_rad_s) == pytest.approx(w - (a0 + a1 * w + a2 * w**2 + a3 * w**3), abs=1e-9)
    assert math.degrees(corrected.sigma_rad_s) == pytest.approx(0.002)
    assert calibration.is_inside(sample(w, T))


def test_outside_the_correction_stays_and_the_uncertainty_widens(calibration: Calibration) -> None:
    border, beyond, far = (calibration.correct(sample(20.0, T)) for T in (45.0, 60.0, 75.0))
    assert beyond.rate_rad_s == border.rate_rad_s
    assert border.sigma_rad_s < beyond.sigma_rad_s < far.sigma_rad_s
    slope = (1e-3 + 4e-5 * 45.0) + (1e-4 - 2e-6 * 45.0) * 20.0 + 1e-9 * 20.0**3  # de/dT at 45 degC, deg/s/degC
    assert math.degrees(beyond.sigma_rad_s) == pytest.approx(math.hypot(0.002, 15.0 * slope), rel=0.02)
    fast = calibration.correct(sample(120.0, 20.0))
    assert fast.sigma_rad_s > border.sigma_rad_s
    assert not calibration.is_inside(sample(120.0, 20.0))


def test_an_unknown_temperature_costs_half_the_range(calibration: Calibration) -> None:
    unknown = calibration.correct(sample(10.0, math.nan))
    assert math.isfinite(unknown.rate_rad_s)
    assert unknown.sigma_rad_s > 5.0 * calibration.correct(sample(10.0, 17.5)).sigma_rad_s
    assert not calibration.is_inside(sample(10.0, math.nan))


@pytest.mark.parametrize(
    ("change", "key", "expected"),
    [
        ({"format": "other"}, "format", "drd-gyro-calibration/1"),
        ({"error_deg_s": {"a0": [1, 2, 3]}}, "error_deg_s", "a0, a1, a2, a3"),
        ({"error_deg_s": {**GOOD["error_deg_s"], "a2": [1, 2]}}, "error_deg_s.a2", "3 finite numbers"),  # type: ignore[dict-item]
        ({"error_deg_s": {**GOOD["error_deg_s"], "a2": [1, 2, "x"]}}, "error_deg_s.a2", "finite"),  # type: ignore[dict-item]
        ({"error_deg_s": {**GOOD["error_deg_s"], "a2": [1, 2, math.nan]}}, "error_deg_s.a2", "finite"),  # type: ignore[dict-item]
        ({"rate_range_deg_s": [90, -90]}, "rate_range_deg_s", "higher"),
        ({"temperature_range_c": 20}, "temperature_range_c", "2 finite numbers"),
        ({"residual_deg_s": -1}, "residual_deg_s", "from 0"),
        ({"residual_deg_s": None}, "residual_deg_s", "finite"),
        ({"provenance": {}}, "provenance", "come from"),
        ({"colour": "red"}, "colour", "one of format"),
    ],
)
def test_a_bad_file_is_refused_with_its_key(tmp_path: Path, change: dict[str, object], key: str, expected: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load_calibration(write(tmp_path, {**GOOD, **change}))
    assert caught.value.path == key
    assert expected in caught.value.expected
    assert "gyro.yaml" in str(caught.value)


@pytest.mark.parametrize("text", ["", "- 1", "[", "3", "a: &a [*a]", '"\\UFFFFFFFF"', "residual_deg_s: " + "9" * 400])
def test_other_files_are_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(ConfigError):
        load_calibration(write(tmp_path, text))


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="nowhere"):
        load_calibration(tmp_path / "nowhere.yaml")
