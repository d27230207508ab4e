"""The checks of an import, on simulated drives in which each trap is a knob."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from import_data import TREAD_M, Traps, drive

from drd_tools.importing.checks import OK, UNKNOWN, WRONG, Finding, check_peak, check_speed, gravity, most_turning
from drd_tools.importing.examine import Examined, examine
from drd_tools.importing.matching import Turning, angle_of, match

SEEDS = st.integers(0, 2**32 - 1)
PROPERTY = settings(max_examples=12, deadline=None)


def findings(seed: int, traps: Traps, *, reference: bool = True, axis: str | None = None, sign: int = 1) -> Examined:
    gyro, wheels, poses = drive(seed, traps)
    return examine(gyro, wheels, poses if reference else None, axis=axis, sign=sign, max_lag_s=2.0)


def one(examined: Examined, check: str) -> Finding:
    (found,) = [f for f in examined.findings if f.check == check]
    return found


@PROPERTY
@given(SEEDS, st.integers(0, 2), st.booleans())
def test_a_sound_drive_has_no_finding_but_ok(seed: int, axis: int, has_gravity: bool) -> None:
    examined = findings(seed, Traps(axis=axis, has_gravity=has_gravity))
    assert examined.axis == axis
    assert {f.verdict for f in examined.findings} == {OK}, examined.findings


@PROPERTY
@given(SEEDS, st.integers(0, 2), st.sampled_from([1.0, -1.0]), st.booleans())
def test_the_axis_is_found_whatever_its_sign(seed: int, axis: int, sign: float, reference: bool) -> None:
    found = one(findings(seed, Traps(axis=axis, gyro_sign=sign), reference=reference), "axis")
    assert found.verdict == OK
    assert found.proposal == {"axis": "xyz"[axis]}


def test_another_axis_than_the_chosen_one_is_wrong() -> None:
    found = one(findings(1, Traps(axis=1), axis="z"), "axis")
    assert found.verdict == WRONG
    assert found.proposal == {"axis": "y"}


@PROPERTY
@given(SEEDS)
def test_a_wrong_sign_is_known_by_the_reference(seed: int) -> None:
    examined = findings(seed, Traps(gyro_sign=-1.0))
    assert one(examined, "sign").verdict == WRONG
    assert one(examined, "sign").proposal
    assert one(examined, "sides").verdict == OK
    assert one(findings(seed, Traps(gyro_sign=-1.0), sign=-1), "sign").verdict == OK


@PROPERTY
@given(SEEDS)
def test_a_wrong_sign_is_known_by_gravity(seed: int) -> None:
    traps = Traps(gyro_sign=-1.0, has_gravity=True)
    examined = findings(seed, traps, reference=False)
    assert one(examined, "sign").verdict == WRONG
    assert one(examined, "sides").verdict == OK
    swapped = findings(seed, replace(traps, swapped=True), reference=False)
    assert one(swapped, "sign").verdict == WRONG
    assert one(swapped, "sides").proposal == {"swap": "yes"}


@PROPERTY
@given(SEEDS, st.booleans())
def test_gyro_against_wheels_alone_cannot_be_decided(seed: int, swapped: bool) -> None:
    traps = Traps(swapped=True) if swapped else Traps(gyro_sign=-1.0)
    examined = findings(seed, traps, reference=False)
    assert one(examined, "sign").verdict == UNKNOWN
    assert not one(examined, "sign").proposal
    assert one(examined, "sides").verdict == UNKNOWN


@PROPERTY
@given(SEEDS)
def test_swapped_sides_and_wrong_signs_are_told_apart_by_the_reference(seed: int) -> None:
    assert one(findings(seed, Traps(swapped=True)), "sides").proposal == {"swap": "yes"}
    both = findings(seed, Traps(left_sign=-1.0, right_sign=-1.0))
    assert one(both, "sides").proposal == {"reverse": "both"}
    assert one(both, "sign").verdict == OK
    backwards = findings(seed, Traps(swapped=True, left_sign=-1.0, right_sign=-1.0))
    assert one(backwards, "sides").verdict == UNKNOWN


@PROPERTY
@given(SEEDS, st.sampled_from(["left", "right"]), st.booleans())
def test_one_wheel_s_wrong_sign(seed: int, side: str, reference: bool) -> None:
    traps = Traps(left_sign=-1.0) if side == "left" else Traps(right_sign=-1.0)
    found = one(findings(seed, replace(traps, has_gravity=True), reference=reference), "one side")
    assert found.verdict == WRONG
    assert found.proposal == {"reverse": side}


@PROPERTY
@given(SEEDS, st.sampled_from([180.0 / math.pi, math.pi / 180.0]))
def test_degrees_for_radians(seed: int, factor: float) -> None:
    # Noise as large as the turning would drown it, whatever its unit.
    examined = findings(seed, Traps(gyro_factor=factor))
    for other in ("wheels", "reference"):
        found = one(examined, f"unit, gyro against {other}")
        assert found.verdict == WRONG
        assert ("degrees were taken for radians" in found.text) == (factor > 1.0)
        assert abs(found.numbers["gain"]) == pytest.approx(factor, rel=0.02)
    assert one(examined, "unit, wheels against reference").verdict == OK
    assert one(examined, "axis").verdict == OK


def test_noise_alone_makes_no_unit_wrong() -> None:
    for noise_rad_s in (0.5, 2.0, 4.0):
        examined = findings(4, Traps(noise_rad_s=noise_rad_s), axis="z")
        assert one(examined, "unit, gyro against wheels").verdict != WRONG


def test_a_gain_that_is_no_unit_is_reported_as_such() -> None:
    found = one(findings(3, Traps(gyro_factor=9.0)), "unit, gyro against wheels")
    assert found.verdict == WRONG
    assert "neither" in found.text


@PROPERTY
@given(SEEDS, st.floats(-1.5, 1.5))
def test_a_clock_offset_is_measured_within_its_uncertainty(seed: int, offset_s: float) -> None:
    examined = findings(seed, Traps(wheels_offset_s=offset_s, reference_offset_s=0.5 * offset_s))
    for name, true_s in (("wheels", offset_s), ("reference", 0.5 * offset_s)):
        found = one(examined, f"clock, {name} against gyro")
        lag_s, sigma_s = found.numbers["lag_s"], found.numbers["lag_sigma_s"]
        assert sigma_s < 0.02
        assert lag_s == pytest.approx(true_s, abs=5.0 * sigma_s)
        if abs(true_s) > 0.1:
            assert found.verdict == WRONG
            assert float(found.proposal[f"shift-{name}"]) == pytest.approx(-true_s, abs=0.02)


def test_the_offset_s_uncertainty_is_honest() -> None:
    ratios = []
    for seed in range(40):
        examined = findings(seed, Traps(noise_rad_s=0.3, wheels_offset_s=0.123), reference=False, axis="z")
        numbers = one(examined, "clock, wheels against gyro").numbers
        ratios.append((numbers["lag_s"] - 0.123) / numbers["lag_sigma_s"])
    assert 0.6 < np.sqrt(np.mean(np.square(ratios))) < 1.5


def test_an_offset_beyond_the_lags_tried_is_not_guessed() -> None:
    found = one(findings(5, Traps(wheels_offset_s=4.0), reference=False, axis="z"), "clock, wheels against gyro")
    assert found.verdict == UNKNOWN


@PROPERTY
@given(SEEDS)
def test_a_drive_that_does_not_turn_tells_nothing(seed: int) -> None:
    examined = findings(seed, Traps(turning=0.0))
    assert examined.axis is None
    assert {f.verdict for f in examined.findings} == {UNKNOWN}
    # Gravity needs no motion.
    still = findings(seed, Traps(turning=0.0, axis=1, gyro_sign=-1.0, has_gravity=True))
    assert one(still, "axis").proposal == {"axis": "y"}
    assert one(still, "sign").verdict == WRONG
    assert one(still, "clock, wheels against gyro").verdict == UNKNOWN


@PROPERTY
@given(SEEDS)
def test_strange_wheels_do_not_go_with_the_gyro(seed: int) -> None:
    gyro, _, _ = drive(seed, Traps())
    _, wheels, _ = drive(seed + 1, Traps())
    examined = examine(gyro, wheels, None, axis="z", sign=1, max_lag_s=2.0)
    assert one(examined, "unit, gyro against wheels").verdict == UNKNOWN
    assert one(examined, "sign").verdict == UNKNOWN


def test_gravity_that_disagrees_is_not_overruled() -> None:
    gyro, wheels, poses = drive(7, Traps(axis=2, has_gravity=True))
    assert gyro.acceleration_m_s2 is not None
    turned = replace(gyro, acceleration_m_s2=gyro.acceleration_m_s2[:, [2, 0, 1]])
    found = one(examine(turned, wheels, poses, axis=None, sign=1, max_lag_s=2.0), "axis")
    assert found.verdict == UNKNOWN
    assert not found.proposal


def test_what_is_no_gravity_is_not_taken_for_it() -> None:
    assert gravity(None) is None
    assert gravity(np.zeros((10, 3))) is None
    assert gravity(np.tile([7.0, 0.0, 7.0], (10, 1))) is None
    down = gravity(np.tile([0.0, -9.8, 0.5], (10, 1)))
    assert down is not None
    assert (down.axis, down.sign) == (1, -1)
    assert down.tilt_rad == pytest.approx(math.atan(0.5 / 9.8))


def test_the_most_turning_axis_is_only_a_hint() -> None:
    rng = np.random.default_rng(0)
    rates = rng.normal(0.0, 1.0, (1000, 3))
    assert not most_turning(rates, ("x", "y", "z")).proposal
    rates[:, 0] *= 30.0
    hint = most_turning(rates, ("x", "y", "z"))
    assert hint.verdict == UNKNOWN
    assert hint.proposal == {"axis": "x"}


def test_a_peak_beyond_any_gyro_is_wrong() -> None:
    assert check_peak(np.array([0.0, -17.0])) is None
    found = check_peak(np.array([0.0, -18.0]))
    assert found is not None
    assert found.verdict == WRONG


def test_wheels_faster_than_a_replay_believes() -> None:
    _, wheels, _ = drive(1, Traps(seconds=10.0))
    assert check_speed(wheels.time_s, wheels.left_m, wheels.right_m, 10.0) is None
    jumped = wheels.left_m + np.where(wheels.time_s > 5.0, 2.0, 0.0)
    found = check_speed(wheels.time_s, jumped, wheels.right_m, 10.0)
    assert found is not None
    assert found.verdict == WRONG
    assert found.numbers["rows"] == 1.0
    assert found.numbers["fastest_m_s"] == pytest.approx(40.0, abs=1.5)
    assert "(--modulus)" in found.text


def test_a_match_gives_the_gain_and_its_sigma() -> None:
    gyro, wheels, _ = drive(11, Traps(gyro_factor=1.3))
    turned = (wheels.right_m - wheels.left_m) / TREAD_M
    found = match(
        Turning(wheels.time_s, turned), Turning(gyro.time_s, angle_of(gyro.time_s, gyro.rate_rad_s[:, 2])), 1.0
    )
    assert found is not None
    assert found.is_clear
    assert found.gain == pytest.approx(1.3, abs=5.0 * found.gain_sigma + 0.01)
    assert found.gain_sigma < 0.01


def test_too_short_a_time_matches_nothing() -> None:
    gyro, wheels, _ = drive(12, Traps(seconds=8.0))
    turned = (wheels.right_m - wheels.left_m) / TREAD_M
    assert match(Turning(wheels.time_s, turned), Turning(gyro.time_s, gyro.time_s), 2.0) is None
    assert match(Turning(wheels.time_s[:2], turned[:2]), Turning(gyro.time_s, gyro.time_s), 2.0) is None
