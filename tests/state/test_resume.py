"""An estimator that goes on from another's estimate."""

import math

import pytest
from sensors import NO_BIAS, ROBOT, drive, feed, final, make

from drd.samples import Validity


def test_there_is_no_estimate_before_the_wheels_were_heard() -> None:
    assert make().estimate() is None


def test_an_estimator_that_resumes_continues_the_drive() -> None:
    first, second, whole = make(), make(), make()
    feed(first, drive(40 * math.pi / 4))  # whole slaloms: the next begins at heading 0 again
    estimate = first.estimate()
    assert estimate is not None
    second.resume(estimate, True)
    poses = feed(second, drive(20, start_s=40 * math.pi / 4))
    before = feed(whole, drive(40 * math.pi / 4))[-1]
    assert poses[0].validity is Validity.VALID
    assert (poses[0].x_m, poses[0].y_m) == pytest.approx((before.x_m + 0.05, before.y_m), abs=5e-3)
    alone = feed(make(), drive(20))
    assert poses[-1].x_m - alone[-1].x_m == pytest.approx(before.x_m, abs=0.05)
    assert poses[-1].position_bound_m > alone[-1].position_bound_m
    # What was learned goes on too.
    assert second.filter.P[5, 5] < 0.5 * make().filter.P[5, 5]


def test_a_known_bias_is_measured_again_but_not_waited_for() -> None:
    first = make(ROBOT)
    feed(first, drive(15, stand_s=15.0, bias_rad_s=4e-4))
    estimate = first.estimate()
    assert estimate is not None
    assert estimate.at_rest
    standing, moving, unknown = make(ROBOT), make(ROBOT), make(ROBOT)
    standing.resume(estimate, True)
    assert {p.validity for p in feed(standing, drive(8, stand_s=8.0, bias_rad_s=4e-4))} == {Validity.DEGRADED}
    moving.resume(estimate, True)
    assert feed(moving, drive(5, bias_rad_s=4e-4))[-1].validity is Validity.VALID
    unknown.resume(estimate, False)
    assert feed(unknown, drive(8, stand_s=8.0))[-1].validity is Validity.INITIALISING


def test_a_pose_that_was_lost_is_not_valid_again_by_a_restart() -> None:
    first = make()
    feed(first, drive(5))
    first.filter.P[:] = math.nan
    feed(first, drive(2, start_s=5.0))
    estimate = first.estimate()
    assert estimate is not None
    assert estimate.lost
    second = make()
    second.resume(estimate, True)
    poses = feed(second, drive(20))
    assert {p.validity for p in poses} == {Validity.INVALID}
    assert poses[-1].position_bound_m > 1e4
    second.set_pose(1.0, 2.0, 0.5, 0.1, 0.1)
    assert feed(second, drive(0.1, start_s=20.0))[-1].validity is Validity.VALID


def test_the_estimate_leads_to_the_newest_pose_not_to_the_filters_time() -> None:
    e = make(NO_BIAS)
    pose = feed(e, drive(5.05))[-1]
    estimate = e.estimate()
    assert estimate is not None
    n = estimate.nominal
    assert (n.x_m, n.y_m, n.heading_rad) == final([pose])
    assert estimate.speed_m_s == pytest.approx(1.0, abs=0.01)
    assert not estimate.at_rest
