"""The two headings compared: what follows where they part."""

import math

import pytest
from sensors import NO_BIAS, T0, S, drive, feed, make

from drd.estimation.agreement import Agreement
from drd.estimation.filter import HEADING_UNKNOWN_RAD2
from drd.estimation.health import Reasons
from drd.estimation.learning import Drive
from drd.samples import GyroSample, WheelSample


@pytest.mark.parametrize("unseen_rad2", [0.0, 10.0 * HEADING_UNKNOWN_RAD2], ids=["known", "unknown"])
@pytest.mark.parametrize("parted_rad", [0.1, -1.0, 3.0])
def test_a_lasting_disagreement_releases_the_wheels_and_loses_nothing(unseen_rad2: float, parted_rad: float) -> None:
    estimator = make(NO_BIAS)
    feed(estimator, drive(5.0))
    track = estimator._track
    kf = track.kf
    kf.add_heading_variance(unseen_rad2, both=True)
    kf.nominal.heading_rad = kf.nominal.gyro_heading_rad + parted_rad
    counters = dict.fromkeys(("rejected", "released", "accepted", "not_finite"), 0)
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


def test_a_gyro_that_drifts_within_the_gate_is_told_and_the_bound_holds() -> None:
    truth = {pose.t_ns: pose for pose in feed(make(NO_BIAS), drive(60.0))}
    step_rad_s = math.radians(3.0)
    wrong = (
        (t_s, s._replace(rate_rad_s=s.rate_rad_s + step_rad_s) if isinstance(s, GyroSample) and 20 < t_s <= 35 else s)
        for t_s, s in drive(60.0)
    )
    estimator = make(NO_BIAS)
    poses = feed(estimator, wrong)
    told = [p for p in poses if any("drift apart" in r.text for r in p.reasons)]
    assert T0 + 20 * S < told[0].t_ns < T0 + 26 * S
    assert estimator.counters["rejected"] == 0
    off_m = [math.dist((p.x_m, p.y_m), (truth[p.t_ns].x_m, truth[p.t_ns].y_m)) for p in poses]
    assert max(off_m) > 0.5
    # Before it is told nobody can know; afterwards what is valid holds.
    since = [(off, p) for off, p in zip(off_m, poses, strict=True) if p.t_ns >= told[0].t_ns]
    assert all(off <= p.position_bound_m for off, p in since if p.validity.value == "valid")
    assert sum(off <= p.position_bound_m for off, p in since) > 0.9 * len(since)


@pytest.mark.parametrize("tread_m", [0.5, 0.51])
def test_sensors_that_agree_never_drift_apart(tread_m: float) -> None:
    poses = feed(make(NO_BIAS), drive(120.0, tread_m=tread_m))
    assert not any(r.source == "agreement" for p in poses for r in p.reasons)
