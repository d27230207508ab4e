import math

import numpy as np
import pytest

from drd.config.keys import Noise
from drd.estimation.filter import Filter
from drd.estimation.hindsight import SPAN_NS, Hindsight
from drd.estimation.noise import make_noise
from drd.estimation.state import GYRO_HEADING, GYRO_SCALE, HEADING, SCALE_L, SCALE_R, TREAD, WHEEL_LAG, Sigmas

TREAD_M = 0.5
STATES = (SCALE_R, SCALE_L, TREAD, WHEEL_LAG)
SIGMAS = Sigmas(0.0, 0.0, 0.005, 0.25, 0.005, 1e-4, wheel_lag_s=0.2, scale_difference=0.04)


def make() -> Filter:
    return Filter(TREAD_M, SIGMAS, make_noise("physical", Noise(), TREAD_M))


def learn(kf: Filter, slip: float = 0.0) -> None:
    """A second in a curve, in which the right wheel turns more than the robot by `slip`."""
    for _ in range(10):
        kf.predict(0.1, 0.08, (0.08 + 0.04 * TREAD_M) * (1.0 + slip), 0.4)
        kf.update(0.4)


def test_what_slip_has_taught_is_taken_back() -> None:
    kf, seen = make(), Hindsight()
    learn(kf)
    seen.watch(kf, 1)
    n, before = kf.nominal, kf.P[np.ix_(STATES, STATES)]
    known = n.scale_right, n.scale_left, n.tread_m, n.wheel_lag_s
    learn(kf, slip=0.05)
    assert n.tread_m != pytest.approx(known[2], abs=0.02)
    seen.take_back(kf, seen.before, 2)
    assert (n.scale_right, n.scale_left, n.tread_m, n.wheel_lag_s) == known
    np.testing.assert_array_equal(kf.P[np.ix_(STATES, STATES)], before)
    # As late as the lag says both headings are, the robot turns at 0.4 rad/s; the rest is by way of the gyro's scale.
    for heading in (HEADING, GYRO_HEADING):
        assert kf.P[heading, WHEEL_LAG] == pytest.approx(-kf.rate_rad_s * kf.P[WHEEL_LAG, WHEEL_LAG], rel=1e-3)
    assert np.linalg.eigvalsh(kf.P)[0] > -1e-12


def test_taken_back_again_and_again_the_headings_are_not_known_worse_each_time() -> None:
    kf, seen = make(), Hindsight()
    learn(kf)
    seen.watch(kf, 1)
    sigmas = []
    for i in range(20):
        seen.take_back(kf, seen.before, 2 + i)
        sigmas.append(kf.sigma(GYRO_HEADING))
    assert sigmas[-1] == pytest.approx(sigmas[0], rel=1e-2)


def test_taken_back_again_and_again_the_turns_of_one_gyro_have_one_scale() -> None:
    kf, seen = make(), Hindsight()
    for i in range(20):
        kf.predict(0.1, 0.0, 0.0, 0.5)
        kf.turn_by_gyro_alone(0.05)  # by hand
        seen.watch(kf, 1 + i)
        seen.take_back(kf, seen.before, 2 + i)
    assert kf.P[GYRO_HEADING, GYRO_SCALE] == pytest.approx(1.0 * SIGMAS.gyro_scale**2, rel=0.01)
    assert kf.sigma(GYRO_HEADING) > 0.95 * SIGMAS.gyro_scale


def test_one_wheels_slip_is_half_of_it_in_the_middle() -> None:
    kf, seen = make(), Hindsight()
    seen.watch(kf, 1)
    for _ in range(10):
        seen.moved(0.1, 0.1 + TREAD_M * 0.02 + 0.03, 0.02)
    assert seen.slipped_m == pytest.approx(0.15)
    seen.begin(kf, 2)
    assert seen.slipped_m == 0.0


