"""Sensors' readings of effects that pass through a geometry and delays."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from diagnosis_drives import FAR, WAREHOUSE, problem, recorded, selected

from drd.effects.chain import add
from drd.effects.effect import Errors
from drd_tools.diagnose.analysis import analyse
from drd_tools.diagnose.error_model.linear import Sensitivity
from drd_tools.diagnose.error_model.sensitivities import Sensitivities
from drd_tools.diagnose.observe.evidence import gather
from drd_tools.diagnose.regression.chain import Readings, chain_of
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.selected import Selected


@cache
def along() -> Sensitivities:
    """Along a motion whose wheels turn as counters of a robot far from robot.yaml tell."""
    made = problem(WAREHOUSE, 1).sensitivities
    counted, _ = add(made.motion, [(c.effect, c.values) for c in FAR if c.effect.geometry])
    angles = {name: getattr(counted, name) for name in ("left_wheel_rad", "right_wheel_rad")}
    return made.along(lambda _: replace(made.motion, **angles))


def together(*selection: Selected) -> Sensitivity:
    """Errors of all sensors by effects that act one after the other, as in the simulator."""
    made, told = along(), problem(WAREHOUSE, 1).sensitivities.motion
    read, _ = add(told, [(c.effect, c.values) for c in selection])
    return made.of(
        Errors(read.rate_rad_s - told.rate_rad_s, read.left_m_s - told.left_m_s, read.right_m_s - told.right_m_s)
    )


@pytest.mark.parametrize(
    "added",
    [
        selected("wheel_eccentricity", side="left", e=0.03, phase=1.0),
        selected("surface_slip", t0=30.0, t1=45.0, left=0.2, right=0.3),
        selected("slip_acceleration", k=0.1),
        selected("tyre_deflation", side="right", total=0.1),
    ],
    ids=lambda c: c.id,
)
def test_an_effect_before_a_delay_is_as_late(added: Selected) -> None:
    everything = (*FAR, added)
    readings = Readings(along(), chain_of(everything))
    parts = [readings.sensitivity(c.effect, c.values) for c in everything]
    whole, own = together(*everything), parts[-1]
    for channel in ("left_m", "right_m"):
        total = np.sum([getattr(part, channel) * np.ones(len(along().e.step_s)) for part in parts], axis=0)
        off, size = total - getattr(whole, channel), np.linalg.norm(getattr(own, channel))
        assert np.linalg.norm(off) <= 0.1 * size + 1e-9


def test_without_a_chain_nothing_is_late() -> None:
    slip = selected("slip_acceleration", k=0.1)
    made = Readings(along()).sensitivity(slip.effect, slip.values)
    np.testing.assert_array_equal(made.left_m, along().of(slip.effect.error(along().motion, slip.values)).left_m)


def test_a_ripple_is_found_behind_a_delay_of_a_robot_far_off() -> None:
    """A wheel of other size turns by its counter: by the way it would be two turns off at the end of this drive."""
    ripple = selected("wheel_eccentricity", side="left", e=0.03, phase=1.0)
    causes = analyse(recorded(("field", 200.0), 1, *FAR, ripple)).conclusion.causes
    (found,) = [c.selected for c in causes if c.selected is not None and c.selected.id == ripple.id]
    assert found.number("phase") == pytest.approx(1.0, abs=0.15)
    assert found.number("e") == pytest.approx(0.03, abs=3.0 * found.sigma("e"))


def test_the_cleared_gyro_of_a_clock_far_off_turns_when_the_robot_did() -> None:
    """After 170 s a sample that is stamped 5 s early is another 0.15 s off if its age is taken at the wrong time."""
    clock = selected("gyro_sample_clock", ratio=0.97)
    recording = recorded(("field", 200.0), 4, clock)
    plain = Problem(gather(recorded(("field", 200.0), 4))).evidence
    cleared = Problem(gather(recording)).cleared([clock])
    assert cleared.gyro_rad is not None
    assert plain.gyro_rad is not None
    inside = slice(100, -200)  # at the ends a late sample shows what has not been recorded
    off = np.cumsum(cleared.gyro_rad - plain.gyro_rad)[inside]
    assert np.ptp(off) < 0.04


def test_a_slip_of_half_the_travel_is_removed_whole() -> None:
    """It is a share of the speed without slip, which is known once the slip is removed."""
    slip = selected("surface_slip", t0=40.0, t1=90.0, left=0.5, right=0.2)
    plain, slipping = (gather(recorded(WAREHOUSE, 3, *selection)) for selection in ((), (slip,)))
    inside = (plain.time_s > 40.5) & (plain.time_s < 89.5)
    cleared = Problem(slipping).cleared([slip])
    assert np.abs(slipping.left_m - plain.left_m)[inside].sum() > 0.4 * plain.left_m[inside].sum()
    off = np.abs(cleared.left_m - plain.left_m)[inside].sum() / plain.left_m[inside].sum()
    assert off < 0.02
