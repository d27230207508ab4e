"""The filter's algebra: Jacobian, printed equations, gate, feedback, variants, bad numbers."""

import dataclasses
import math

import numpy as np
import numpy.typing as npt
import pytest
from filterpy.kalman import KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st

from drd.config.keys import Noise
from drd.estimation.filter import LEAST_LAG_S, Filter, Outcome
from drd.estimation.noise import NoiseProfile, make_noise, paper
from drd.estimation.state import GYRO_BIAS, GYRO_HEADING, GYRO_SCALE, HEADING, WHEEL_LAG, N, Nominal, Sigmas

TREAD_M = 0.6
SIGMAS = Sigmas(position_m=0.1, heading_rad=0.05, wheel_scale=0.01, tread_m=0.02, gyro_scale=0.01, gyro_bias_rad_s=1e-3)
NAMES = ("x_m", "y_m", "heading_rad", "scale_right", "scale_left", "tread_m", "gyro_heading_rad", "gyro_scale",
         "gyro_bias_rad_s", "wheel_lag_s", "slip_s")  # fmt: skip
# The wheel scales are errors that the encoders have; the other states are computed minus true.
SIGN = np.array([1, 1, 1, -1, -1, 1, 1, 1, 1, 1, 1])
SILENT = NoiseProfile(comparison_rad2=1e-8)

small = st.floats(-0.05, 0.05)


def make(
    noise: NoiseProfile = SILENT, midpoint: bool = True, sigmas: Sigmas = SIGMAS, along_gyro: bool = True
) -> Filter:
    return Filter(TREAD_M, sigmas, noise, midpoint=midpoint, along_gyro=along_gyro)


def vector(nominal: Nominal) -> npt.NDArray[np.float64]:
    values: npt.NDArray[np.float64] = SIGN * np.array([getattr(nominal, name) for name in NAMES])
    return values


def moved(
    error: npt.NDArray[np.float64], heading: float, left: float, right: float, midpoint: bool, along_gyro: bool
) -> Filter:
    """A filter whose nominal is off by `error` and which has made one step with a gyro that agrees with the wheels."""
    sigmas = dataclasses.replace(SIGMAS, slip_s=0.1)
    kf = make(midpoint=midpoint, along_gyro=along_gyro, sigmas=sigmas)
    kf.nominal.heading_rad = kf.nominal.gyro_heading_rad = heading
    for i, name in enumerate(NAMES):
        setattr(kf.nominal, name, getattr(kf.nominal, name) + SIGN[i] * error[i])
    kf.predict(0.05, left, right, (right - left) / TREAD_M / 0.05)
    return kf


@settings(max_examples=60, deadline=None)
@given(st.floats(-4, 4), st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.booleans(), st.booleans())
def test_covariance_propagates_by_the_derivatives_of_the_motion(
    heading: float, left: float, right: float, midpoint: bool, along_gyro: bool
) -> None:
    F = np.empty((N, N))
    for i in range(N):
        step = np.zeros(N)
        step[i] = 1e-6
        plus, minus = (vector(moved(d, heading, left, right, midpoint, along_gyro).nominal) for d in (step, -step))
        F[:, i] = (plus - minus) / 2e-6
    nothing = np.zeros(N)
    before = make(midpoint=midpoint, sigmas=dataclasses.replace(SIGMAS, slip_s=0.1)).P
    after = moved(nothing, heading, left, right, midpoint, along_gyro).P
    if left == right == 0.0:
        return
    np.testing.assert_allclose(after, F @ before @ F.T, atol=1e-9)


def test_without_the_midpoint_the_step_is_the_papers_equation_13_in_rep_103() -> None:
    heading, left, right, dt = 0.7, 0.06, 0.08, 0.05
    U, D, c, s = 0.5 * (left + right), TREAD_M, math.cos(heading), math.sin(heading)
    rate = (right - left) / D / dt
    F = np.eye(N)
    F[0, 2:5] = -s * U, c * right / 2, c * left / 2
    F[1, 2:5] = c * U, s * right / 2, s * left / 2
    F[2, 3:6] = right / D, -left / D, (left - right) / D**2
    F[6, 7:9] = rate * dt, dt
    kf = make(midpoint=False, along_gyro=False)
    kf.nominal.heading_rad = heading
    expected = F @ kf.P @ F.T
    kf.predict(dt, left, right, rate)
    np.testing.assert_allclose(kf.P, expected, rtol=1e-12, atol=1e-18)
    assert (kf.nominal.x_m, kf.nominal.y_m) == pytest.approx((U * c, U * s))
    assert kf.nominal.heading_rad == pytest.approx(heading + (right - left) / D)


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.tuples(st.floats(0.01, 0.1), st.floats(-2.0, 2.0), st.floats(-0.002, 0.002)), min_size=1, max_size=30)
)
def test_update_and_feedback_equal_an_independent_kalman_filter(steps: list[tuple[float, float, float]]) -> None:
    noise = make_noise("physical", Noise(), TREAD_M)
    kf = Filter(TREAD_M, SIGMAS, noise, gate_sigma=1e6)
    for left, rate, slip in steps:
        difference = rate * 0.05 * TREAD_M + slip
        kf.predict(0.05, left, left + difference, rate)
        kf.predict(0.05, left, left + difference, rate)
        other = KalmanFilter(N, 1)
        other.P, other.R[0, 0] = kf.P.copy(), noise.comparison_rad2 + noise.timing_s2 * rate**2
        other.H[0, HEADING], other.H[0, GYRO_HEADING] = 1.0, -1.0
        before = vector(kf.nominal)
        z = kf.nominal.heading_rad - kf.nominal.gyro_heading_rad
        # Beyond three standard deviations the wheels have slipped by what is too much.
        S = float((other.H @ other.P @ other.H.T + other.R)[0, 0])
        other.P[HEADING, HEADING] += max(z * z / 9.0 - S, 0.0)
        other.update(np.array([[z]]))
        assert kf.update(rate) is Outcome.ACCEPTED
        np.testing.assert_allclose(before - vector(kf.nominal), other.x[:, 0], rtol=1e-9, atol=1e-13)
        np.testing.assert_allclose(kf.P, other.P, rtol=1e-7, atol=1e-13)


