"""The two headings compared: what follows where they part."""

import math
from collections.abc import Sequence

import numpy as np
import pytest
from sensors import NO_BIAS, T0, S, drive, feed, make

from drd.estimation.agreement import Agreement
from drd.estimation.drift import Drift
from drd.estimation.health import Reasons
from drd.estimation.learning import Drive
from drd.estimation.state import GG, HEADING_UNKNOWN_RAD2, XX, YY
from drd.estimation.stuck import STUCK_READINGS
from drd.samples import GyroSample, WheelSample

COUNTERS = ("rejected", "released", "accepted", "not_finite")
STEPS = ((3.0, 20.0, 23.0), (2.0, 20.0, 27.0), (3.0, 10.0, 16.0))


@pytest.mark.parametrize("unseen_rad2", [0.0, 10.0 * HEADING_UNKNOWN_RAD2], ids=["known", "unknown"])
@pytest.mark.parametrize("parted_rad", [0.1, -1.0, 3.0])
def test_a_lasting_disagreement_releases_the_wheels_and_loses_nothing(unseen_rad2: float, parted_rad: float) -> None:
    estimator = make(NO_BIAS)
    feed(estimator, drive(5.0))
    track = estimator._track
    kf = track.kf
    kf.add_heading_variance(unseen_rad2, both=True)
    kf.nominal.heading_rad = kf.nominal.gyro_heading_rad + parted_rad
    counters = dict.fromkeys(COUNTERS, 0)
    agreement = Agreement(3, Reasons(), counters)
    for i in range(4):
        assert agreement.update(track, T0 + i * S, Drive.DIFFERENTIAL)
    assert counters == {"rejected": 3, "released": 1, "accepted": 2, "not_finite": 0}
    assert kf.nominal.heading_rad == pytest.approx(kf.nominal.gyro_heading_rad, abs=0.02)


@pytest.mark.parametrize("share", [0.0, 0.7, 1.3], ids=["stuck", "drags", "spins"])
def test_the_way_that_one_wrong_wheel_took_is_in_the_bound_when_the_pose_is_valid_again(share: float) -> None:
    truth = {pose.t_ns: pose for pose in feed(make(NO_BIAS), drive(40.0))}
    wrong = (
        (t_s, s._replace(right_m=share * s.right_m) if isinstance(s, WheelSample) and 10.0 < t_s <= 20.0 else s)
        for t_s, s in drive(40.0)
    )
    poses = feed(make(NO_BIAS), wrong)
    assert poses[-1].validity.value == "valid"
    off_m = [math.dist((p.x_m, p.y_m), (truth[p.t_ns].x_m, truth[p.t_ns].y_m)) for p in poses]
    assert off_m[-1] > 0.3
    assert all(off <= p.position_bound_m for off, p in zip(off_m, poses, strict=True) if p.validity.value == "valid")
    # Nor is it hidden behind a bound that covers anything.
    assert poses[-1].position_bound_m < 10.0 * off_m[-1]


@pytest.mark.parametrize(
    ("step_deg_s", "from_s", "told_by_s"), [(3.0, 20.0, 22.0), (2.0, 20.0, 26.5), (3.0, 10.0, 15.5)]
)
def test_a_gyro_that_drifts_within_the_gate_is_told_and_the_bound_holds(
    step_deg_s: float, from_s: float, told_by_s: float
) -> None:
    """For 15 s. The earlier, the less is known of tread and lag, which it teaches; the smaller, the longer it takes."""
    truth = {pose.t_ns: pose for pose in feed(make(NO_BIAS), drive(60.0))}
    step_rad_s = math.radians(step_deg_s)

    def stepped(t_s: float, s: GyroSample) -> GyroSample:
        return s._replace(rate_rad_s=s.rate_rad_s + step_rad_s) if from_s < t_s <= from_s + 15.0 else s

    wrong = ((t_s, stepped(t_s, s) if isinstance(s, GyroSample) else s) for t_s, s in drive(60.0))
    estimator = make(NO_BIAS)
    poses = feed(estimator, wrong)
    told = [p for p in poses if any("drift apart" in r.text for r in p.reasons)]
    assert T0 + from_s * S < told[0].t_ns < T0 + told_by_s * S
    assert estimator.counters["rejected"] == 0
    off_m = [math.dist((p.x_m, p.y_m), (truth[p.t_ns].x_m, truth[p.t_ns].y_m)) for p in poses]
    assert max(off_m) > 0.5
    # Before it is told nobody can know; afterwards what is valid holds.
    since = [(off, p) for off, p in zip(off_m, poses, strict=True) if p.t_ns >= told[0].t_ns]
    assert all(off <= p.position_bound_m for off, p in since if p.validity.value == "valid")
    assert sum(off <= p.position_bound_m for off, p in since) > 0.85 * len(since)


