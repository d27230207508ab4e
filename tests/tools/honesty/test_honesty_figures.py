"""Figures of made-up estimates whose errors are known."""

import math

import numpy as np
import pytest

from drd.arrays import Array
from drd_tools.calibrate.wheels.drive import Mounting
from drd_tools.evaluate.trajectory import Poses, Reference
from drd_tools.honesty.drives import at_centre
from drd_tools.honesty.figures import Estimated, Figures, Yardstick, figures_of, is_moving, nees_at_end

TIME_S = np.arange(0.0, 40.0, 0.1)


def path(time_s: Array) -> Array:
    """Stands for 10 s, then drives a weaving line at 0.5 m/s along x."""
    x = 0.5 * np.clip(time_s - 10.0, 0.0, None)
    return np.column_stack([x, 0.0 * x, 0.4 * np.sin(x)])


def estimate(offset_m: float, bound_m: float, valid: float = 1.0) -> Estimated:
    pose = path(TIME_S) + np.array([0.0, offset_m, 0.0])
    covariance = np.tile(np.diag([0.04, 0.04, 0.01]), (len(TIME_S), 1, 1))
    is_valid = np.arange(len(TIME_S)) >= (1.0 - valid) * len(TIME_S)
    return Estimated(Poses("made up", TIME_S, pose, covariance, np.full(len(TIME_S), bound_m)), is_valid)


TRUE = Reference("true", TIME_S, path(TIME_S))


def judged(offset_m: float, bound_m: float, valid: float = 1.0) -> Figures:
    return figures_of(estimate(offset_m, bound_m, valid), Yardstick(TRUE, True))


def test_a_constant_offset_is_its_own_rms_and_inside_a_larger_bound() -> None:
    figures = judged(0.2, 0.5)
    assert figures.position_rms_m == pytest.approx(0.2)
    assert figures.heading_rms_deg == pytest.approx(0.0, abs=1e-9)
    assert (figures.inside, figures.bound_m, figures.valid) == (1.0, 0.5, 1.0)
    assert figures.bound_ratio == pytest.approx(2.5)
    assert judged(0.2, 0.1).inside == 0.0


def test_only_valid_rows_count_as_inside_and_the_share_is_told() -> None:
    figures = judged(0.2, 0.5, valid=0.5)
    assert figures.valid == pytest.approx(0.5)
    assert judged(0.2, 0.5, valid=0.0).inside is None


def test_without_a_bound_there_are_only_errors() -> None:
    poses = estimate(0.2, 0.5).poses
    figures = figures_of(Estimated(Poses("bare", poses.time_s, poses.pose)), Yardstick(TRUE, True))
    assert (figures.inside, figures.bound_m, figures.bound_ratio, figures.valid) == (None, None, None, None)


def test_a_late_reference_is_found_and_taken_off() -> None:
    late = Reference("late", TIME_S, path(TIME_S - 0.3))
    figures = figures_of(estimate(0.0, 0.5), Yardstick(late, False))
    assert figures.position_rms_m < 0.01
    assert figures.lag_s == pytest.approx(0.3, abs=0.011)


def test_a_real_reference_may_begin_anywhere() -> None:
    c, s = math.cos(2.0), math.sin(2.0)
    x, y, heading = path(TIME_S).T
    elsewhere = Reference(
        "elsewhere", TIME_S, np.column_stack([3.0 + c * x - s * y, 4.0 + s * x + c * y, heading + 2.0])
    )
    assert figures_of(estimate(0.2, 0.5), Yardstick(elsewhere, False)).position_rms_m == pytest.approx(0.0, abs=1e-9)


def test_the_reference_is_brought_to_the_robots_centre() -> None:
    x, y, heading = path(TIME_S).T
    c, s = np.cos(heading), np.sin(heading)
    seen = np.column_stack([x + 0.3 * c + 0.1 * s, y + 0.3 * s - 0.1 * c, heading + 0.05])
    mounting = Mounting(forward_m=0.3, left_m=-0.1, heading_rad=0.05)
    assert at_centre(Reference("off", TIME_S, seen), mounting).pose == pytest.approx(path(TIME_S))


def test_turning_on_the_spot_is_motion() -> None:
    pose = np.column_stack([0.0 * TIME_S, 0.0 * TIME_S, 0.2 * np.clip(TIME_S - 20.0, 0.0, None)])
    moving = is_moving(TIME_S, pose, 0.01)
    assert not moving[:199].any()
    assert moving[202:].all()


def test_nees_at_the_end_by_hand() -> None:
    assert nees_at_end(estimate(0.2, 0.5).poses, TRUE) == pytest.approx(0.2**2 / 0.04)
    turned = Reference("a turn more", TIME_S, path(TIME_S) + np.array([0.0, 0.0, 2.0 * math.pi]))
    assert nees_at_end(estimate(0.2, 0.5).poses, turned) == pytest.approx(1.0)