def test_a_lag_beyond_its_limit_becomes_the_nearest_possible_one_given_the_comparison() -> None:
    kf = make(make_noise("physical", Noise(), TREAD_M), sigmas=dataclasses.replace(SIGMAS, wheel_lag_s=0.2))
    kf.nominal.tread_m = TREAD_M
    kf.predict(0.1, 0.1, 0.1, 0.0)
    kf.predict(0.1, 0.1 - 0.03 * TREAD_M, 0.1 + 0.03 * TREAD_M, 0.6)  # both turn at once, then the wheels ahead
    kf.nominal.heading_rad += 0.2
    before, P = vector(kf.nominal), kf.P.copy()
    assert kf.update(0.6) is Outcome.ACCEPTED
    K = kf.gain
    P -= np.outer(K, K) * kf.S
    expected = before - K * kf.z
    lag_s = expected[WHEEL_LAG]
    assert lag_s < LEAST_LAG_S
    expected -= P[WHEEL_LAG] * (lag_s - LEAST_LAG_S) / P[WHEEL_LAG, WHEEL_LAG]
    np.testing.assert_allclose(vector(kf.nominal), expected, rtol=1e-9, atol=1e-12)


def test_the_corrected_headings_agree_better() -> None:
    kf = make()
    kf.predict(0.05, 0.05, 0.06, 0.2)
    before = abs(kf.nominal.heading_rad - kf.nominal.gyro_heading_rad)
    assert kf.update(0.2) is Outcome.ACCEPTED
    assert abs(kf.nominal.heading_rad - kf.nominal.gyro_heading_rad) < before


@settings(max_examples=100, deadline=None)
@given(st.lists(st.tuples(small, small, st.floats(-3.0, 3.0)), min_size=1, max_size=30))
def test_no_contradiction_however_far_breaks_the_filter(steps: list[tuple[float, float, float]]) -> None:
    kf = Filter(TREAD_M, SIGMAS, make_noise("physical", Noise(), TREAD_M), gate_sigma=1e6)
    for left, right, rate in steps:
        kf.predict(0.05, left, right, rate)
        assert kf.update(rate) is not Outcome.NOT_FINITE
        assert kf.nominal.tread_m > 0.0
        assert np.linalg.eigvalsh(kf.P)[0] > -1e-9


def test_a_rejected_measurement_changes_nothing() -> None:
    kf = make()
    kf.predict(0.05, 0.05, 0.06, 0.2)
    kf.nominal.heading_rad += 3.0
    P, nominal = kf.P.copy(), dataclasses.replace(kf.nominal)
    assert kf.update(0.2) is Outcome.REJECTED
    assert np.array_equal(kf.P, P)
    assert kf.nominal == nominal


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("where", ["heading", "covariance", "variance"])
def test_a_measurement_that_is_not_finite_changes_nothing(bad: float, where: str) -> None:
    kf = make()
    kf.predict(0.05, 0.05, 0.06, 0.2)
    if where == "heading":
        kf.nominal.heading_rad = bad
    elif where == "covariance":
        kf.P[GYRO_BIAS, HEADING] = kf.P[HEADING, GYRO_BIAS] = bad
    else:
        kf.P[HEADING, HEADING] = bad
    P, nominal = kf.P.copy(), dataclasses.replace(kf.nominal)
    assert kf.update(0.2) is Outcome.NOT_FINITE
    assert np.array_equal(kf.P, P, equal_nan=True)
    assert repr(kf.nominal) == repr(nominal)
    assert not kf.is_finite()


