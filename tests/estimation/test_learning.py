"""Learning on the way: the gyro's noise at rest, the wheels' noise, their lag, how the robot steers; and standing."""

import json
import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sensors import NO_BIAS, ROBOT, T0, S, Sample, drive, feed, make

from drd.arrays import Array
from drd.config.keys import Config
from drd.config.schema import loads
from drd.effects.compensation import Compensation
from drd.effects.model import make_model
from drd.estimation.estimate import SKID_SCALE, SKID_SLIP_S, WHEEL_SCALE, estimate_of
from drd.estimation.estimator import Estimator
from drd.estimation.filter import LEAST_LAG_S, Filter
from drd.estimation.learned_values import LEARNED, NOT_YET, OUTSIDE, learned_values
from drd.estimation.learning import BLOCK_S, GUARD_S, Drive, RestNoise, VarianceFactor
from drd.estimation.noise import NoiseProfile
from drd.estimation.state import GYRO_HEADING, HEADING, SCALE_L, SCALE_R, TREAD, WHEEL_LAG, N, Sigmas, X, Y
from drd.samples import GyroSample, WheelSample
from drd.units import RAD_PER_DEG, RAD_PER_SQRT_S_PER_DEG_PER_SQRT_H

GYRO_S, WHEEL_S = 0.1, 0.05


# ---- the gyro's noise at rest ----------------------------------------------------------------------------------


def at_rest(noise: RestNoise, rates: Array, interval_s: float = GYRO_S) -> RestNoise:
    for rate in rates:
        noise.add(float(rate), interval_s)
    return noise


def test_the_noise_at_rest_is_found_without_bias_whatever_the_gyros_own_bias() -> None:
    n = 5.0 * RAD_PER_SQRT_S_PER_DEG_PER_SQRT_H
    rng = np.random.default_rng(1)
    found = [at_rest(RestNoise(1e-12), 0.01 + n / math.sqrt(GYRO_S) * rng.normal(size=600)) for _ in range(100)]
    ratios = np.array([f.variance_rad2_per_s for f in found]) / n**2
    # 57 differences of neighbouring blocks, whose squares are correlated by a quarter: 0.2 each, 0.02 the mean of 100.
    assert ratios.mean() == pytest.approx(1.0, abs=0.08)
    assert ratios.std() < 0.35


def test_a_noise_below_the_stated_one_is_never_believed() -> None:
    found = at_rest(RestNoise(1e-6), np.zeros(600))
    assert found.known
    assert found.variance_rad2_per_s == 1e-6


@pytest.mark.parametrize("first_s", [4.0, 10.0])
def test_who_turns_the_robot_by_hand_makes_no_noise(first_s: float) -> None:
    n = 0.1 * RAD_PER_SQRT_S_PER_DEG_PER_SQRT_H
    rates = n / math.sqrt(GYRO_S) * np.random.default_rng(2).normal(size=200)
    rates[round(first_s / GYRO_S) : round((first_s + 5.0) / GYRO_S)] += 0.5
    noise = at_rest(RestNoise(n**2), rates)
    assert noise.differences > 15
    assert 10.0 * math.sqrt(noise.variance_rad2_per_s / GYRO_S) < 0.5  # a gate of 5 sigma finds such a turn


def test_neither_end_of_a_standstill_enters() -> None:
    rates = np.zeros(200)
    rates[: round(GUARD_S / GYRO_S)] = rates[-round(GUARD_S / GYRO_S) :] = 1.0
    noise = at_rest(RestNoise(1e-12), rates)
    noise.interrupt()
    at_rest(noise, np.zeros(3))
    assert noise.differences > 10
    assert noise.variance_rad2_per_s < 1e-10


def test_short_stops_tell_nothing() -> None:
    noise = RestNoise(1e-12)
    for _ in range(20):
        at_rest(noise, np.ones(round((BLOCK_S + GUARD_S) / GYRO_S)))
        noise.interrupt()
    assert not noise.known


# ---- the wheels' noise -----------------------------------------------------------------------------------------


