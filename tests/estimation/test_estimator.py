"""The estimator over time: order, gaps, silence, standstill, slip."""

import math
import random
from collections.abc import Iterator
from itertools import pairwise

import pytest
from sensors import KNOWN, NO_BIAS, ROBOT, T0, S, Sample, drive, feed, final, make

from drd.estimation.calibration import Calibration
from drd.estimation.estimate import check_covariance
from drd.estimation.estimator import Estimator
from drd.estimation.uncertainty import lead_moments
from drd.samples import GyroSample, Pose, Validity, WheelSample


def largest_step_m(poses: list[Pose]) -> float:
    return max(math.hypot(b.x_m - a.x_m, b.y_m - a.y_m) for a, b in pairwise(poses))


def test_twenty_poses_a_second_at_the_wheels_times() -> None:
    poses = feed(make(), drive(10))
    assert len(poses) == 200
    assert [p.t_ns for p in poses] == [T0 + round(i * 0.05 * S) for i in range(1, 201)]
    assert [p.sequence for p in poses] == list(range(1, 201))
    assert all(p.validity is Validity.VALID for p in poses)


def test_perfect_sensors_give_the_path_and_a_growing_bound() -> None:
    poses = feed(make(KNOWN), drive(20))
    assert poses[-1].heading_rad == pytest.approx(0.5 * (1 - math.cos(16.0)), abs=1e-6)
    assert poses[100].position_bound_m < poses[-1].position_bound_m < 0.5


@pytest.mark.parametrize("lag_s", [0.02, 0.06, 0.12])
def test_the_gyros_transport_delay_does_not_change_the_estimate(lag_s: float) -> None:
    together = make()
    feed(together, drive(20))
    late = make()
    events = [(t + (lag_s if isinstance(s, GyroSample) else 0.0), s) for t, s in drive(20)]
    feed(late, sorted(events, key=lambda event: event[0]))
    a, b = together.filter.nominal, late.filter.nominal
    # The last gyro sample may still wait for its wheels; up to there the two are the same to the bit.
    assert (a.tread_m, a.gyro_scale) == pytest.approx((b.tread_m, b.gyro_scale), rel=1e-9)
    assert late.counters["late_gyro"] == 0
    assert late.counters["accepted"] >= together.counters["accepted"] - 2


def test_samples_of_one_moment_may_come_in_any_order() -> None:
    a, b = make(), make()
    feed(a, drive(10))
    feed(b, sorted(drive(10), key=lambda event: (event[0], isinstance(event[1], WheelSample))))
    assert a.filter.nominal == b.filter.nominal


def test_a_gyro_sample_that_comes_after_its_time_was_used_is_counted_and_dropped() -> None:
    e = make()
    feed(e, drive(5))
    feed(e, [(0.0, s) for _, s in drive(2, start_s=5.0) if isinstance(s, WheelSample)])
    before = e.counters["late_gyro"]
    feed(e, [(0.0, GyroSample(T0 + round(5.1 * S), 0.1, 50.0, 25.0))])
    assert e.counters["late_gyro"] == before + 1
    assert abs(e.filter.nominal.gyro_heading_rad) < 2.0


def test_the_standstill_measures_the_bias_and_the_pose_is_initialising_until_then() -> None:
    e = make(ROBOT)
    poses = feed(e, drive(30, stand_s=12.0, bias_rad_s=4e-4))
    states = [p.validity for p in poses]
    changed = states.index(Validity.VALID)
    assert set(states[:changed]) == {Validity.INITIALISING}
    assert poses[changed].t_ns - T0 == pytest.approx(10.45 * S, abs=0.2 * S)
    assert set(states[changed:]) == {Validity.VALID}
    assert -e.bias.bias_rad_s == pytest.approx(-4e-4, abs=1e-9)
    assert poses[-1].heading_rad == pytest.approx(0.5 * (1 - math.cos(0.8 * 18.0)), abs=2e-3)


def test_a_robot_that_moves_too_early_starts_without_a_bias_and_says_so() -> None:
    e = make(ROBOT)
    poses = feed(e, drive(15, stand_s=2.0, bias_rad_s=4e-4))
    moving = poses[45]
    assert moving.validity is Validity.DEGRADED
    assert "not measured" in moving.reasons[0].text
    travelled = sum(math.hypot(b.x_m - a.x_m, b.y_m - a.y_m) for a, b in pairwise(poses))
    assert travelled == pytest.approx(13.0, abs=0.05)  # no motion is lost