def test_the_variant_for_a_calibrated_gyro_leaves_the_scale_out() -> None:
    kf = make(make_noise("physical", Noise(), TREAD_M), sigmas=dataclasses.replace(SIGMAS, gyro_scale=0.0))
    for _ in range(200):
        kf.predict(0.05, 0.05, 0.06, 0.4)
        kf.update(0.4)
    assert kf.nominal.gyro_scale == 1.0
    assert not kf.P[GYRO_SCALE].any()


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["physical", "paper"]))
def test_covariance_stays_symmetric_and_positive(seed: int, profile: str) -> None:
    rng = np.random.default_rng(seed)
    kf = Filter(TREAD_M, SIGMAS, make_noise(profile, Noise(), TREAD_M))
    for _ in range(300):
        left, right = rng.uniform(-0.1, 0.1, 2)
        kf.predict(0.05, left, right, (right - left) / TREAD_M / 0.05 + 0.01 * rng.normal())
        kf.update(0.0)
    np.testing.assert_allclose(kf.P, kf.P.T, rtol=1e-9, atol=1e-12)
    assert np.linalg.eigvalsh(0.5 * (kf.P + kf.P.T)).min() > -1e-9 * np.trace(kf.P)


def test_two_half_steps_grow_as_much_as_one() -> None:
    whole, halves = (make(make_noise("physical", Noise(), TREAD_M)) for _ in range(2))
    whole.predict(0.1, 0.1, 0.1, 0.0)
    for _ in range(2):
        halves.predict(0.05, 0.05, 0.05, 0.0)
    np.testing.assert_allclose(np.diag(whole.P), np.diag(halves.P), rtol=1e-3)


def test_the_papers_noise_is_its_printed_values_per_step() -> None:
    kf = make(paper(), sigmas=Sigmas(0, 0, 0, 0, 1e-30, 0))
    kf.predict(0.05, 0.0, 0.0, None)
    printed = [0.1, 0.1, math.radians(0.7), 2e-5, 2e-5, 2e-5]
    np.testing.assert_allclose(np.sqrt(np.diag(kf.P))[:6], printed, rtol=1e-9)
    kf.predict(0.05, 0.0, 0.0, None)
    printed = [math.radians(1e-4), 3e-5, math.radians(1e-5)]
    np.testing.assert_allclose(np.sqrt(np.diag(kf.P))[6:9], printed, rtol=1e-9)
    assert not kf.P[WHEEL_LAG:].any()  # the paper has neither of the two


def test_a_standing_robots_wheels_teach_the_gyros_bias() -> None:
    kf = make(make_noise("physical", Noise(), TREAD_M))
    for _ in range(600):
        kf.predict(0.05, 0.0, 0.0, 5e-4)
        kf.update(5e-4)
    assert kf.nominal.gyro_bias_rad_s == pytest.approx(-5e-4, abs=5e-5)
    assert kf.sigma(GYRO_BIAS) < 5e-5
    assert abs(kf.nominal.heading_rad) < 1e-9


def test_anchors_copy_heading_and_error() -> None:
    kf = make()
    kf.predict(0.05, 0.05, 0.06, 0.2)
    kf.anchor_gyro()
    assert kf.nominal.gyro_heading_rad == kf.nominal.heading_rad
    assert np.array_equal(kf.P[GYRO_HEADING], kf.P[HEADING])
    kf.nominal.gyro_heading_rad += 0.1
    kf.anchor_wheels()
    assert kf.nominal.heading_rad == kf.nominal.gyro_heading_rad


def test_set_pose_takes_the_pose_and_keeps_what_was_learned() -> None:
    kf = make()
    kf.nominal.scale_left, kf.nominal.gyro_bias_rad_s = 0.01, 1e-4
    kf.predict(0.05, 0.05, 0.06, 0.2)
    learned = kf.P[3:6, 3:6].copy()
    kf.set_pose(1.0, 2.0, 3.0, np.diag([0.01, 0.04, 0.09]))
    n = kf.nominal
    assert (n.x_m, n.y_m, n.heading_rad, n.gyro_heading_rad) == (1.0, 2.0, 3.0, 3.0)
    assert (n.scale_left, n.gyro_bias_rad_s) == (0.01, 1e-4)
    assert kf.pose_covariance() == (0.01, 0.0, 0.0, 0.04, 0.0, 0.09)
    assert np.array_equal(kf.P[3:6, 3:6], learned)
    assert kf.P[GYRO_HEADING, GYRO_HEADING] == kf.P[GYRO_HEADING, HEADING] == 0.09
    assert kf.update(0.0) is Outcome.ACCEPTED


def test_a_filter_that_starts_again_has_corrected_nothing() -> None:
    kf = make()
    kf.predict(0.1, 0.1, 0.101, 0.0)
    assert kf.update(0.0) is Outcome.ACCEPTED
    assert kf.corrected_rad != 0.0
    kf.restart(TREAD_M, SIGMAS)
    assert (kf.corrected_x_m, kf.corrected_y_m, kf.corrected_rad) == (0.0, 0.0, 0.0)