@pytest.mark.parametrize("tread_m", [0.5, 0.51])
def test_sensors_that_agree_never_drift_apart(tread_m: float) -> None:
    poses = feed(make(NO_BIAS), drive(120.0, tread_m=tread_m))
    assert not any(r.source == "agreement" for p in poses for r in p.reasons)


@pytest.mark.parametrize("says_angles", [False, True])
def test_a_gyro_that_repeats_itself_while_the_wheels_do_not_is_taken_for_silent(says_angles: bool) -> None:
    """From 20 s to 40 s; where it says angles its rate has the error of the interval's length."""

    def stuck(t_s: float, s: GyroSample) -> GyroSample:
        longer = 1.0 + 1e-6 * math.sin(t_s) if says_angles else 1.0
        return s._replace(rate_rad_s=0.35 / longer, interval_s=s.interval_s * longer)

    wrong = ((t_s, stuck(t_s, s) if isinstance(s, GyroSample) and 20.0 < t_s <= 40.0 else s) for t_s, s in drive(60.0))
    truth = {pose.t_ns: pose for pose in feed(make(NO_BIAS), drive(60.0))}
    estimator = make(NO_BIAS)
    poses = feed(estimator, wrong)
    assert 150 < estimator.counters["stuck_gyro"] <= 190
    silent = [p.t_ns for p in poses if any(r.source == "fog" for r in p.reasons)]
    assert T0 + 21 * S < silent[0] < T0 + 23 * S
    assert T0 + 39 * S < silent[-1] < T0 + 41 * S
    off_m = [(math.dist((p.x_m, p.y_m), (truth[p.t_ns].x_m, truth[p.t_ns].y_m)), p) for p in poses]
    assert all(off <= p.position_bound_m for off, p in off_m if p.validity.value == "valid")


@pytest.mark.parametrize(("times", "grows"), [(STUCK_READINGS - 1, False), (STUCK_READINGS, True)])
def test_what_wheels_and_a_gyro_that_repeats_itself_part_by_may_be_the_gyros(times: int, grows: bool) -> None:
    """Before any comparison shows that it is stuck: a tread that is learned anew explains as much."""
    estimator = make(NO_BIAS)
    feed(estimator, drive(10.0))
    track, agreement = estimator._track, Agreement(3, Reasons(), dict.fromkeys(COUNTERS, 0))
    for i in range(times):
        agreement.gyro_repeats(track, i + 1, track.gyro_ns)
    before = track.kf.flat_P[GG]
    track.hindsight.moved(0.0, 0.1 * track.kf.nominal.tread_m, 0.0)
    for _ in range(3):  # counted once
        agreement.update(track, track.t_ns, Drive.DIFFERENTIAL)
    assert not agreement._reasons.active()
    assert track.kf.flat_P[GG] - before == pytest.approx(0.1**2 if grows else 0.0, rel=0.05, abs=1e-4)


def test_another_ground_does_not_outlive_a_reset() -> None:
    """The tread that was before the ground changed is not that of a filter that starts again."""
    estimator = make(NO_BIAS)
    feed(estimator, drive(40.0))
    feed(estimator, drive(20.0, start_s=40.0, tread_m=0.7))
    assert estimator.reasons.has("agreement")
    estimator.reset()
    poses = feed(estimator, drive(20.0, start_s=60.0))
    assert not any(r.source == "agreement" for p in poses[100:] for r in p.reasons)


def variances(found: Sequence[str], corrected: float) -> list[float]:
    """Variances of x, y and heading, where comparisons correct x (m) and heading (rad) by `corrected` before each of
    these is found, while a gyro repeats itself.
    """
    estimator = make(NO_BIAS)
    feed(estimator, drive(10.0))
    track, agreement = estimator._track, Agreement(3, Reasons(), dict.fromkeys(COUNTERS, 0))
    find = {
        "slip": lambda: agreement.slip(track, track.t_ns, 0.0),
        "drift": lambda: Drift()._suspect_all(track, track.t_ns),
        "stuck": lambda: agreement.gyro_is_stuck(track),
    }
    track.hindsight.begin(track.kf, track.t_ns)
    agreement.gyro_repeats(track, 1, track.gyro_ns)
    for i, what in enumerate(found):
        if i == 0 or what == "stuck":
            track.kf.corrected_x_m += corrected
            track.kf.corrected_rad += corrected
        find[what]()
    return [track.kf.flat_P[i] for i in (XX, YY, GG)]


