"""Damaged and absurd recordings: an answer or one clear error, never anything else."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from diagnosis_drives import recorded, selected, simulated
from diagnosis_runs import written
from hypothesis import given, settings
from hypothesis import strategies as st

from drd.batch.logs import EncoderLog, FogLog
from drd.cli import main
from drd.config.schema import ConfigError
from drd.effects.effect import NOMINAL
from drd_tools.diagnose.analysis import analyse
from drd_tools.diagnose.observe.audit import audit
from drd_tools.diagnose.observe.constants import constants
from drd_tools.diagnose.observe.conventions import check_conventions
from drd_tools.diagnose.observe.evidence import gather
from drd_tools.diagnose.observe.grids import MOST_STEPS
from drd_tools.recordings.folder import Recording
from drd_tools.simulate.conditions import Conditions, Reference

Array = npt.NDArray[np.float64]
SHORT = ("slalom", 25.0)
VALUES = {"fog": ("rate_rad_s",), "wheels": ("left_counts", "right_counts"), "reference": ("x_m", "y_m", "heading_rad")}


@lru_cache
def short(reference: str) -> Recording:
    return simulated(SHORT, 1, conditions=Conditions(reference=Reference.parse(reference))).recording


def changed(
    recording: Recording, which: str, keep: npt.NDArray[np.bool_], shift_s: float = 0.0, factor: float = 1.0
) -> Recording:
    """With these rows of a log, later and larger."""
    log = getattr(recording, which)
    columns = {name: getattr(log, name)[keep] * factor for name in VALUES[which]}
    if which == "fog":
        columns["temperature_c"] = log.temperature_c[keep]
    return replace(recording, **{which: replace(log, time_s=log.time_s[keep] + shift_s, **columns)})


@st.composite
def damaged(draw: Any) -> Recording:
    recording = short(draw(st.sampled_from(["full", "sparse:5"])))
    for which in VALUES:
        n = len(getattr(recording, which).time_s)
        begin, end = sorted(draw(st.tuples(st.integers(0, n - 1), st.integers(0, n - 1))))
        inside = (np.arange(n) >= begin) & (np.arange(n) <= end)
        keep = draw(st.sampled_from([np.ones(n, bool), np.ones(n, bool), inside, ~inside]))
        keep[:2] |= which == "wheels"  # the form asks for two rows
        shift_s, factor = (
            draw(st.sampled_from([0.0, 0.0, 0.0, 3.0, 1e4])),
            draw(st.sampled_from([1.0, 1.0, 0.0, -1.0, 1e6])),
        )
        if draw(st.booleans()):
            recording = changed(recording, which, keep, shift_s, factor)
        elif draw(st.integers(0, 4)) == 0:
            absent: dict[str, Any] = {which: None}
            recording = replace(recording, **absent)
    if draw(st.booleans()):
        perfect = replace(
            recording.nominal,
            slip_noise_m_per_sqrt_m=0.0,
            reference_position_sigma_m=0.0,
            reference_heading_sigma_deg=0.0,
            gyro_angle_random_walk_deg_per_sqrt_h=0.0,
            gyro_bias_repeatability_deg_s=0.0,
        )
        recording = replace(recording, nominal=perfect)
    return recording


@pytest.mark.parametrize("shift_s", [0.0, 3.0])
def test_counters_that_leap_by_a_kilometre_are_answered(shift_s: float) -> None:
    """Products of columns so large have a rounding that is more than the priors beside them."""
    recording = short("sparse:5")
    assert recording.wheels is not None
    assert recording.reference is not None
    whole = np.ones(len(recording.reference.time_s), bool)
    leaping = changed(recording, "wheels", recording.wheels.time_s < 10.25, factor=1e6)
    conclusion = analyse(changed(leaping, "reference", whole, shift_s)).conclusion
    assert all(np.isfinite(c.explains) for c in conclusion.causes)


# A failing recording is long; as an error the warning would hide what failed.
@pytest.mark.filterwarnings("ignore:Generating overly large repr")
@settings(deadline=None, max_examples=10)
@given(damaged())
def test_whatever_is_damaged_is_answered_or_refused(recording: Recording) -> None:
    try:
        conclusion = analyse(recording).conclusion
    except ConfigError:
        return
    for finding in conclusion.causes:
        assert np.isfinite(finding.gain_nats)
        assert 0.0 < (finding.support.family_wise_p or 0.0) <= 1.0


ROW = "time_s,left_counts,right_counts\n0,0,0\n"
FLAT = "time_s,left_counts,right_counts\n" + "".join(f"{0.05 * k:.2f},7,7\n" for k in range(500))


@pytest.mark.parametrize(
    ("name", "change", "told"),
    [
        ("encoders.csv", lambda _: "", "encoders.csv: .*an empty file"),
        ("encoders.csv", lambda _: ROW, "encoders.csv: .*at least 2 rows of numbers, got 1"),
        ("encoders.csv", lambda t: t.replace("\n1.", "\nnan", 1), r"encoders.csv:\d+: time_s: .*finite number"),
        ("fog.csv", lambda t: t[: t.index("\n", 60) + 1], "fog.csv: .*at least 2 rows|at least 10 steps"),
        ("fog.csv", lambda t: "\n".join([*t.splitlines()[:20], t.splitlines()[5]]), r"fog.csv:21: time_s: .*after"),
        ("fog.csv", lambda t: "\n".join(t.splitlines()[:6]), "at least 10 steps of all sensors together, got 5"),
        ("reference.csv", lambda _: "time_s,x_m,y_m,heading_deg\n900,0,0,0\n", "reference.csv: time_s: .*overlap"),
        ("reference.csv", lambda _: "time_s,x_m,y_m,heading_deg\n1,0,0,0\n2,9e9,0,0\n", "reference.csv: speed in m/s"),
        ("robot.yaml", lambda _: "", "robot.yaml: wheel.radius_m: .*required"),
        ("robot.yaml", lambda t: t.replace("tread_m:", "tread_mm:"), r"robot.yaml:\d+: tread_mm: .*unknown key"),
    ],
)  # fmt: skip
def test_the_error_names_file_line_expected_and_got(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, change: Callable[[str], str], told: str
) -> None:
    run = written(tmp_path / "run", drive=SHORT)
    (run / name).write_text(change((run / name).read_text()))
    assert main(["diagnose", str(run), "--output", str(tmp_path / "out")]) == 2
    captured = capsys.readouterr()
    assert (captured.out, captured.err.count("\n")) == ("", 1)
    assert captured.err.startswith("drd diagnose: ")
    with pytest.raises(AssertionError, match=told):  # what was told, searched
        raise AssertionError(captured.err)
    assert not (tmp_path / "out").exists()


def test_three_seconds_of_data_are_an_answer() -> None:
    recording = short("full")
    for which in VALUES:
        time_s = getattr(recording, which).time_s
        recording = changed(recording, which, (time_s >= 12.0) & (time_s <= 15.0))
    assert analyse(recording).conclusion.causes == []


@pytest.mark.parametrize("factor", [0.0])
def test_counts_that_are_all_zero_while_the_gyro_turns_are_no_standstill_of_the_model(factor: float) -> None:
    """Both counters dead: the wheels disagree with everything, which is told in some form."""
    n = len(short("full").encoders.time_s)
    found = analyse(changed(short("full"), "wheels", np.ones(n, bool), factor=factor)).conclusion.causes
    assert found


def test_days_of_standstill_take_bounded_steps() -> None:
    time_s = np.arange(1.0, 2 * 86_400.0, 0.1)
    rate = np.random.default_rng(1).normal(0.0, 1e-4, len(time_s)) + 1e-4
    zeros = np.zeros(len(time_s))
    recording = replace(
        short("full"),
        fog=FogLog(time_s, rate, None),
        wheels=EncoderLog(time_s, zeros, zeros, None, None),
        reference=None,
    )
    e = gather(recording)
    assert len(e.time_s) == MOST_STEPS
    assert e.gyro_rad is not None
    # Of the part that is looked at, the whole angle stays.
    assert e.gyro_rad.sum() == pytest.approx(float(rate[:MOST_STEPS].sum()) * 0.1, rel=1e-9)
    assert e.step_s.sum() == pytest.approx(MOST_STEPS * 0.1, rel=1e-9)
    assert e.still.all()


def test_a_fast_gyro_is_added_up_to_steps() -> None:
    base = short("full")
    assert base.fog is not None
    time_s: Array = np.arange(1.0, 20_001.0) * 1e-3
    rate = np.asarray(np.interp(time_s, base.fog.time_s, base.fog.rate_rad_s), np.float64)
    e = gather(replace(base, fog=FogLog(time_s, rate, None)))
    assert len(e.time_s) == 200
    assert e.gyro_rad is not None
    assert e.gyro_rad.sum() == pytest.approx(float(rate.sum()) * 1e-3, rel=1e-9)


@pytest.mark.parametrize("which", ["fog", "wheels"])
@pytest.mark.parametrize("length_s", [0.3, 2.0, 10.0])
@pytest.mark.parametrize("drive", [("slalom", 90.0), ("square-cw", 120.0)])
def test_a_hole_in_a_log_is_no_physics(which: str, length_s: float, drive: tuple[str, float]) -> None:
    recording = recorded(drive, 2)
    time_s = getattr(recording, which).time_s
    recording = changed(recording, which, (time_s < 40.02) | (time_s > 40.02 + length_s))
    assert audit(recording, gather(recording)).events == []
    assert analyse(recording).conclusion.causes == []


@pytest.mark.parametrize("per_step", [1, 10])
def test_the_gyro_itself_tells_the_turn_in_short_holes(per_step: int) -> None:
    """By the wheels, of a tread that is off by two thirds, the robot would turn a tenth of that too much."""
    base = short("full")
    assert base.fog is not None
    time_s = base.fog.time_s[0] + 0.1 / per_step * np.arange(1.0, 10.0 * per_step * SHORT[1])
    fog = FogLog(time_s, np.asarray(np.interp(time_s, base.fog.time_s, base.fog.rate_rad_s), np.float64), None)
    narrow = replace(base.nominal, tread_m=0.6 * base.nominal.tread_m)
    whole = gather(replace(base, fog=fog, nominal=narrow))
    kept = np.random.default_rng(3).uniform(size=len(time_s)) > 0.1
    kept[[0, -1]] = True
    e = gather(replace(base, fog=FogLog(time_s[kept], fog.rate_rad_s[kept], None), nominal=narrow))
    assert whole.gyro_rad is not None
    assert e.gyro_rad is not None
    assert len(e.time_s) == len(whole.time_s)
    off = np.cumsum(e.gyro_rad - whole.gyro_rad)
    assert np.abs(off).max() < 5.0 * np.sqrt(e.gyro_inflation_rad2.sum())
    assert np.abs(off).max() < 0.003 * np.abs(whole.gyro_rad).sum()
    assert 0 < np.count_nonzero(e.gyro_inflation_rad2) < 0.2 * per_step * len(e.time_s)
    assert not e.gyroless.any()


@pytest.mark.parametrize("lag_s", [0.0, 0.17])
def test_in_a_long_hole_of_the_gyro_the_turn_is_that_of_calibrated_wheels(lag_s: float) -> None:
    """Wheels that are late still turn when the robot does not any more."""
    late = [selected("encoder_latency", delay=lag_s)] if lag_s else []
    made = simulated(SHORT, 1, selected("tread_error", k=0.5), *late).recording
    whole = gather(made)
    assert made.fog is not None
    assert whole.gyro_rad is not None
    for begin_s in np.arange(12.02, 20.0):
        hole = (made.fog.time_s > begin_s) & (made.fog.time_s < begin_s + 3.0)
        e = gather(changed(made, "fog", ~hole), NOMINAL._replace(tread=1.5, wheels_lag_s=lag_s))
        assert e.gyro_rad is not None
        at = (e.time_s > begin_s) & (e.time_s < begin_s + 3.0)
        np.testing.assert_array_equal(e.gyro_inflation_rad2 > 0.0, at)
        turned = np.abs(whole.gyro_rad[at]).sum()
        sigma_rad = np.sqrt(e.gyro_inflation_rad2.sum())
        assert sigma_rad == pytest.approx(0.1 * turned, rel=0.5, abs=0.1)
        assert abs((e.gyro_rad - whole.gyro_rad).sum()) < 3.0 * sigma_rad
        assert abs((e.gyro_rad - whole.gyro_rad).sum()) < 0.03 * turned + 0.01


def test_an_effect_is_found_beside_holes() -> None:
    recording = recorded(("slalom", 120.0), 2, selected("gyro_scale_error", k=0.003))
    for which, begin_s in (("fog", 40.02), ("wheels", 70.02), ("fog", 90.02)):
        time_s = getattr(recording, which).time_s
        recording = changed(recording, which, (time_s < begin_s) | (time_s > begin_s + 3.0))
    (found,) = analyse(recording).conclusion.causes
    assert "gyro_scale_error" in (found.effect, *found.also_fits)


def gyro(recording: Recording, factor: float) -> Recording:
    assert recording.fog is not None
    return replace(recording, fog=replace(recording.fog, rate_rad_s=factor * recording.fog.rate_rad_s))


def headings(recording: Recording, factor: float) -> Recording:
    reference = recording.reference
    assert reference is not None
    return replace(recording, reference=replace(reference, heading_rad=factor * reference.heading_rad))


def offset(recording: Recording, degrees: float) -> Recording:
    reference = recording.reference
    assert reference is not None
    return replace(recording, reference=replace(reference, heading_rad=reference.heading_rad + np.radians(degrees)))


def scaled(recording: Recording, factor: float) -> Recording:
    return changed(recording, "wheels", np.ones(len(recording.encoders.time_s), bool), factor=factor)


def swapped(recording: Recording) -> Recording:
    log = recording.encoders
    return replace(recording, wheels=replace(log, left_counts=log.right_counts, right_counts=log.left_counts))


@pytest.mark.parametrize(
    ("turned", "where", "told"),
    [
        (lambda r: gyro(r, -1.0), "fog.csv", "clockwise is positive"),
        (lambda r: gyro(r, np.pi / 180.0), "", "radians were taken for degrees"),
        (swapped, "encoders.csv", "left and right are swapped"),
        (lambda r: headings(replace(r, fog=None), np.pi / 180.0), "", "degrees were taken for radians"),
        (lambda r: headings(r, -1.0), "reference.csv", "turns against both"),
        (lambda r: offset(r, 90.0), "reference.csv", r"\+[89]. deg off"),
        (lambda r: offset(replace(r, fog=None), -20.0), "reference.csv", "-[12]. deg off"),
        (lambda r: scaled(r, 4.0), "encoders.csv", r"4\.\d+ times"),
        (lambda r: scaled(r, 2.0), "encoders.csv", r"2(\.\d+)? times"),
        (lambda r: scaled(r, 0.5), "encoders.csv", r"0\.[45]\d* times"),
    ],
)
def test_a_sensor_that_turns_the_other_way_or_in_another_unit_is_no_missing_physics(
    turned: Callable[[Recording], Recording], where: str, told: str
) -> None:
    right = recorded(SHORT, 1)
    assert analyse(right).conclusion.causes == []
    with pytest.raises(ConfigError, match=told) as error:
        analyse(turned(right))
    assert Path(error.value.where) == right.folder / where


@pytest.mark.parametrize("drive", [SHORT, ("eights", 60.0), ("spins", 60.0)])
def test_a_robot_that_slips_half_of_its_way_on_one_side_or_is_mounted_askew_is_diagnosed(
    drive: tuple[str, float],
) -> None:
    slips = selected("surface_slip", t0=0.0, t1=100.0, left=0.0, right=0.5)
    check_conventions(offset(recorded(drive, 1, slips), 10.0))
    dead = recorded(drive, 1)
    wheels = replace(dead.encoders, left_counts=np.zeros(len(dead.encoders.time_s)))
    check_conventions(replace(dead, wheels=wheels, fog=None))


def test_headings_that_turn_the_other_way_than_wheels_do_not_end_the_calibration_in_an_overflow() -> None:
    found = constants(headings(replace(recorded(("slalom", 120.0), 1), fog=None), -1.0))
    assert all(map(np.isfinite, found.robot))