def test_a_standstill_that_is_cut_after_the_minimum_is_used() -> None:
    e = make(ROBOT)
    poses = feed(e, drive(15, stand_s=7.0, bias_rad_s=4e-4))
    assert e.counters["bias_measured"] == 1
    assert 5.0 < e.bias.averaged_s < 7.0
    assert e.bias.bias_rad_s == pytest.approx(4e-4, abs=1e-9)
    assert poses[-1].validity is Validity.VALID


def test_without_a_gyro_the_robot_can_start_and_the_reason_is_told() -> None:
    poses = feed(make(ROBOT), ((t, s) for t, s in drive(20, stand_s=3.0) if isinstance(s, WheelSample)))
    assert poses[30].validity is Validity.INITIALISING
    assert poses[-1].validity is Validity.DEGRADED
    assert {"fog"} <= {r.source for r in poses[-1].reasons}
    assert poses[-1].heading_rad == pytest.approx(0.5 * (1 - math.cos(0.8 * 17.0)), abs=1e-3)


def test_a_robot_that_has_no_gyro_is_simply_valid() -> None:
    e = make(NO_BIAS + "fog: {protocol: none}\n")
    poses = feed(e, ((t, s) for t, s in drive(5) if isinstance(s, WheelSample)))
    assert poses[-1].validity is Validity.VALID


def test_a_later_standstill_teaches_the_bias_that_the_start_missed() -> None:
    e = make(ROBOT)
    feed(e, drive(5, stand_s=1.0, bias_rad_s=4e-4))
    poses = feed(e, drive(60, stand_s=60.0, bias_rad_s=4e-4, start_s=5.0))
    assert poses[-1].validity is Validity.VALID
    assert e.filter.nominal.gyro_bias_rad_s == pytest.approx(-4e-4, abs=3e-5)


def test_the_bias_can_be_measured_again_only_while_the_robot_stands() -> None:
    e = make(ROBOT)
    feed(e, drive(14, stand_s=12.0, bias_rad_s=1e-4))
    assert e.calibrate_bias() == "the encoders do not confirm a standstill"
    other = make(ROBOT)
    feed(other, silence(drive(30, stand_s=30.0), GyroSample, 20.0, 30.0))
    assert other.calibrate_bias() == "no gyro"
    feed(e, drive(2, stand_s=2.0, bias_rad_s=3e-4, start_s=14.0))
    assert e.calibrate_bias() is None
    poses = feed(e, drive(14, stand_s=12.0, bias_rad_s=3e-4, start_s=16.0))
    assert e.counters["bias_measured"] == 2
    assert e.bias.bias_rad_s == pytest.approx(3e-4, abs=1e-6)
    assert poses[20].validity is Validity.DEGRADED
    assert poses[-1].validity is Validity.VALID


def silence(
    samples: Iterator[tuple[float, Sample]], kind: type, start_s: float, end_s: float
) -> list[tuple[float, Sample]]:
    return [(t, s) for t, s in samples if not (isinstance(s, kind) and start_s < t <= end_s)]


def test_gyro_silence_degrades_recovers_and_does_not_jump() -> None:
    e = make()
    poses = feed(e, silence(drive(30), GyroSample, 10.0, 15.0))
    by_time = {round((p.t_ns - T0) / S, 2): p for p in poses}
    assert by_time[9.0].validity is Validity.VALID
    assert by_time[12.0].validity is Validity.DEGRADED
    assert by_time[12.0].reasons[0].source == "fog"
    assert by_time[20.0].validity is Validity.VALID
    assert largest_step_m(poses) < 0.06
    turns = [abs(b.heading_rad - a.heading_rad) for a, b in pairwise(poses)]
    assert max(turns) < 0.03
    assert by_time[14.9].covariance[5] > by_time[10.0].covariance[5]


def wheel_gap(seconds: float, start_s: float, end_s: float) -> list[tuple[float, Sample]]:
    """As the encoder stream reports a gap: nothing, then a sample that says how much time was lost."""
    events = silence(drive(seconds), WheelSample, start_s, end_s)
    for i, (t, s) in enumerate(events):
        if isinstance(s, WheelSample) and t > end_s + 0.04:
            events[i] = (t, s._replace(lost_s=end_s - start_s))
            return events
    raise AssertionError("no sample after the gap")


