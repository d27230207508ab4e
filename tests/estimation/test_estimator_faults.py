"""What once went wrong, or could: holes, stalls, blindness, coarse counts. The pose stays honest."""

import math
from itertools import pairwise

import numpy as np
import pytest
from sensors import KNOWN, NO_BIAS, ROBOT, T0, S, drive, feed, make

from drd.estimation.estimator import Estimator
from drd.estimation.state import GYRO_BIAS
from drd.samples import GyroSample, Pose, Validity, WheelSample
from drd.units import DEG_PER_RAD


def heading_of(t_s: float, stand_s: float = 0.0) -> float:
    return 0.5 * (1.0 - math.cos(0.8 * (t_s - stand_s)))


def ticks(e: Estimator, start_s: float, end_s: float, step_s: float = 0.1) -> list[Pose]:
    times = [T0 + round((start_s + i * step_s) * S) for i in range(1, round((end_s - start_s) / step_s))]
    return [pose for t in times if (pose := e.tick(t)) is not None]


def test_half_an_hour_of_blindness_spoils_nothing_that_was_learned() -> None:
    e = make()
    feed(e, drive(20))
    blind = ticks(e, 20.0, 1820.0)
    assert blind[-1].validity is Validity.INVALID
    poses = feed(e, drive(60, start_s=1820.0))
    assert e.counters["not_finite"] == 0
    assert e.filter.nominal.tread_m == pytest.approx(0.5, rel=0.02)
    P = e.filter.P
    assert np.linalg.eigvalsh(0.5 * (P + P.T)).min() > -1e-6 * np.trace(P)
    assert poses[-1].validity is Validity.INVALID  # nobody knows where it heads
    e.set_pose(0.0, 0.0, 0.0, 0.1, 0.01)
    after = feed(e, drive(20, start_s=1880.0))
    assert after[-1].validity is Validity.VALID
    assert after[-1].heading_rad == pytest.approx(heading_of(20.0), abs=0.03)


def test_motion_that_was_unseen_for_long_stays_told_until_the_pose_is_set() -> None:
    e = make()
    feed(e, drive(10))
    ticks(e, 10.0, 25.0)
    poses = feed(e, drive(5, start_s=25.0))
    assert poses[-1].validity is not Validity.VALID
    assert "position" in {r.source for r in poses[-1].reasons}
    e.set_pose(0.0, 0.0, 0.0, 0.0, 0.0)
    assert feed(e, drive(1, start_s=30.0))[-1].validity is Validity.VALID


