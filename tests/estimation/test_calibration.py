"""The gyro's calibration file and equation 6, inside and outside its range."""

import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from drd.config.schema import ConfigError
from drd.estimation.calibration import FORMAT, Calibration, load_calibration
from drd.samples import GyroSample

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


def beyond_rest(rate_deg_s: float) -> float:
    """What the difference to the error at rest has of the error's sigma; the range is 180 deg/s. (23)"""
    return math.sqrt(-2.0 * math.expm1(-0.5 * (rate_deg_s / 22.5) ** 2))


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
    assert math.degrees(corrected.sigma_rad_s) == pytest.approx(0.002 * beyond_rest(w), rel=1e-6, abs=1e-12)
    assert calibration.is_inside(sample(w, T))


def test_outside_the_correction_stays_and_the_uncertainty_widens(calibration: Calibration) -> None:
    border, beyond, far = (calibration.correct(sample(20.0, T)) for T in (45.0, 60.0, 75.0))
    assert beyond.rate_rad_s == border.rate_rad_s
    assert border.sigma_rad_s < beyond.sigma_rad_s < far.sigma_rad_s
    slope = (1e-3 + 4e-5 * 45.0) + (1e-4 - 2e-6 * 45.0) * 20.0 + 1e-9 * 20.0**3  # de/dT at 45 degC, deg/s/degC
    expected = math.hypot(0.002 * beyond_rest(20.0), 15.0 * slope)
    assert math.degrees(beyond.sigma_rad_s) == pytest.approx(expected, rel=0.02)
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
        ({"error_deg_s": {"a0": [1, 2, 3]}}, "error_deg_s.a1", "3 finite numbers"),
        ({"error_deg_s": {**GOOD["error_deg_s"], "a2": [1, 2]}}, "error_deg_s.a2", "3 finite numbers"),  # type: ignore[dict-item]
        ({"error_deg_s": {**GOOD["error_deg_s"], "a2": [1, 2, "x"]}}, "error_deg_s.a2[2]", "a number"),  # type: ignore[dict-item]
        ({"error_deg_s": {**GOOD["error_deg_s"], "a2": [1, 2, math.nan]}}, "error_deg_s.a2[2]", "a number"),  # type: ignore[dict-item]
        ({"rate_range_deg_s": [90, -90]}, "rate_range_deg_s", "higher"),
        ({"temperature_range_c": 20}, "temperature_range_c", "2 finite numbers"),
        ({"residual_deg_s": -1}, "residual_deg_s", "from 0"),
        ({"residual_deg_s": None}, "residual_deg_s", "a number in deg/s from 0"),
        ({"residual_before_deg_s": -0.1}, "residual_before_deg_s", "from 0"),
        ({"provenance": {}}, "provenance", "origin of"),
        ({"colour": "red"}, "colour", "one of format"),
    ],
)
def test_a_bad_file_is_refused_with_its_key(tmp_path: Path, change: dict[str, object], key: str, expected: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load_calibration(write(tmp_path, {**GOOD, **change}))
    assert caught.value.path == key
    assert expected in caught.value.expected
    assert "gyro.yaml" in str(caught.value)


def covariance(scale: float = 1.0) -> list[list[float]]:
    """Any positive definite one, with entries of the sizes that raw powers bring."""
    sizes = np.array([10.0 ** (-2 - 2 * i - j) for i in range(4) for j in range(3)])
    root = np.random.default_rng(1).standard_normal((12, 12))
    matrix: list[list[float]] = (scale * (root @ root.T) * np.outer(sizes, sizes)).tolist()
    return matrix


@settings(deadline=None)
@given(st.floats(-90, 90), st.floats(-10, 45))
def test_the_coefficients_uncertainty_adds_to_the_sigma(
    tmp_path_factory: pytest.TempPathFactory, w: float, T: float
) -> None:
    matrix = covariance()
    file = write(tmp_path_factory.mktemp("covariance"), {**GOOD, "covariance": matrix, "residual_before_deg_s": 0.4})
    loaded = load_calibration(file)
    x = np.array([w**i * T**j for i in range(4) for j in range(3)])
    expected = math.sqrt(0.002**2 + x @ np.array(matrix) @ x) * beyond_rest(w)
    assert math.degrees(loaded.correct(sample(w, T)).sigma_rad_s) == pytest.approx(expected, rel=1e-6, abs=1e-12)
    assert loaded.residual_before_deg_s == 0.4
    assert loaded.covariance == tuple(map(tuple, matrix))


def spoilt(row: int, column: int, value: object) -> list[list[object]]:
    matrix: list[list[object]] = [list(line) for line in covariance()]
    matrix[row][column] = value
    return matrix


@pytest.mark.parametrize(
    ("matrix", "expected", "got"),
    [
        ([[1.0]], "12 rows of 12 numbers", "a list of 1"),
        (3.0, "12 rows of 12 numbers", "3.0"),
        ([*covariance()[:11], [1.0]], "12 finite numbers", "a list of 1"),
        (spoilt(2, 3, math.nan), "a number", "nan"),
        (spoilt(2, 3, "x"), "a number", "x"),
        (spoilt(2, 3, 1.0), "a symmetric matrix", "differ by"),
        (spoilt(2, 3, 1e308), "a symmetric matrix", "differ by"),
        (spoilt(2, 2, 0.0), "no covariance where the variance is 0", "one"),
        (covariance(-1.0), "variances of at least 0", "-"),
        (np.where(np.eye(12), 1.0, -0.5).tolist(), "positive semidefinite", "eigenvalue of -4.5"),
    ],
)
def test_a_covariance_that_is_none_is_refused(tmp_path: Path, matrix: object, expected: str, got: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load_calibration(write(tmp_path, {**GOOD, "covariance": matrix}))
    assert caught.value.path.startswith("covariance")
    assert expected in caught.value.expected
    assert got in caught.value.got


def test_a_covariance_of_fewer_coefficients_has_zeros(tmp_path: Path) -> None:
    matrix = np.zeros((12, 12))
    matrix[0, 0] = 9e-6
    loaded = load_calibration(write(tmp_path, {**GOOD, "covariance": matrix.tolist()}))
    expected = math.hypot(0.002, 0.003) * beyond_rest(50.0)
    assert math.degrees(loaded.correct(sample(50.0, 20.0)).sigma_rad_s) == pytest.approx(expected)


def test_a_calibration_at_one_temperature_takes_a_typical_slope_elsewhere(tmp_path: Path) -> None:
    rows = {name: [b[0], 0, 0] for name, b in GOOD["error_deg_s"].items()}  # type: ignore[attr-defined]
    loaded = load_calibration(write(tmp_path, {**GOOD, "error_deg_s": rows, "temperature_range_c": [24.5, 25.5]}))
    still, turning = (math.degrees(loaded.correct(sample(w, 37.0)).sigma_rad_s) for w in (0.0, 90.0))
    assert still == pytest.approx(11.5 * 0.2 / 115.0)
    rest = 0.002 * beyond_rest(90.0)
    assert turning == pytest.approx(math.hypot(rest, still, 11.5 * 0.02 / 115.0 * 90.0))


def test_the_slowest_part_is_done_once(calibration: Calibration, tmp_path: Path) -> None:
    loaded = load_calibration(write(tmp_path, {**GOOD, "covariance": covariance()}))
    assert loaded._variance_rows is loaded._variance_rows
    assert calibration._variance_rows == ()


@pytest.mark.parametrize("text", ["", "- 1", "[", "3", "a: &a [*a]", '"\\UFFFFFFFF"', "residual_deg_s: " + "9" * 400])
def test_other_files_are_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(ConfigError):
        load_calibration(write(tmp_path, text))


ANY = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=3) | st.dates(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["a0", "a2", "x"]), inner, max_size=2),
    max_leaves=6,
)


@settings(deadline=None, max_examples=200)
@given(st.fixed_dictionaries({}, optional=dict.fromkeys((*GOOD, "covariance", "residual_before_deg_s"), ANY)))
def test_no_value_of_any_key_raises_anything_but_a_config_error(
    tmp_path_factory: pytest.TempPathFactory, values: dict[str, object]
) -> None:
    file = write(tmp_path_factory.getbasetemp(), {**GOOD, **values})
    try:
        found = load_calibration(file)
    except ConfigError as error:
        assert str(file) in str(error)  # noqa: PT017  # either is right
        return
    assert found.residual_deg_s >= 0.0
    assert all(map(math.isfinite, (*found.rows[0], *found.rate_range_deg_s)))


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="nowhere"):
        load_calibration(tmp_path / "nowhere.yaml")