def test_wheel_silence_widens_the_position_and_the_gyro_carries_the_heading() -> None:
    e = make()
    poses = feed(e, wheel_gap(30, 10.0, 14.0))
    by_time = {round((p.t_ns - T0) / S, 2): p for p in poses}
    assert by_time[13.0].validity is Validity.DEGRADED
    assert by_time[13.0].reasons[0].source == "encoders"
    assert by_time[13.0].position_bound_m > by_time[10.0].position_bound_m + 3.0  # 3 s at 1 m/s
    assert by_time[13.0].heading_rad == pytest.approx(0.5 * (1 - math.cos(0.8 * 13.0)), abs=0.02)
    assert poses[-1].validity is Validity.VALID
    assert poses[-1].heading_rad == pytest.approx(0.5 * (1 - math.cos(0.8 * 30.0)), abs=0.02)
    assert largest_step_m(poses) < 0.06
    assert e.counters["wheel_gaps"] == 1


def test_a_short_wheel_silence_loses_no_travel() -> None:
    events = silence(drive(20, speed_m_s=1.0), WheelSample, 10.0, 10.35)
    for i, (t, s) in enumerate(events):
        if isinstance(s, WheelSample) and t > 10.36:
            half = 0.25 * (math.cos(0.8 * 10.0) - math.cos(0.8 * 10.4)) * 0.5
            events[i] = (t, WheelSample(s.t_ns, 0.4, 0.4 - half, 0.4 + half, 0.0))
            break
    poses = feed(make(), events)
    whole = feed(make(), drive(20))
    assert final(poses) == pytest.approx(final(whole), abs=5e-3)


def test_long_wheel_silence_is_invalid_and_ticks_keep_the_pose_coming() -> None:
    e = make()
    feed(e, drive(5))
    poses = [p for i in range(1, 240) if (p := e.tick(T0 + round((5 + i * 0.05) * S))) is not None]
    assert len(poses) > 200
    assert poses[0].validity is Validity.DEGRADED
    assert poses[-1].validity is Validity.INVALID
    bounds = [p.position_bound_m for p in poses]
    assert bounds == sorted(bounds)
    assert poses[-1].covariance[5] > 100 * poses[0].covariance[5]  # nobody sees the heading either