def test_gyro_readings_that_no_encoder_confirmed_are_not_averaged() -> None:
    e = make(ROBOT)
    for i in range(1, 301):  # half a minute before the encoders come up; the robot is turned by 90 deg
        rate = math.radians(30.0) if 100 < i <= 130 else 2e-4
        e.add_gyro(GyroSample(T0 + i * S // 10, 0.1, rate, 25.0))
    feed(e, drive(20, stand_s=15.0, bias_rad_s=2e-4, start_s=30.0))
    assert e.counters["bias_measured"] == 1
    assert e.bias.bias_rad_s == pytest.approx(2e-4, abs=1e-9)


def test_a_hole_in_the_gyro_during_slip_does_not_make_the_slip_believed() -> None:
    def events() -> list[tuple[float, GyroSample | WheelSample]]:
        made = []
        for t, s in drive(30):
            slips = 10.0 < t <= 12.0
            if isinstance(s, GyroSample) and slips and round(t * 10) % 3 == 0:
                continue
            made.append((t, s._replace(right_m=s.right_m + 0.01) if isinstance(s, WheelSample) and slips else s))
        return made

    pose = feed(make(), events())[-1]
    error, sigma = abs(pose.heading_rad - heading_of(30.0)), math.sqrt(pose.covariance[5])
    assert error < 3.0 * sigma


def test_publishing_on_the_gyro_goes_on_when_the_gyro_dies() -> None:
    e = make(NO_BIAS + "output: {publish_on: gyro}\n")
    feed(e, drive(5))
    poses = feed(e, (x for x in drive(10, start_s=5.0) if isinstance(x[1], WheelSample)))
    assert len(poses) > 180
    first = make(NO_BIAS + "output: {publish_on: gyro}\n").add_gyro(GyroSample(T0, 0.1, 0.0, 25.0))
    assert first is None  # nothing to say before the first wheel sample


def test_a_fast_gyro_does_not_flood_while_the_wheels_are_silent() -> None:
    e = make(NO_BIAS + "fog: {rate_hz: 1000}\n")
    feed(e, (x for x in drive(2) if isinstance(x[1], WheelSample)))
    poses = []
    for i in range(1, 3001):
        now_ns = T0 + 2 * S + i * S // 1000
        poses.append(e.add_gyro(GyroSample(now_ns, 1e-3, 0.1, 25.0)))
        if i % 50 == 0:
            poses.append(e.tick(now_ns))
    assert 40 < sum(p is not None for p in poses) < 70


def test_a_gyro_whose_samples_all_come_too_late_is_told() -> None:
    e, poses = make(KNOWN), []
    events = [(t + (0.5 if isinstance(s, GyroSample) else 0.0), s) for t, s in drive(20)]
    poses = feed(e, sorted(events, key=lambda event: event[0]))
    assert e.counters["late_gyro"] > 150
    assert poses[-1].validity is Validity.DEGRADED
    assert "fog" in {r.source for r in poses[-1].reasons}


def test_a_gyro_that_was_away_may_have_another_bias() -> None:
    e = make(ROBOT)
    feed(e, drive(20, stand_s=12.0))
    before = e.filter.sigma(GYRO_BIAS)
    feed(e, (x for x in drive(8, start_s=20.0) if isinstance(x[1], WheelSample) or x[0] > 23.0))
    after = e.filter.sigma(GYRO_BIAS)
    assert math.hypot(before, math.radians(0.002)) * 0.9 < after < 1e-4


def test_the_rate_follows_the_gyro_while_the_wheels_are_silent() -> None:
    e = make()
    feed(e, drive(10))
    spinning = [e.add_gyro(GyroSample(T0 + 10 * S + i * S // 10, 0.1, 0.3, 25.0)) for i in range(1, 6)]
    stopped = [e.add_gyro(GyroSample(T0 + round(10.5 * S) + i * S // 10, 0.1, 0.0, 25.0)) for i in range(1, 4)]
    last = spinning[-1]
    assert last is not None
    assert stopped[1] is not None
    assert last.rate_rad_s == pytest.approx(0.3, abs=0.01)
    assert stopped[1].rate_rad_s == pytest.approx(0.0, abs=0.01)


def test_set_pose_holds_for_now_and_not_for_the_time_the_filter_has_reached() -> None:
    for gyro in (True, False):
        e = make()
        last = feed(e, (x for x in drive(8.05) if gyro or isinstance(x[1], WheelSample)))[-1]
        e.set_pose(10.0, 20.0, 2.0, 0.0, 0.0)
        pose = e._pose(last.t_ns)
        assert (pose.x_m, pose.y_m, pose.heading_rad) == pytest.approx((10.0, 20.0, 2.0), abs=1e-9)


def over_a_gap(e: Estimator, gap_s: float, lost_m: float, set_s: float = math.inf) -> Pose:
    """Slalom at 1 m/s for 20 s, wheels away for so long, and on for a second. At `set_s` somebody sets the pose."""
    end_s = 20.0 + gap_s
    for _, sample in drive(end_s + 1.0):
        t_s = (sample.t_ns - T0) / S
        if t_s > set_s:
            e.set_pose(10.0, 20.0, 0.5, 0.0, 0.0)
            set_s = math.inf
        if isinstance(sample, GyroSample):
            e.add_gyro(sample)
        elif t_s < 20.01 or t_s > end_s + 0.01:
            is_first = 20.01 < t_s < end_s + 0.06
            last = e.add_wheels(sample._replace(lost_s=gap_s, lost_m=lost_m) if is_first else sample)
        e.tick(sample.t_ns)
    assert last is not None
    return last


@pytest.mark.parametrize("gap_s", [0.6, 2.0, 5.0])
def test_the_way_that_counters_tell_of_a_gap_is_gone_and_the_bound_stays(gap_s: float) -> None:
    whole = feed(make(KNOWN), drive(21.0 + gap_s))[-1]
    told, untold = (over_a_gap(make(KNOWN), gap_s, lost_m) for lost_m in (gap_s, 0.0))
    apart = [math.hypot(p.x_m - whole.x_m, p.y_m - whole.y_m) for p in (told, untold)]
    assert apart[0] < 0.3 * gap_s  # of a slalom
    assert apart[1] > 0.9 * gap_s
    assert apart[1] < untold.position_bound_m == pytest.approx(told.position_bound_m, rel=0.01)


def test_where_the_pose_was_set_in_a_gap_the_way_before_it_is_not_gone_again() -> None:
    told, untold = (over_a_gap(make(KNOWN), 3.0, lost_m, set_s=21.5) for lost_m in (3.0, 0.0))
    assert (told.x_m, told.y_m) == (untold.x_m, untold.y_m)
    assert math.hypot(told.x_m - 10.0, told.y_m - 20.0) < 1.1


def test_where_the_pose_is_set_before_a_gap_is_known_as_one_its_way_goes_along_the_new_heading() -> None:
    e = make(KNOWN)
    for step in range(1, 421):
        t_ns = T0 + step * S // 20
        if step % 2 == 0:
            e.add_gyro(GyroSample(t_ns, 0.1, 0.0, 25.0))
        if step == 402:  # the wheels are silent since step 400
            e.set_pose(0.0, 0.0, math.pi, 0.0, 0.0)
        if not 400 < step < 420:
            is_first = step == 420
            pose = e.add_wheels(WheelSample(t_ns, 0.05, 0.05, 0.05, 0.95 * is_first, 0.95 * is_first))
        e.tick(t_ns)
    assert pose is not None
    assert (pose.x_m, pose.y_m) == pytest.approx((-1.0, 0.0), abs=0.06)


def test_no_more_is_believed_of_a_gap_than_the_bound_has() -> None:
    far, none = (over_a_gap(make(KNOWN), 2.0, lost_m) for lost_m in (4.1, 0.0))  # 1 m/s, and 1 m/s^2 more
    assert (far.x_m, far.y_m) == (none.x_m, none.y_m)


def test_set_pose_during_a_gap_starts_the_growth_anew() -> None:
    e = make()
    feed(e, drive(5))
    ticks(e, 5.0, 9.0)
    e.set_pose(0.0, 0.0, 0.0, 0.05, 0.01)
    pose = ticks(e, 9.0, 9.5)[-1]
    assert pose.position_bound_m < 3.0


@pytest.mark.parametrize("first", ["gyro", "tick", "wheels"])
def test_a_host_that_stood_still_loses_no_travel_whichever_buffer_is_read_first(first: str) -> None:
    e = make()
    feed(e, drive(10))
    for i in range(1, 11):
        e.tick(T0 + round((9.0 + 0.1 * i) * S))
    waiting = [s for _, s in drive(2, start_s=10.0)]
    rank = {"gyro": GyroSample, "wheels": WheelSample}.get(first, GyroSample)
    if first == "tick":
        e.tick(T0 + 12 * S)
    for s in sorted(waiting, key=lambda sample: not isinstance(sample, rank)):
        if isinstance(s, GyroSample):
            e.add_gyro(s)
        else:
            e.add_wheels(s)
    whole = make()
    feed(whole, drive(10))
    feed(whole, drive(2, start_s=10.0))
    assert e.counters["late_wheels"] == 0
    assert e.filter.nominal.x_m == pytest.approx(whole.filter.nominal.x_m, abs=1e-3)
    assert e.filter.nominal.heading_rad == pytest.approx(whole.filter.nominal.heading_rad, abs=1e-3)


def test_a_silent_gyro_does_not_take_the_wheels_lag_off_the_pose() -> None:
    e = make(ROBOT + "estimation: {static_bias: {duration_s: 0}, initial: {wheel_lag_s: 0.1}}\n")
    e.filter.nominal.wheel_lag_s = 0.2
    straight = [
        (t, s._replace(rate_rad_s=0.0) if isinstance(s, GyroSample) else s._replace(left_m=0.05, right_m=0.05))
        for t, s in drive(20.0)
        if t <= 10.0 or isinstance(s, WheelSample)
    ]
    poses = feed(e, straight)
    assert "fog" in {r.source for r in poses[-1].reasons}
    steps = [b.x_m - a.x_m for a, b in pairwise(poses[20:])]
    assert (min(steps), max(steps)) == pytest.approx((0.05, 0.05), abs=1e-3)
    e.set_pose(0.0, 0.0, 0.0, 0.001, 0.001)
    after = feed(e, [(20.05, WheelSample(T0 + 401 * S // 20, 0.05, 0.05, 0.05, 0.0))])[-1]
    assert after.x_m == pytest.approx(0.05, abs=1e-3)


def test_the_rate_of_a_robot_without_its_gyro_has_the_wheels_learned_radii() -> None:
    e = make(KNOWN)
    feed(e, drive(10))
    e.filter.nominal.scale_left, e.filter.nominal.scale_right = 0.015, -0.015
    for step in range(201, 241):
        pose = e.add_wheels(WheelSample(T0 + step * S // 20, 0.05, 0.05 / 0.985, 0.05 / 1.015, 0.0))
    assert pose is not None
    assert pose.rate_rad_s == pytest.approx(0.0, abs=1e-6)


def test_the_poses_time_never_runs_backward_when_a_sensor_returns() -> None:
    e = make()
    poses = feed(e, drive(5))
    poses += ticks(e, 5.0, 7.0, 0.05)
    late = T0 + round(6.97 * S)
    poses += [p for i in range(20) if (p := e.add_wheels(WheelSample(late + i * S // 20, 0.05, 0.05, 0.05, 0.0)))]
    assert all(b.t_ns >= a.t_ns for a, b in pairwise(poses))


@pytest.mark.parametrize("count_m", [1e-4, 1.5e-3, 5e-3, 1.5e-2])
def test_coarse_counts_do_not_pass_for_disagreement_or_teach_a_wrong_tread(count_m: float) -> None:
    e = make(resolution_m=count_m)
    left = right = left_m = right_m = 0.0
    poses = []
    for _, s in drive(60):
        if isinstance(s, GyroSample):
            e.add_gyro(s)
            continue
        left_m, right_m = left_m + s.left_m, right_m + s.right_m
        counted = [math.floor(x / count_m) * count_m for x in (left_m, right_m)]
        poses.append(e.add_wheels(s._replace(left_m=counted[0] - left, right_m=counted[1] - right)))
        left, right = counted
    pose = poses[-1]
    assert pose is not None
    assert e.counters["rejected"] == 0
    assert e.filter.nominal.tread_m == pytest.approx(0.5, rel=0.05)
    assert abs(pose.heading_rad - heading_of(60.0)) * DEG_PER_RAD < 3.0
    assert pose.speed_sigma_m_s > count_m / 0.05 / math.sqrt(12.0)