@given(st.floats(1.0, 30.0), st.integers(0, 1000))
def test_a_variance_factor_is_the_likeliest_one(true: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    factor = VarianceFactor(1.0, 4.0, 100.0)
    for _ in range(3000):
        others = float(rng.uniform(0.1, 1.0))
        share = factor.factor * 1.0
        factor.take(share, math.sqrt(true + others) * float(rng.normal()), share + others)
    # 600 comparisons are remembered; outliers are cut at 9 S, which costs 1 %.
    assert factor.factor == pytest.approx(max(true, 1.0), rel=0.3)


def test_a_variance_factor_keeps_within_its_limits() -> None:
    factor = VarianceFactor(1.0, 1.0, 10.0)
    for z in (0.0, 1e6):
        for _ in range(5000):
            factor.take(factor.factor, z, factor.factor + 1e-3)
        assert factor.factor == (1.0 if z == 0.0 else 10.0)


# ---- lag -------------------------------------------------------------------------------------------------------


def late(samples: Iterator[tuple[float, Sample]], lag_s: float) -> list[tuple[float, Sample]]:
    """The same motion with wheels that tell of it later: their stamps are those of their arrival."""
    moved = [
        (t + lag_s, s._replace(t_ns=s.t_ns + round(lag_s * S))) if isinstance(s, WheelSample) else (t, s)
        for t, s in samples
    ]
    return sorted(moved, key=lambda event: event[0])


@pytest.mark.parametrize("lag_s", [0.0, 0.05, 0.15, 0.3])
def test_the_wheels_lag_is_learned_and_the_pose_is_where_the_robot_is(lag_s: float) -> None:
    truth = {p.t_ns: p for p in feed(make(), drive(60.0, stand_s=5.5))}
    e = make()
    poses = feed(e, late(drive(60.0, stand_s=5.5), lag_s))
    assert e.filter.nominal.wheel_lag_s == pytest.approx(lag_s, abs=max(0.003, 3.0 * e.filter.sigma(WHEEL_LAG)))
    assert e.filter.sigma(WHEEL_LAG) < 0.02
    last = next(p for p in reversed(poses) if p.t_ns in truth)
    there = truth[last.t_ns]
    off_m = math.dist((last.x_m, last.y_m), (there.x_m, there.y_m))
    assert off_m < last.position_bound_m
    assert off_m < 0.011 * 54.5  # of the way: the first turn, while the lag was not known
    assert last.heading_rad == pytest.approx(there.heading_rad, abs=0.02)


def test_a_late_gyro_is_a_negative_lag() -> None:
    e = make()
    feed(e, late(drive(60.0, stand_s=5.0), -0.06))
    assert e.filter.nominal.wheel_lag_s == pytest.approx(-0.06, abs=max(0.003, 3.0 * e.filter.sigma(WHEEL_LAG)))


def test_wheels_run_ahead_of_the_gyro_by_what_a_gyro_can_be_late_at_most() -> None:
    e = make()
    feed(e, late(drive(60.0, stand_s=5.0), -0.2))
    assert LEAST_LAG_S <= e.filter.nominal.wheel_lag_s < 0.5 * LEAST_LAG_S


def test_no_pose_is_left_behind_where_the_lag_is_as_long_as_a_wheel_sample() -> None:
    # A lag of 50 ms now uses up the gyro's newest sample, and now does not.
    truth = {p.t_ns: p.heading_rad for p in feed(make(), drive(60.0, stand_s=5.0))}
    e = make()
    poses = [p for p in feed(e, late(drive(60.0, stand_s=5.0), 0.05)) if p.t_ns > 30 * S and p.t_ns in truth]
    off_rad = max(abs(p.heading_rad - truth[p.t_ns]) for p in poses)
    assert len(poses) > 400
    assert off_rad < 0.01  # the fastest turn of 0.4 rad/s lasts 0.02 rad in that time


def test_a_walking_lag_leaves_nothing_in_the_heading_once_the_robot_goes_straight() -> None:
    e = make()
    kf = Filter(0.5, e.sigmas, replace(e.noise, wheel_lag_s2_per_s=0.01**2))
    still = Filter(0.5, e.sigmas, replace(e.noise, wheel_lag_s2_per_s=0.0))
    for rate_rad_s in (*[0.5] * 200, *[0.0] * 20):
        for one in (kf, still):
            one.predict(0.05, 0.0, 0.0, rate_rad_s)
    assert kf.sigma(WHEEL_LAG) > 0.03
    assert kf.sigma(GYRO_HEADING) == pytest.approx(still.sigma(GYRO_HEADING), rel=1e-3)


# ---- how it steers ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("tread_m", "drive_kind"), [(0.5, Drive.DIFFERENTIAL), (0.85, Drive.SKID)])
def test_the_effective_tread_tells_how_the_robot_steers(tread_m: float, drive_kind: Drive) -> None:
    e = make()
    assert e.knowledge.steering.drive.value == "unknown"
    feed(e, drive(40.0, tread_m=tread_m))
    assert e.knowledge.steering.drive == drive_kind
    assert e.filter.nominal.tread_m == pytest.approx(tread_m, rel=0.02)
    told = learned_values(e, loads(NO_BIAS, Config).value)
    assert told["tread_m"]["verdict"] == (OUTSIDE if drive_kind is Drive.SKID else LEARNED)
    # No sensor tells both wheels' scale: it stays as unsure as it was.
    common = math.sqrt(e.filter.P[SCALE_R, SCALE_R] + e.filter.P[SCALE_L, SCALE_L] + 2.0 * e.filter.P[SCALE_R, SCALE_L])
    assert 0.5 * common > 0.9 * (SKID_SCALE if drive_kind is Drive.SKID else 0.005 / math.sqrt(2.0))


def test_what_it_may_have_slipped_is_gone_once_it_is_known_not_to_slip() -> None:
    free, bound = make(), make(NO_BIAS.replace("{static", "{initial: {slip_s: 0}, static"))
    samples = list(drive(40.0))
    first = [(t, sample) for t, sample in samples if t < 3.0]
    feed(free, first)
    feed(bound, first)
    assert np.trace(free.filter.P[:2, :2]) > 1.5 * np.trace(bound.filter.P[:2, :2])
    feed(free, samples[len(first) :])
    feed(bound, samples[len(first) :])
    assert free.knowledge.steering.drive is Drive.DIFFERENTIAL
    assert free.filter.P[:2, :2] == pytest.approx(bound.filter.P[:2, :2], rel=1e-6)
    assert free.filter.nominal == bound.filter.nominal


def test_a_tread_between_those_of_both_drives_is_not_decided_yet() -> None:
    e = make()
    e.filter.set_tread(1.12 * e.filter.nominal.tread_m)
    e.filter.forget(TREAD, 0.03 * e.filter.nominal.tread_m)
    e.knowledge.steering.watch(e.filter)
    assert e.knowledge.steering.drive.value == "unknown"
    e.filter.forget(TREAD, 0.005 * e.filter.nominal.tread_m)
    e.knowledge.steering.watch(e.filter)
    assert e.knowledge.steering.drive.value == "unknown"  # turns on the spot say nothing of wheels that are not alike
    for wheel in (SCALE_R, SCALE_L):
        e.filter.forget(wheel, 0.003)
    e.knowledge.steering.watch(e.filter)
    assert e.knowledge.steering.drive is Drive.DIFFERENTIAL


def test_a_turn_that_the_gyro_missed_is_told_anew_once_the_tread_is_known() -> None:
    """1.8 of the stated tread, 2.5 rad without a gyro: a heading that goes with dD, not with 1/D, is 1 rad off."""
    e, random = make(ROBOT), np.random.default_rng(1)
    for step in range(1, 561):
        t_ns, turns, drives = T0 + step * S // 20, 220 < step <= 420, step > 160
        half = 0.5 * 0.9 * 0.5 * 0.05 * turns
        left, right = 0.05 * drives + np.array((-half, half)) + 0.001 * drives * random.normal(size=2)
        pose = e.add_wheels(WheelSample(t_ns, 0.05, float(left), float(right), 0.0))
        if step % 2 == 0 and not 210 < step <= 320:
            e.add_gyro(GyroSample(t_ns, 0.1, 0.5 * turns + 1e-4 * float(random.normal()), 25.0))
    assert pose is not None
    assert e.knowledge.steering.drive is Drive.SKID
    sigma_rad = math.sqrt(pose.covariance[5])
    assert pose.heading_rad == pytest.approx(5.0, abs=1.5 * sigma_rad)
    assert sigma_rad < 0.4


def test_slip_that_is_taken_back_does_not_turn_the_robot_by_the_turn_that_the_gyro_missed() -> None:
    """Each tread that slip has taught, and that is taken back, would tell the turn of the wheels alone anew."""

    def heading_rad(t_s: float) -> float:  # 1 rad that no gyro sees, then a slalom
        return 0.5 * min(max(t_s - 5.0, 0.0), 2.0) + 0.625 * (1.0 - math.cos(0.8 * max(t_s - 8.5, 0.0)))

    e = make(ROBOT + "estimation: {static_bias: {duration_s: 0}}\n")
    random = np.random.default_rng(1)
    for step in range(1, 601):
        t_s = step / 20
        turn_rad = heading_rad(t_s - 0.15) - heading_rad(t_s - 0.2)  # late wheels
        left_m, slipped_m = 0.04 * (t_s > 3.0) - 0.25 * turn_rad, 0.03 * (9.65 < t_s <= 11.15)
        pose = e.add_wheels(WheelSample(T0 + step * S // 20, 0.05, left_m, left_m + 0.5 * turn_rad + slipped_m, 0.0))
        if step % 2 == 0 and not 4.0 < t_s <= 7.0:
            rate = (heading_rad(t_s) - heading_rad(t_s - 0.1)) / 0.1 + 7.6e-5 * float(random.normal())
            e.add_gyro(GyroSample(T0 + step * S // 20, 0.1, rate, 25.0))
    assert pose is not None
    assert e.counters["released"] > 0
    assert pose.heading_rad == pytest.approx(heading_rad(30.0), abs=0.3)


def test_a_reload_keeps_the_turn_that_the_wheels_alone_have_told() -> None:
    text = ROBOT + "estimation: {static_bias: {duration_s: 0}}\n"
    e, other = make(text), make(text)
    for step in range(1, 41):
        e.add_wheels(WheelSample(T0 + step * S // 20, 0.05, 0.04, 0.06, 0.0))
        if step <= 4:
            e.add_gyro(GyroSample(T0 + step * S // 20, 0.05, 0.0, 25.0))
    other.take_over(e, same_wheels=True, same_gyro=True, same_lag=True, same_model=True)
    track = other.knowledge._track
    assert track.alone_rad == e.knowledge._track.alone_rad > 0.1
    assert track.alone_tread_m == e.knowledge._track.alone_tread_m


def test_what_the_wheels_have_told_goes_with_one_over_the_tread() -> None:
    kf, turn_rad = make().filter, 2.0
    turns_by_rad = -turn_rad / 0.5
    kf.P[TREAD, TREAD] = 0.1**2
    kf.spread_error(TREAD, {HEADING: turns_by_rad, GYRO_HEADING: turns_by_rad})
    kf.nominal.heading_rad = kf.nominal.gyro_heading_rad = turn_rad + turns_by_rad * 0.3  # as an update has it
    kf.nominal.tread_m = 0.8
    kf.tell_turn_anew(turn_rad, 0.5)
    kf.predict(0.1, 0.0, 0.0, None)
    for heading in (HEADING, GYRO_HEADING):
        assert kf.P[heading, TREAD] / kf.P[TREAD, TREAD] == pytest.approx(-turn_rad * 0.5 / 0.8**2)
    assert kf.nominal.heading_rad == pytest.approx(turn_rad * 0.5 / 0.8)
    assert kf.nominal.gyro_heading_rad == pytest.approx(turn_rad * 0.5 / 0.8)


def test_a_straight_line_does_not_tell_it_and_the_bound_covers_both() -> None:
    straight = [
        (t, s._replace(rate_rad_s=0.0) if isinstance(s, GyroSample) else s._replace(left_m=0.05, right_m=0.05))
        for t, s in drive(20.0)
    ]
    e = make()
    poses = feed(e, straight)
    assert e.knowledge.steering.drive is Drive.UNKNOWN
    assert poses[-1].position_bound_m > 3.0 * SKID_SCALE * 20.0
    assert learned_values(e, loads(NO_BIAS, Config).value)["tread_m"]["verdict"] == NOT_YET


def test_the_scale_of_all_ways_stays_unobservable_while_the_tread_is_found() -> None:
    """Linearised where the tread is estimated anew each time, comparisons would seem to tell it."""
    noise = NoiseProfile(comparison_rad2=1e-7, turn_rad2_per_rad=1e-4, wheel_m2_per_m=1e-6)
    kf = Filter(0.5, Sigmas(0.0, 0.0, 0.005, 0.25, 0.0, 0.0), noise, gate_sigma=100.0)
    kf.add_scale_variance(0.04, 0.0)
    for i in range(400):
        rate = 0.5 * math.sin(0.1 * i)
        half_m = 0.5 * 0.9 * rate * WHEEL_S
        kf.predict(WHEEL_S, 0.05 - half_m, 0.05 + half_m, rate)
        kf.update(rate)
    assert kf.nominal.tread_m == pytest.approx(0.9, rel=0.02)
    n = kf.nominal
    g = np.zeros(N)
    g[X], g[Y], g[SCALE_R], g[SCALE_L], g[TREAD] = n.x_m, n.y_m, 1.0, 1.0, n.tread_m
    information = float(g @ np.linalg.pinv(kf.P, rcond=1e-14) @ g)
    assert information == pytest.approx(1.0 / (0.04**2 + 0.005**2 / 2.0), rel=0.02)
    assert abs(n.scale_right + n.scale_left) < 0.004


# ---- standing --------------------------------------------------------------------------------------------------


def turns_then_rest(rng: np.random.Generator, deg_per_sqrt_h: float, bias_rad_s: float, rest_s: float) -> Iterator[tuple[float, Sample]]:  # fmt: skip  # noqa: E501
    """Two turns as `drive` makes them, with noise as a datasheet has it, then wheels that stand."""
    n = deg_per_sqrt_h * RAD_PER_SQRT_S_PER_DEG_PER_SQRT_H / math.sqrt(GYRO_S)
    moving_s = 30.0
    for t_s, true in drive(moving_s):
        noise = bias_rad_s + n * float(rng.normal())
        yield t_s, true._replace(rate_rad_s=true.rate_rad_s + noise) if isinstance(true, GyroSample) else true
    for step in range(1, round(rest_s / WHEEL_S) + 1):
        t_s = moving_s + step * WHEEL_S
        stamp_ns = T0 + round(t_s * S)
        yield t_s, WheelSample(stamp_ns, WHEEL_S, 0.0, 0.0, 0.0)
        if step % 2 == 0:
            yield t_s, GyroSample(stamp_ns, GYRO_S, bias_rad_s + n * float(rng.normal()), 25.0)


@pytest.mark.parametrize(("stated", "true"), [(0.083, 0.083), (0.42, 0.42), (0.42, 5.0)])
def test_an_hour_at_rest_after_turns_moves_nothing(stated: float, true: float) -> None:
    config = NO_BIAS.replace("{static", f"{{noise: {{gyro_deg_per_sqrt_h: {stated}}}, static")
    e = make(config)
    rest_s, bias = 3600.0, 1e-4
    poses = feed(e, turns_then_rest(np.random.default_rng(3), true, bias, rest_s))
    before = next(p for p in poses if p.t_ns >= T0 + 31 * S)
    alone_rad = true * RAD_PER_DEG * math.sqrt(rest_s / 3600.0)  # what the gyro's noise alone makes of an hour
    assert abs(poses[-1].heading_rad - before.heading_rad) < 3.0 * alone_rad
    # The bias that is found at rest mends the way before, too, by no more than was claimed.
    assert math.dist((poses[-1].x_m, poses[-1].y_m), (before.x_m, before.y_m)) < 0.5 * before.position_bound_m
    assert e.filter.nominal.gyro_scale == pytest.approx(1.0, abs=0.01)
    # And the bias is known as well as an hour of this noise allows.
    sigma = true * RAD_PER_SQRT_S_PER_DEG_PER_SQRT_H / math.sqrt(rest_s)
    assert -e.filter.nominal.gyro_bias_rad_s == pytest.approx(bias, abs=5.0 * max(sigma, 1e-5))


@pytest.mark.parametrize("heading", ["filter", "gyro"])
def test_a_later_stop_teaches_the_bias_in_both_modes(heading: str) -> None:
    e = make(ROBOT + f"estimation: {{heading: {heading}, static_bias: {{duration_s: 0}}}}\n")
    feed(e, turns_then_rest(np.random.default_rng(5), 0.083, 3e-4, 60.0))
    assert -e.filter.nominal.gyro_bias_rad_s == pytest.approx(3e-4, abs=3e-5)


# ---- kept ------------------------------------------------------------------------------------------------------


def test_what_was_learned_is_kept_in_the_state() -> None:
    e = make()
    feed(e, late(turns_then_rest(np.random.default_rng(7), 5.0, 0.0, 40.0), 0.1))
    saved = e.estimate()
    assert saved is not None
    again: Estimator = make()
    again.resume(estimate_of(json.loads(json.dumps(saved.plain()))), bias_known=True)
    assert again.knowledge.steering.drive is e.knowledge.steering.drive
    assert again.knowledge.rest_noise.known
    assert again.knowledge.rest_noise.variance_rad2_per_s == pytest.approx(
        e.knowledge.rest_noise.variance_rad2_per_s, rel=1e-9
    )
    assert again.filter.noise.turn_rad2_per_rad == pytest.approx(e.filter.noise.turn_rad2_per_rad, rel=1e-9)
    assert again.filter.nominal.wheel_lag_s == e.filter.nominal.wheel_lag_s
    assert again.filter.P[HEADING, HEADING] == saved.P[HEADING, HEADING]


@pytest.mark.parametrize(("stated", "expected_s"), [("0.2", 0.02), ("0.01", 0.01)])
def test_the_filter_sets_out_as_unsure_as_the_model_or_the_configuration_whichever_knows_more(
    stated: str, expected_s: float
) -> None:
    terms = [
        {"effect": "tread_error", "parameters": {"k": {"value": 0.5, "std": 0.06}}},
        {"effect": "encoder_latency", "parameters": {"delay": {"value": 0.17, "std": 0.02}}},
        {"effect": "lateral_slip_turning", "parameters": {"k": {"value": 0.16}}},  # how well it is known nobody says
        {"effect": "wheel_radius_error", "parameters": {"left": {"value": 0.01, "std": 1e-5}, "right": {"value": 0.0}}},
    ]
    text = ROBOT + f"estimation: {{static_bias: {{duration_s: 0}}, initial: {{wheel_lag_s: {stated}}}}}\n"
    config = loads(text, Config).value
    removal = Compensation(make_model(terms).terms, config.robot, has_gyro=True)
    sigmas = Estimator(config, compensation=removal).sigmas
    assert sigmas.tread_m == pytest.approx(0.06 / 1.5 * config.robot.tread_m)  # of the effective tread
    assert sigmas.wheel_lag_s == pytest.approx(expected_s)
    assert sigmas.slip_s == SKID_SLIP_S
    assert sigmas.wheel_scale == WHEEL_SCALE  # tyres differ from day to day


@pytest.mark.parametrize(("k", "drive_kind"), [(0.7, Drive.SKID), (0.05, Drive.UNKNOWN)])
def test_a_models_effective_tread_tells_how_the_robot_steers(k: float, drive_kind: Drive) -> None:
    tread = make_model([{"effect": "tread_error", "parameters": {"k": {"value": k, "std": 0.02}}}])
    config = loads(NO_BIAS, Config).value
    removal = Compensation(tread.terms, config.robot, has_gyro=True)
    e = Estimator(config, compensation=removal)
    assert removal.relative_tread == pytest.approx(1.0 + k)
    assert e.knowledge.steering.drive is drive_kind
    feed(e, drive(40.0, tread_m=0.5 * (1.0 + k)))
    # Taken off, the tread is the nominal one: nothing on the way would tell.
    assert e.knowledge.steering.drive is (Drive.SKID if drive_kind is Drive.SKID else Drive.DIFFERENTIAL)