@pytest.mark.parametrize(
    ("found", "sum_of"),
    [
        (["slip"], 1.0),
        (["drift"], 1.0),
        (["stuck"], 1.0),
        (["slip", "slip"], 1.0),
        (["drift", "slip"], 1.0),  # in the same comparison: a tread that no robot has
        (["drift", "stuck"], 2.0),
        (["slip", "stuck"], 2.0),
    ],
)
def test_p_gets_back_once_what_comparisons_have_corrected(found: Sequence[str], sum_of: float) -> None:
    """The square of the sum: corrections by one wrong sensor have one sign."""
    growth = np.subtract(variances(found, 0.1), variances(found, 0.0))
    assert growth == pytest.approx([(sum_of * 0.1) ** 2] * 3)


@pytest.mark.parametrize("found", ["drift", "stuck"])
def test_p_gets_back_what_comparisons_have_corrected_since_the_last_drift_or_pose(found: str) -> None:
    estimator = make(NO_BIAS)
    feed(estimator, drive(10.0))
    track, agreement, drift = estimator._track, estimator.knowledge.agreement, Drift()
    kf = track.kf
    agreement.gyro_repeats(track, 1, 0)
    kf.corrected_x_m += 0.3
    track.hindsight.moved(0.0, 0.1, 0.0)
    if found == "drift":
        drift._suspect_all(track, track.t_ns)
        track.hindsight.watch(kf, track.t_ns)
    else:
        estimator.set_pose(0.0, 0.0, 0.0, 0.1, 0.1)
    before = kf.flat_P[XX], kf.flat_P[GG]
    kf.corrected_x_m += 0.1
    drift._suspect_all(track, track.t_ns) if found == "drift" else agreement.gyro_is_stuck(track)
    assert kf.flat_P[XX] - before[0] == pytest.approx(0.1**2)
    assert kf.flat_P[GG] == pytest.approx(before[1], rel=0.01)


@pytest.mark.parametrize(("steers", "parted_rad"), [(Drive.UNKNOWN, 0.0), (Drive.SKID, 0.8), (Drive.DIFFERENTIAL, 0.8)])
def test_what_a_tread_that_is_being_learned_explains_is_no_doubt_of_the_gyro(steers: Drive, parted_rad: float) -> None:
    """A turn of 1 rad of a robot whose effective tread is 1.8 of the one that was known when the drift was found."""
    estimator = make(NO_BIAS)
    feed(estimator, drive(1.0))
    track, drift = estimator._track, Drift()
    drift._suspect_all(track, track.t_ns)
    before_rad2, tread_m = track.kf.flat_P[GG], 1.8 * track.kf.nominal.tread_m
    track.hindsight.moved(0.0, tread_m, 1.0)
    track.kf.set_tread(tread_m)
    drift.watch(track, track.t_ns, steers)
    assert track.kf.flat_P[GG] - before_rad2 == pytest.approx(parted_rad**2, rel=0.1, abs=0.01)


@pytest.mark.parametrize(("readings", "is_found"), [(1, False), (20, True)])
def test_comparisons_within_one_reading_of_the_wheels_are_one(readings: int, is_found: bool) -> None:
    """A fast gyro sees the reading's one error in parts: twenty of them to one side tell no more than one."""
    estimator = make(NO_BIAS)
    feed(estimator, drive(5.0))
    track, drift = estimator._track, Drift()
    track.kf.z = 1.2 * math.sqrt(track.kf.S)
    found = False
    for i in range(20):
        track.reading_ns = T0 + min(i, readings - 1)
        found |= drift.is_found(track, Drive.SKID)
    assert found is is_found


def test_what_a_drift_has_put_into_p_is_not_beside_it_too() -> None:
    estimator = make(NO_BIAS)
    feed(estimator, drive(10.0))
    track = estimator._track
    track.kf.corrected_x_m += 0.3
    assert track.hindsight.corrected(track.kf)[0] > 0.01
    Drift()._suspect_all(track, track.t_ns)
    assert track.hindsight.corrected(track.kf) == (0.0, 0.0)


def test_what_was_corrected_before_a_filter_starts_again_is_not_in_its_covariance() -> None:
    estimator = make(NO_BIAS)
    feed(estimator, drive(10.0))
    track, knowledge = estimator._track, estimator.knowledge
    track.kf.corrected_x_m = track.kf.corrected_rad = 5.0
    track.hindsight.begin(track.kf, track.t_ns)
    knowledge.agreement.gyro_repeats(track, 1, track.gyro_ns)
    knowledge.begin_anew()
    assert track.hindsight.corrected(track.kf) == (0.0, 0.0)
    knowledge.agreement.gyro_is_stuck(track)
    assert track.kf.flat_P[XX] < 0.1