def test_before_any_sample_ticks_give_a_pose_that_is_not_valid() -> None:
    e = make()
    poses = [pose for i in range(20) if (pose := e.tick(T0 + i * S // 20)) is not None]
    assert len(poses) > 15
    assert {p.validity for p in poses} == {Validity.INITIALISING}
    assert {r.source for r in poses[-1].reasons} == {"fog", "encoders"}


def spin(samples: Iterator[tuple[float, Sample]], start_s: float, end_s: float) -> Iterator[tuple[float, Sample]]:
    """The right wheel spins on ice: 0.2 m/s more than the ground."""
    for t, s in samples:
        if isinstance(s, WheelSample) and start_s < t <= end_s:
            yield t, s._replace(right_m=s.right_m + 0.2 * s.interval_s)
        else:
            yield t, s


def test_slip_of_one_wheel_is_found_reported_and_left_to_the_gyro() -> None:
    e = make()
    poses = feed(e, spin(drive(30), 10.0, 12.0))  # the wheels alone would turn by 46 deg
    assert e.counters["released"] > 0
    told = [p for p in poses if any(r.source == "agreement" for r in p.reasons)]
    assert told
    assert told[0].t_ns - T0 < 10.6 * S
    assert poses[-1].validity is Validity.VALID
    assert poses[-1].heading_rad == pytest.approx(0.5 * (1 - math.cos(24.0)), abs=0.03)


def test_a_filter_that_is_not_finite_is_reset_and_never_called_valid() -> None:
    e = make()
    feed(e, drive(5))
    e.filter.P[:] = math.nan
    poses = feed(e, drive(2, start_s=5.0))
    assert e.counters["resets"] == 1
    assert all(p.validity is Validity.INVALID and math.isfinite(p.x_m) for p in poses)
    e.set_pose(1.0, 2.0, 0.5, 0.1, 0.1)
    assert feed(e, drive(0.1, start_s=7.0))[-1].validity is Validity.VALID


def test_set_pose_and_reset() -> None:
    e = make()
    feed(e, drive(5))
    e.set_pose(10.0, -3.0, 1.0, 0.2, 0.05)
    pose = feed(e, drive(0.05, speed_m_s=0.0, start_s=5.0))[-1]
    assert (pose.x_m, pose.y_m, pose.heading_rad) == pytest.approx((10.0, -3.0, 1.0), abs=0.01)
    assert pose.covariance[0] == pytest.approx(0.04, rel=0.05)
    e.reset()
    assert final(feed(e, drive(0.05, speed_m_s=0.0, start_s=5.05))) == pytest.approx((0.0, 0.0, 0.0), abs=0.01)


def test_a_pose_that_is_set_as_hardly_known_leaves_an_estimate_that_can_be_kept() -> None:
    e = make()
    feed(e, drive(5))
    e.set_pose(1.0, 2.0, 0.5, 1e7, 1e7)
    feed(e, drive(1, start_s=5.0))
    estimate = e.estimate()
    assert estimate is not None
    check_covariance(estimate.P)


def test_a_position_bound_beyond_its_limit_is_invalid() -> None:
    poses = feed(make(KNOWN.replace("{static", "{max_position_bound_m: 0.05, static")), drive(20))
    assert poses[0].validity is Validity.VALID
    assert poses[-1].validity is Validity.INVALID


CUBIC = Calibration(
    rows=((0.01, 1e-3, 0.0), (0.002, 1e-4, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
    rate_range_deg_s=(-90.0, 90.0),
    temperature_range_c=(10.0, 40.0),
    residual_deg_s=0.002,
    provenance={"made": "for a test"},
)


def test_a_calibration_leaves_the_scale_out_and_its_range_is_watched() -> None:
    e = make(KNOWN, CUBIC)
    assert not e.estimates_gyro_scale
    inside = feed(e, drive(5))
    assert inside[-1].validity is Validity.VALID
    cold = feed(
        e, ((t, s._replace(temperature_c=-5.0) if isinstance(s, GyroSample) else s) for t, s in drive(5, start_s=5.0))
    )
    assert cold[-1].validity is Validity.DEGRADED
    assert cold[-1].reasons[0].source == "calibration"
    other = make(KNOWN, CUBIC)
    feed(other, drive(5))
    warm = feed(other, drive(5, start_s=5.0))
    assert cold[-1].covariance[5] > 2.0 * warm[-1].covariance[5]


def test_publishing_on_the_gyro() -> None:
    counts: dict[str, int] = {}
    for choice in ("wheels", "gyro"):
        counts[choice] = len(feed(make(NO_BIAS + f"output: {{publish_on: {choice}}}\n"), drive(10)))
    assert counts == {"wheels": 200, "gyro": 100}


def test_a_gyro_faster_than_the_wheels_brings_no_pose_twice() -> None:
    fast = [(i / 200, GyroSample(T0 + i * S // 200, 0.005, 0.0, 25.0)) for i in range(1, 2001)]
    wheels = [x for x in drive(10) if isinstance(x[1], WheelSample)]
    e = make(NO_BIAS + "fog: {rate_hz: 200}\noutput: {publish_on: gyro}\n")
    times_ns = [pose.t_ns for pose in feed(e, sorted([*fast, *wheels], key=lambda x: x[0]))]
    assert len(times_ns) > 150
    assert times_ns == sorted(set(times_ns))


def test_the_same_samples_give_the_same_poses_to_the_bit() -> None:
    runs = [feed(make(), drive(20)) for _ in range(2)]
    assert runs[0] == runs[1]


def drawn(seed: int) -> tuple[Estimator, list[Pose]]:
    """A robot whose wheels, tread, gyro scale and bias are drawn from the configured spreads, with their noise."""
    rng = random.Random(seed)
    left, right, scale = (1.0 + 0.005 * rng.gauss(0, 1) for _ in range(3))
    tread, bias = 0.5 * (1.0 + 0.02 * rng.gauss(0, 1)), math.radians(0.02) * rng.gauss(0, 1)

    def disturbed() -> Iterator[tuple[float, Sample]]:
        for t, s in drive(72, stand_s=12.0, bias_rad_s=bias, tread_m=tread):
            if isinstance(s, WheelSample):
                a, b = (u + 0.002 * math.sqrt(abs(u)) * rng.gauss(0, 1) for u in (s.left_m, s.right_m))
                yield t, s._replace(left_m=a * left, right_m=b * right)
            else:
                noise = math.radians(0.083 / 60) / math.sqrt(0.1) * rng.gauss(0, 1)
                yield t, s._replace(rate_rad_s=s.rate_rad_s * scale + noise)

    e = make(ROBOT)
    return e, feed(e, disturbed())


def test_the_bound_holds_and_the_heading_is_honest_over_drawn_robots() -> None:
    truth = feed(make(NO_BIAS), drive(72, stand_s=12.0))[-1]
    outside, heading_sigmas = 0, []
    for seed in range(40):
        pose = drawn(seed)[1][-1]
        outside += math.hypot(pose.x_m - truth.x_m, pose.y_m - truth.y_m) > pose.position_bound_m
        heading_sigmas.append((pose.heading_rad - truth.heading_rad) ** 2 / pose.covariance[5])
    assert outside <= 2  # 99 % bound: 0.4 of 40 expected
    assert 0.1 < sum(heading_sigmas) / 40 < 1.67  # 99.9 % point of chi-square with 40 degrees; noise is modelled amply


def test_speed_and_rate_carry_their_uncertainty_which_grows_in_silence() -> None:
    e = make()
    pose = feed(e, drive(10))[-1]
    assert 0.04 < pose.speed_sigma_m_s < 0.07  # 2 ms of uncertain time at both ends of 50 ms, at 1 m/s
    assert 0.0 < pose.rate_sigma_rad_s < 0.01
    without = feed(make(), (x for x in drive(10) if isinstance(x[1], WheelSample)))[-1]
    assert without.rate_sigma_rad_s > pose.rate_sigma_rad_s
    silent = [p for i in range(1, 60) if (p := e.tick(T0 + round((10 + i * 0.05) * S))) is not None]
    assert silent[-1].speed_sigma_m_s > silent[0].speed_sigma_m_s > pose.speed_sigma_m_s
    assert silent[-1].rate_sigma_rad_s > silent[0].rate_sigma_rad_s


def test_with_the_gyro_s_heading_the_wheels_only_measure_the_way() -> None:
    text = NO_BIAS + "output: {publish_on: gyro}\n"
    lying = [(t, s._replace(right_m=1.1 * s.right_m) if isinstance(s, WheelSample) else s) for t, s in drive(20)]
    alone, both = make(text.replace("{static", "{heading: gyro, static")), make(text)
    poses = feed(alone, lying)
    x, y, heading = final(poses)
    true_heading = 0.5 * (1.0 - math.cos(0.8 * 20))
    assert heading == pytest.approx(true_heading, abs=1e-9)
    way = 1.05 * sum(math.cos(0.5 * (1.0 - math.cos(0.8 * (i + 0.5) / 20))) / 20 for i in range(400))
    assert x == pytest.approx(way, rel=0.01)
    assert alone.counters["accepted"] == alone.counters["rejected"] == 0
    feed(both, lying)
    assert both.counters["accepted"] > 100
    assert math.isfinite(y)


def test_with_the_gyro_s_heading_silent_gyro_leaves_the_wheels() -> None:
    e = make(NO_BIAS.replace("{static", "{heading: gyro, static"))
    kept = [(t, s) for t, s in drive(20) if isinstance(s, WheelSample) or t < 10]
    assert final(feed(e, kept))[2] == pytest.approx(0.5 * (1.0 - math.cos(0.8 * 20)), abs=0.02)


def test_a_turn_that_only_the_wheels_tell_is_in_doubt_by_the_lag() -> None:
    """The gyro's last sample ends before the wheels' last one: by a lag that is not known it may be about it, too."""
    variances = []
    for rate_rad_s in (0.0, 2.0):
        estimator = make(NO_BIAS)
        feed(estimator, drive(1.0, stand_s=1.0))
        for i in range(1, 6):
            half_m, t_s = 0.25 * 0.2 * i * rate_rad_s * 0.05, 1.0 + 0.05 * i
            wheels = WheelSample(T0 + round(t_s * S), 0.05, 0.05 - half_m, 0.05 + half_m, 0.0)
            (pose,) = feed(estimator, [(t_s, wheels)])
        variances.append(pose.covariance[5])
    assert variances[1] - variances[0] > 2.0**2 * lead_moments(0.0, 0.2**2)[1]
