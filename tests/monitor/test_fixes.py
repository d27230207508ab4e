"""Poses that are set show what both radii have in common."""

import math
from dataclasses import replace

import numpy as np
import pytest

from drd.config.keys import Config
from drd.config.schema import loads
from drd.monitor.findings import Size
from drd.monitor.fixes import EFFECT, Fixes
from drd.monitor.monitor import Monitor
from drd.monitor.rows import Rows
from drd.samples import GyroSample, WheelSample

CONFIG = loads("robot: {wheel_radius_m: 0.11, tread_m: 0.6}", Config).value
BEGIN_NS, STEP_NS = 10**12, 50_000_000


def driven(further: float, fixes: bool = True, sigma_m: float = 0.01, stated: float | None = None) -> Monitor:
    """Straight on at 1 m/s for a minute, between two poses, by wheels that roll so much further than configured."""
    initial = replace(CONFIG.estimation.initial, wheel_scale=stated)
    monitor = Monitor(replace(CONFIG, estimation=replace(CONFIG.estimation, initial=initial)))
    for k in range(1300):
        t_ns = BEGIN_NS + k * STEP_NS
        if fixes and k in (20, 1220):
            monitor.fix(t_ns - STEP_NS // 2, 3.0, 0.05 * (k - 20.5 + 0.5) * (1.0 + further), sigma_m)
        monitor.gyro(GyroSample(t_ns, 0.05, 0.0, 20.0))
        monitor.wheels(WheelSample(t_ns, 0.05, 0.05, 0.05, 0.0))
    return monitor


def test_larger_tyres_are_told_with_their_size() -> None:
    monitor = driven(0.03)
    (finding,) = monitor.findings()
    assert finding.effect == EFFECT
    for side in ("left", "right"):
        told = finding.parameters[side]
        assert isinstance(told, Size)
        assert abs(told.value - 0.03) < 3.0 * told.std
        assert 0.0001 < told.std < 0.001
    assert "+3 % further than configured" in finding.text
    assert EFFECT not in {n.effect for n in monitor.not_observable()}


def test_without_two_poses_nothing_is_observable() -> None:
    monitor = driven(0.03, fixes=False)
    assert monitor.findings() == []
    assert "set_pose" in {n.effect: n.because for n in monitor.not_observable()}[EFFECT]


@pytest.mark.parametrize(("further", "sigma_m", "stated"), [(0.005, 0.01, None), (0.03, 1.5, None), (0.03, 0.01, 0.02)])
def test_what_the_configuration_or_the_poses_allow_is_no_finding(
    further: float, sigma_m: float, stated: float | None
) -> None:
    monitor = driven(further, sigma_m=sigma_m, stated=stated)
    assert monitor.findings() == []
    assert EFFECT not in {n.effect for n in monitor.not_observable()}


def rows_of(turn_rad: np.ndarray, distance_m: np.ndarray, good: bool = True) -> Rows:
    """Rows of 0.1 s from time 0 on, with one of before and one that is to come."""
    n = len(turn_rad) + 2
    pad = (1, 1)
    end_s, way, none = np.asarray(0.1 * np.arange(n)), np.pad(distance_m, pad), np.zeros(n)
    flags = np.full(n, good)
    return Rows(end_s, np.full(n, 0.1), np.pad(turn_rad, pad), none, way, way, none, none, flags, 1, 0, none)


def test_the_chord_is_as_unsure_as_simulated_noise_makes_it() -> None:
    walk, wheel_noise, n = 1e-3, 0.002, 600
    turn, way = 0.05 * np.cos(0.02 * np.arange(n)), np.full(n, 0.1)
    random, chords, claimed = np.random.default_rng(1), [], 0.0
    for k in range(300):
        fixes, noise = Fixes(0.005, walk, wheel_noise), float(k > 0)
        fixes.fix(0, 0.0, 0.0, 0.0)
        fixes.rows(rows_of(np.zeros(1), np.zeros(1)), np.zeros(3), -(10**9))
        ways = way + noise * wheel_noise * np.sqrt(0.5 * way) * random.standard_normal(n)
        turns = turn + noise * walk * math.sqrt(0.1) * random.standard_normal(n)
        fixes.rows(rows_of(turns, ways), np.pad(turns, (1, 1)), 0)
        assert fixes._way is not None
        claimed = claimed or math.sqrt(fixes._way.variance_m2(walk, wheel_noise))
        chords.append(float(np.hypot(*fixes._way.here)))
    assert np.std(chords) == pytest.approx(claimed, rel=0.15)


def test_a_hole_in_the_samples_spoils_one_distance_only() -> None:
    fixes, still, ahead = Fixes(0.005, 1e-5, 0.002), np.zeros(20), np.ones(20)
    fixes.fix(0, 0.0, 0.0, 0.01)
    for k, good in enumerate((True, False, True, True)):
        fixes.rows(rows_of(still, ahead, good), np.zeros(22), 2 * k * 10**9)
        if k in (1, 3):
            fixes.fix((2 * k + 2) * 10**9, 20.0 * k, 0.0, 0.01)
    fixes.rows(rows_of(still, ahead), np.zeros(22), 8 * 10**9)
    assert fixes.intervals == 1


def test_a_pose_that_was_moved_or_a_reset_spoils_one_distance_only() -> None:
    """Ahead by 20 m each time: to 20 m, said again 20 m on, to 40 m, a reset, to 58.8 m by it, to 78.8 m."""
    fixes, still, ahead = Fixes(0.005, 1e-5, 0.002), np.zeros(20), np.ones(20)
    for k, x_m in enumerate((0.0, 20.0, 20.0, 40.0, 58.8, 78.8)):
        if k == 4:
            fixes.fix(2 * k * 10**9 - 10**8, 0.0, 0.0, math.inf)
        fixes.fix(2 * k * 10**9, x_m, 0.0, 0.01)
        fixes.rows(rows_of(still, ahead), np.zeros(22), 2 * k * 10**9)
    assert fixes.intervals == 3
    assert fixes.findings() == []


def test_of_the_fastest_gyro_all_samples_wait_for_the_wheels() -> None:
    monitor, rate_hz = Monitor(CONFIG), 2000
    for k in range(1, 11 * rate_hz):
        t_ns = BEGIN_NS + k * 500_000
        monitor.gyro(GyroSample(t_ns, 0.0005, 0.0, 20.0))
        if t_ns % STEP_NS == 0:
            monitor.wheels(WheelSample(t_ns, 0.05, 0.05, 0.05, 0.0))
    assert monitor.now_s == pytest.approx(10.0, abs=0.11)
    assert monitor.distance_m == pytest.approx(10.0, abs=0.11)