def test_what_was_long_ago_is_no_doubt_any_more() -> None:
    kf, seen = make(), Hindsight()
    seen.watch(kf, 1)
    kf.nominal.wheel_lag_s = 0.1
    assert seen.lag_doubt_s2(kf) == pytest.approx(0.1**2)
    for i in range(1, 4):
        seen.watch(kf, 1 + i * (SPAN_NS + 1))
    assert seen.lag_doubt_s2(kf) == 0.0


def test_a_turn_that_has_just_begun_leaves_the_lag_as_unknown_as_it_was() -> None:
    kf, seen = make(), Hindsight()
    seen.watch(kf, 1)
    for i in range(8):  # 0.16 s of a turn, of which wheels that are 0.3 s late know nothing
        kf.predict(0.02, 0.02, 0.02, 0.01 * (i + 0.5))
        kf.update(0.01 * (i + 1))
    assert kf.sigma(WHEEL_LAG) < 0.7 * SIGMAS.wheel_lag_s
    assert kf.sigma(WHEEL_LAG) ** 2 + seen.lag_doubt_s2(kf) >= SIGMAS.wheel_lag_s**2


def test_what_comparisons_have_corrected_is_in_doubt_for_some_seconds() -> None:
    kf, seen = make(), Hindsight()
    kf.anchor_gyro()
    kf.P[TREAD, GYRO_HEADING] = kf.P[GYRO_HEADING, TREAD] = 0.002  # a turn that the wheels alone have told
    kf.P[GYRO_HEADING, GYRO_HEADING] = 0.01
    seen.watch(kf, 1)
    kf.predict(0.1, 0.08, 0.12, 0.4)
    n = kf.nominal
    before = n.gyro_heading_rad, n.wheel_lag_s, n.x_m, n.y_m
    kf.update(0.4)
    lag_s, v = n.wheel_lag_s - before[1], 1.0
    turned_rad = n.gyro_heading_rad - before[0] + kf.rate_rad_s * lag_s
    x_m, y_m = n.x_m - before[2] + v * lag_s * math.cos(before[0]), n.y_m - before[3] + v * lag_s * math.sin(before[0])
    assert turned_rad != pytest.approx(0.0, abs=1e-3)
    assert seen.corrected(kf) == pytest.approx((x_m**2 + y_m**2, turned_rad**2), rel=0.01)
    for i in range(1, 4):
        seen.watch(kf, 1 + i * (SPAN_NS + 1))
    assert seen.corrected(kf) == (0.0, 0.0)


def test_what_is_given_from_elsewhere_is_not_taken_back() -> None:
    kf, seen = make(), Hindsight()
    seen.watch(kf, 1)
    kf.add_tread_variance(0.2**2)
    seen.watch(kf, 2)
    given_m = kf.sigma(TREAD)
    seen.take_back(kf, seen.before, 3)
    assert kf.sigma(TREAD) == given_m > math.sqrt(SIGMAS.tread_m**2)


def test_what_was_learned_is_taken_back_however_long_ago_that_was() -> None:
    kf, seen = make(), Hindsight()
    learn(kf)
    seen.watch(kf, 1)
    then = seen.now(kf)
    n, known_m, sigma_m = kf.nominal, kf.nominal.tread_m, kf.sigma(TREAD)
    apart_m = (1.0 - n.scale_right) * 0.09 - (1.0 - n.scale_left) * 0.08 - known_m * 0.01
    for i in range(1, 5):
        learn(kf, slip=0.05)
        seen.moved(0.08, 0.09, 0.01)
        seen.watch(kf, 1 + i * (SPAN_NS + 1))
    assert n.tread_m != pytest.approx(known_m, abs=0.02)
    assert seen.apart_rad(then) == pytest.approx(4.0 * apart_m / known_m)
    seen.take_back(kf, then, 2)
    assert n.tread_m == known_m
    assert kf.sigma(TREAD) == pytest.approx(sigma_m)
