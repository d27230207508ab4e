"""A robot that is far from its robot.yaml, with a reference that is late and jumps: as real ones are."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from diagnosis_drives import (
    ASIDE_4_CM,
    FAR,
    LEFT,
    REFERENCE_S,
    RIGHT,
    SLALOM,
    TREAD,
    WAREHOUSE,
    WHEELS_S,
    recorded,
    selected,
)
from scipy.ndimage import uniform_filter1d
from wheel_recordings import later

from drd.batch.logs import EncoderLog
from drd_tools.calibrate.wheels.drift import Drift
from drd_tools.diagnose.analysis import Analysis, analyse
from drd_tools.diagnose.observe import lags
from drd_tools.diagnose.observe.audit import audit
from drd_tools.diagnose.observe.constants import constants, observe
from drd_tools.diagnose.observe.evidence import gather
from drd_tools.diagnose.observe.lags import find_lags
from drd_tools.diagnose.observe.parts import between
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.regression.refine import refine
from drd_tools.diagnose.results import Status
from drd_tools.diagnose.run import concluded
from drd_tools.diagnose.selected import Selected
from drd_tools.recordings.folder import Recording, read_recording
from drd_tools.simulate.conditions import Conditions, Reference
from drd_tools.simulate.missions import Drive
from drd_tools.simulate.robot import DEFAULT
from drd_tools.simulate.route import Route
from drd_tools.simulate.simulator import simulate
from drd_tools.simulate.truth import make_truth
from drd_tools.trial.overlay import planted

SHARED = Path(__file__).parents[4] / "shared" / "recordings"


def late(recording: Recording, lag_s: float = REFERENCE_S) -> Recording:
    reference = recording.reference
    assert reference is not None
    return replace(recording, reference=replace(reference, time_s=reference.time_s + lag_s))


def far(*more: Selected, seed: int = 1) -> Recording:
    return late(recorded(("field", 200.0), seed, *FAR, *more))


@cache
def diagnosed() -> Analysis:
    return analyse(far())


def test_the_calibrator_measures_the_constants_and_the_references_lag() -> None:
    found = constants(far())
    assert found.robot.tread == pytest.approx(1.0 + TREAD, rel=0.02)
    assert found.robot.left == pytest.approx(1.0 / (1.0 - LEFT), rel=0.01)
    assert found.robot.right == pytest.approx(1.0 / (1.0 - RIGHT), rel=0.01)
    assert found.robot.wheels_lag_s == pytest.approx(WHEELS_S, abs=0.01)
    assert found.lag_s == pytest.approx(REFERENCE_S, abs=0.02)
    assert found.robot.lag_growth == 0.0


def test_constants_far_off_are_named_with_their_sizes_and_nothing_else_is() -> None:
    causes = {c.effect: c.selected for c in diagnosed().conclusion.causes}
    assert causes.keys() == {c.id for c in FAR}
    for true in FAR:
        found = causes[true.id]
        assert found is not None
        for name in true.free or true.values:
            assert found.number(name) == pytest.approx(true.number(name), abs=max(3.0 * found.sigma(name), 0.01))


def test_a_references_lag_is_told_as_its_own_fault() -> None:
    lag = diagnosed().reference["lag"]
    assert lag.value == pytest.approx(REFERENCE_S, abs=0.02)
    assert analyse(recorded(SLALOM, 1)).reference == {}


@pytest.mark.parametrize(
    ("ppm", "named"), [(-400.0, []), (400.0, []), (-2200.0, ["encoder_clock_skew"]), (2200.0, ["encoder_clock_skew"])]
)
def test_without_a_gyro_clocks_that_drift_apart_are_named_beyond_what_references_do(
    ppm: float, named: list[str]
) -> None:
    """Which of the two clocks drifts nothing tells; 0.3 s in a drive are 3 deviations of a real reference's lag."""
    recording = replace(recorded(WAREHOUSE, 3), fog=None)
    assert recording.reference is not None
    assert recording.wheels is not None
    time_s = recording.reference.time_s * (1.0 + 1e-6 * ppm)
    analysis = analyse(replace(recording, reference=replace(recording.reference, time_s=time_s)))
    # Terrain of the last seconds is worth 16 nats beside such a clock, about its cost: it may be told, too.
    may_be_told = {"terrain_tread"} if named else set[str]()
    assert [c.effect for c in analysis.conclusion.causes if c.effect not in may_be_told] == named
    if named:
        cause = analysis.conclusion.causes[0]
        assert cause.selected is not None
        # From the timing alone: in the fit it is off by a tenth.
        assert cause.selected.number("ppm") == pytest.approx(ppm * 1e-6, abs=1e-4)
        assert cause.probabilities["encoder_clock_skew"] > 0.9
    else:
        drift = analysis.reference["drift"]
        assert drift.value == pytest.approx(ppm, abs=max(3.0 * drift.std, 100.0))


@pytest.mark.parametrize(("delay_s", "named"), [(0.09, []), (0.13, ["encoder_latency"])])
def test_without_a_gyro_a_delay_is_named_at_odds_of_three_against_the_references(
    delay_s: float, named: list[str]
) -> None:
    """0.11 s have them, of a reference whose own delay has a deviation of 50 ms and an effect of 0 to 0.5 s."""
    late = replace(recorded(WAREHOUSE, 3, selected("encoder_latency", delay=delay_s)), fog=None)
    analysis = analyse(late)
    assert [c.effect for c in analysis.conclusion.causes] == named
    if named:
        (cause,) = analysis.conclusion.causes
        assert 0.75 < cause.probabilities["encoder_latency"] < 0.95
        assert sum(cause.probabilities.values()) == pytest.approx(1.0)
    else:
        assert analysis.reference["delay"].value == pytest.approx(delay_s, abs=0.02)


def test_beside_a_tread_two_and_a_half_times_as_wide_slip_is_found_and_both_are_confirmed() -> None:
    """A constant that the calibrator has measured is plausible, however far it is from robot.yaml."""
    slip = selected("surface_slip", t0=80.0, t1=110.0, left=0.12, right=0.03)
    found = analyse(late(recorded(WAREHOUSE, 3, selected("tread_error", k=1.5), *FAR[1:], slip))).conclusion.causes
    assert {c.effect for c in found} == {"surface_slip", *(c.id for c in FAR)}
    assert {c.status for c in found} == {Status.CONFIRMED}


def test_without_a_gyro_a_far_robots_constants_are_found_and_nothing_else() -> None:
    """At the ends of its turns the smoothed turn is wrong for half a second, by a hundred times the noise."""
    found = analyse(replace(late(recorded(WAREHOUSE, 5, *FAR)), fog=None)).conclusion.causes
    named = {c.effect: c.selected for c in found}
    assert named.keys() == {"tread_error", "wheel_radius_error"}  # whose delay it is nothing tells
    tread, radii = named["tread_error"], named["wheel_radius_error"]
    assert tread is not None
    assert radii is not None
    assert tread.number("k") == pytest.approx(TREAD, abs=0.03)
    assert radii.number("left") == pytest.approx(LEFT, abs=0.005)


def test_slip_beside_constants_far_off_is_found_with_its_size_and_time() -> None:
    slip = selected("surface_slip", t0=80.0, t1=110.0, left=0.12, right=0.03)
    found = {c.effect: c.selected for c in analyse(far(slip)).conclusion.causes}
    cause = found["surface_slip"]
    assert cause is not None
    assert cause.number("left") == pytest.approx(0.12, abs=0.02)
    assert (cause.number("t0"), cause.number("t1")) == pytest.approx((80.0, 110.0), abs=2.0)


def test_constants_far_off_survive_a_gyro_that_clips_through_whole_turns() -> None:
    """Beyond the limit only the wheels tell the turn, with a tread that robot.yaml has 65 % too small."""
    analysis = analyse(far(selected("gyro_saturation", limit=0.25)))
    causes = {c.effect: c.selected for c in analysis.conclusion.causes}
    assert causes.keys() == {*(c.id for c in FAR), "gyro_saturation"}
    tread = causes["tread_error"]
    assert tread is not None
    assert tread.number("k") == pytest.approx(TREAD, abs=3.0 * tread.sigma("k"))


def test_a_late_gyro_beside_a_late_reference_is_not_observable() -> None:
    """Three sensors have two lags against each other: which of the two is late by more nobody knows."""
    late_gyro = analyse(far(selected("gyro_latency", delay=0.06)))
    assert "gyro_latency" not in {c.effect for c in late_gyro.conclusion.causes}
    result = concluded(late_gyro).result
    assert "reference" in next(row.because for row in result.unobservable if row.effect == "gyro_latency")


def test_a_clock_that_drifts_is_measured_by_the_lag_that_grows() -> None:
    drifting = recorded(("field", 200.0), 2, selected("encoder_clock_skew", ppm=-1500e-6))
    assert constants(drifting).robot.lag_growth == pytest.approx(1500e-6, rel=0.15)


@pytest.mark.parametrize("ratio", [0.97, 1.01])
def test_a_gyros_clock_is_what_wheels_and_reference_run_away_from_together(ratio: float) -> None:
    """A DSP-3000's samples come 2 to 3 % faster or slower than its datasheet has it."""
    clock = selected("gyro_sample_clock", ratio=ratio)
    recording = far(clock)
    found = constants(recording).robot
    assert found.gyro_clock == pytest.approx(ratio, abs=5e-4)
    assert (found.wheels_lag_s, found.lag_growth) == pytest.approx((WHEELS_S, 0.0), abs=0.02)
    causes = {c.effect: c.selected for c in analyse(recording).conclusion.causes}
    assert causes.keys() == {*(c.id for c in FAR), clock.id}
    cause = causes[clock.id]
    assert cause is not None
    assert cause.number("ratio") == pytest.approx(ratio, abs=3.0 * cause.sigma("ratio"))


def test_a_gyros_clock_that_ran_off_before_the_recording_is_not_taken_for_one_that_begins_with_it() -> None:
    recording = later(far(selected("gyro_sample_clock", ratio=1.01)), 1200.0)
    assert find_lags(recording).clock == 1.0


@pytest.mark.parametrize(
    ("wheels", "reference", "clock"),
    [
        (Drift(-0.2, -0.0049, 0.0084), Drift(0.3, -0.0119, 0.0025), 1.0112),  # no reference's clock is so far off
        (Drift(-0.2, -0.0049, 0.0084), Drift(0.3, -0.0041, 0.0010), 1.0),  # a reference's may be
        (Drift(0.1, 0.0045, 0.0008), Drift(0.3, 0.0052, 0.0008), 0.9952),
        (Drift(0.1, 0.0012, 0.0008), Drift(0.3, 0.0022, 0.0008), 1.0),  # hardly there
        (Drift(0.1, 0.0100, 0.0008), Drift(0.3, 0.0001, 0.0008), 1.0),  # they contradict each other
        (Drift(1.5, 0.0140, 0.0008), Drift(1.7, 0.0140, 0.0008), 1.0),  # which ran off before
    ],
)
def test_a_gyros_clock_is_the_likeliest_of_what_may_run_off(wheels: Drift, reference: Drift, clock: float) -> None:
    recording = recorded(("field", 200.0), 2)
    assert lags._gyro_clock(recording, wheels, reference)[0] == pytest.approx(clock, abs=3e-4)


def test_a_wheels_clock_is_not_the_gyros() -> None:
    found = constants(far(selected("encoder_clock_skew", ppm=-1500e-6))).robot
    assert found.gyro_clock == 1.0
    assert found.lag_growth == pytest.approx(1500e-6, rel=0.15)


def test_wheels_that_run_ahead_a_little_are_no_late_gyro_and_reference() -> None:
    found = constants(recorded(("field", 200.0), 2, selected("encoder_clock_skew", ppm=400e-6)))
    assert (found.robot.gyro_lag_s, found.lag_s) == (0.0, 0.0)


def test_of_three_sensors_the_earliest_is_in_time() -> None:
    """A gyro that is later than the wheels, and as late as the reference."""
    late_gyro = recorded(("field", 200.0), 1, *FAR, selected("gyro_latency", delay=REFERENCE_S))
    found = constants(late(late_gyro))
    assert found.robot.wheels_lag_s == 0.0
    assert found.robot.gyro_lag_s == pytest.approx(REFERENCE_S - WHEELS_S, abs=0.02)
    assert found.lag_s == pytest.approx(REFERENCE_S - WHEELS_S, abs=0.02)


@pytest.mark.parametrize(("ahead_s", "is_noted"), [(0.0, False), (0.2, True)])
def test_sensors_later_than_the_reference_may_be_in_time_by_a_clock_that_is_ahead(
    ahead_s: float, is_noted: bool
) -> None:
    """Nothing in the recording tells a delay of both sensors from the reference's clock, as of another computer."""
    recording = recorded(("field", 200.0), 1, *FAR)
    measured, _ = observe(late(recording, -ahead_s))
    assert measured.ahead_s == pytest.approx(ahead_s, abs=0.02)
    assert any("its clock may be ahead" in note for note in measured.recording.notes) == is_noted


def test_cleared_wheels_turn_when_the_gyro_does() -> None:
    """The error of a tread that is far off is taken off at the time of the turn, not at that of its late reading."""
    recording = recorded(("field", 200.0), 1, *FAR)
    problem = Problem(gather(recording))
    clear = problem.cleared(FAR)
    wheels, gyro = (clear.right_m - clear.left_m) / clear.tread_m, clear.gyro_rad
    assert gyro is not None
    slope = np.gradient(gyro)
    late_steps = -float(slope @ (wheels - gyro)) / float(slope @ slope)
    assert late_steps * float(np.median(clear.step_s)) == pytest.approx(0.0, abs=0.01)


def test_a_reference_that_jumps_names_nothing() -> None:
    """As a lidar's map does: from 60 s on it is turned, and moved."""
    recording = recorded(SLALOM, 3)
    reference = recording.reference
    assert reference is not None
    jumped = reference.time_s > 60.0
    first, turn = int(np.argmax(jumped)), 0.3 * jumped
    x, y = reference.x_m - reference.x_m[first], reference.y_m - reference.y_m[first]
    x, y = x * np.cos(turn) - y * np.sin(turn) + 0.4 * jumped, x * np.sin(turn) + y * np.cos(turn)
    other = replace(recording, reference=replace(reference, x_m=x, y_m=y, heading_rad=reference.heading_rad + turn))
    e = audit(other, gather(other)).evidence
    (at,) = np.flatnonzero(e.jump_rad2)
    assert e.time_s[at] == pytest.approx(60.0, abs=0.2)
    assert e.jump_m2[at] > 0.1
    assert analyse(other).conclusion.causes == []


@pytest.mark.parametrize("at_s", [60.02, 60.07])
def test_a_dense_reference_that_jumps_in_the_midst_of_a_step_names_nothing(at_s: float) -> None:
    """A step holds two fixes of a motion capture: one may be before the jump, or both after it."""
    recording = replace(recorded(SLALOM, 3, conditions=Conditions(reference=Reference(period_s=0.05))), fog=None)
    assert recording.reference is not None
    moved_m = np.where(recording.reference.time_s > at_s, 0.3, 0.0)
    jumped = replace(recording, reference=replace(recording.reference, x_m=recording.reference.x_m + moved_m))
    e = gather(jumped)
    assert np.bincount(e.fix_step).min() == 2
    assert np.count_nonzero(audit(jumped, e).evidence.jump_m2) == 1
    analysis = analyse(jumped)
    assert analysis.conclusion.causes == []
    assert analysis.reference["jumps"].value == 1.0


def test_a_markers_place_is_told_as_the_references_own_fault() -> None:
    left = analyse(recorded(WAREHOUSE, 3, conditions=ASIDE_4_CM)).reference["left"]
    assert left.value == pytest.approx(0.04, abs=min(4.0 * left.std, 0.01))


def test_a_reference_that_averages_is_told_by_how_much() -> None:
    recording = recorded(SLALOM, 5, *FAR)
    r = recording.reference
    assert r is not None
    rows = round(0.6 / float(np.median(np.diff(r.time_s)))) + 1
    x_m, y_m, heading_rad = (uniform_filter1d(v, rows, mode="nearest") for v in (r.x_m, r.y_m, r.heading_rad))
    averaged = replace(r, x_m=x_m, y_m=y_m, heading_rad=heading_rad, time_s=r.time_s + REFERENCE_S)
    told = analyse(replace(recording, reference=averaged)).reference["smoothing"]
    assert told.value == pytest.approx(1.0, abs=0.05)  # of a mean over 0.6 s
    assert told.std < 0.05
    assert "smoothing" not in analyse(late(recording)).reference


def test_a_path_through_jumps_of_the_reference_in_a_row_stays_where_it_is() -> None:
    """Between two jumps no fix holds the heading: the sensors do."""
    recording = recorded(SLALOM, 3)
    reference = recording.reference
    assert reference is not None
    heading, x = reference.heading_rad.copy(), reference.x_m.copy()
    first = int(np.argmax(reference.time_s > 60.0))
    heading[first : first + 6] += [0.15, -0.15, 0.25, 0.1, -0.2, 0.3]
    x[first : first + 6] += [0.1, 0.3, -0.2, 0.2, 0.05, -0.3]
    other = replace(recording, reference=replace(reference, x_m=x, heading_rad=heading))
    e = audit(other, gather(other)).evidence
    assert np.count_nonzero(e.jump_rad2) >= 5
    assert e.gyro_rad is not None
    p, costs = Problem(replace(e, is_far=True)), []
    for _ in range(6):
        p = p.around([])
        costs.append(refine(p, []).cost)
    assert costs == pytest.approx([costs[0]] * len(costs), abs=3.0)
    assert np.abs(p.path.steps()[2] - e.gyro_rad).max() < 0.01


def test_a_wheel_whose_speed_is_dead_is_found_and_the_constants_are_those_of_the_rest() -> None:
    """The drive holds its speeds for a quarter of a second, as real ones do: shorter rests are no event."""
    recording = far()
    angles = recording.wheel_angles_rad()
    time_s = recording.encoders.time_s
    held_s = np.arange(time_s[0], time_s[-1], 0.25)
    speeds = [np.gradient(np.interp(held_s, time_s, angle), held_s) for angle in angles]
    left, right = (speed[np.searchsorted(held_s, time_s, "right") - 1] for speed in speeds)
    right = np.where((time_s >= 90.0) & (time_s < 92.5), 0.0, right)
    dead = replace(
        recording,
        nominal=replace(recording.nominal, counts_per_revolution=None),
        wheels=EncoderLog(time_s, None, None, left, right),
    )
    measured, audited = observe(dead)
    (event,) = audited.events
    assert event.selected.id == "encoder_dropout"
    assert event.selected.values["side"] == "right"
    assert event.windows[0] == pytest.approx((90.0, 92.5), abs=0.1)
    assert measured.robot.tread == pytest.approx(1.0 + TREAD, rel=0.03)


def test_shares_of_the_mismatch_add_up_and_a_tread_far_off_has_its_own() -> None:
    """Without the tread, wheels that are a third smaller would explain nearly as much: it has a share all the same."""
    conclusion = diagnosed().conclusion
    shares = {c.effect: c.explains for c in conclusion.causes}
    assert 0.95 < sum(shares.values()) + conclusion.unexplained <= 1.0 + 1e-9
    assert shares["tread_error"] > 0.3


@pytest.mark.skipif(not SHARED.exists(), reason="the shared recordings are not there")
def test_a_real_skid_steer_robots_constants_are_the_calibrations() -> None:
    """The real figures: an effective tread 64 to 84 % above nominal, wheels 0.14 to 0.19 s, reference 0.26 to 0.52."""
    analysis = analyse(read_recording(SHARED / "warthog_grass_2024_8_8_16h11s19"))
    found = {c.effect: c.selected for c in analysis.conclusion.causes}
    tread, latency = found["tread_error"], found["encoder_latency"]
    assert tread is not None
    assert latency is not None
    assert 0.6 < tread.number("k") < 0.85
    assert 0.13 < latency.number("delay") < 0.2
    assert 0.26 < analysis.reference["lag"].value < 0.55


@pytest.mark.recordings
@pytest.mark.skipif(not SHARED.exists(), reason="the shared recordings are not there")
@pytest.mark.parametrize("name", ["asphalt_2024_9_25_12h8s57", "grass_2024_7_29_14h8s51", "grass_2024_8_8_16h11s19"])
def test_without_a_gyro_a_real_skid_steer_robots_tread_is_found(name: str) -> None:
    """The drive holds its speeds for 0.25 to 0.5 s: as white noise that would take most of each turn for its own."""
    found = analyse(replace(read_recording(SHARED / f"warthog_{name}"), fog=None)).conclusion.causes
    (tread,) = (c.selected for c in found if c.effect == "tread_error")
    assert tread is not None
    assert 0.6 < tread.number("k") < 0.85


@pytest.mark.recordings
@pytest.mark.skipif(not SHARED.exists(), reason="the shared recordings are not there")
def test_without_a_gyro_a_real_robots_wheels_of_other_sizes_are_no_missed_counts() -> None:
    whole = read_recording(SHARED / "optiodom_square_230620202042_run-05")
    log = whole.wheels
    assert log is not None
    assert log.left_counts is not None
    assert log.right_counts is not None
    left, right = np.round(0.917 * log.left_counts), np.round(1.049 * log.right_counts)
    causes = analyse(replace(whole, wheels=replace(log, left_counts=left, right_counts=right))).conclusion.causes
    assert [c.effect for c in causes] == ["wheel_radius_error"]
    radii = causes[0].selected
    assert radii is not None  # as it is, its wheels are 0.5 % smaller than stated
    assert (radii.number("left"), radii.number("right")) == pytest.approx((0.078, -0.054), abs=0.008)


@pytest.mark.recordings
@pytest.mark.skipif(not SHARED.exists(), reason="the shared recordings are not there")
def test_a_slip_beside_a_gyros_scale_is_not_hidden_in_the_noise_of_a_real_drive() -> None:
    """Once the scale is off, half a minute of slip would be most of the long run of the wheels' noise."""
    whole = read_recording(SHARED / "warthog_asphalt_2024_9_25_12h8s57")
    fog, log = whole.fog, whole.wheels
    assert fog is not None
    assert log is not None
    slips = (log.time_s >= 74.0) & (log.time_s < 104.0)
    left, right = (v * np.where(slips, 1.0 + k, 1.0) for v, k in ((log.left_rad_s, 0.195), (log.right_rad_s, 0.063)))
    planted = replace(
        whole,
        fog=replace(fog, rate_rad_s=0.97 * fog.rate_rad_s),
        wheels=replace(log, left_rad_s=left, right_rad_s=right),
    )
    found = {c.effect: c.selected for c in analyse(planted).conclusion.causes if c.status is Status.CONFIRMED}
    scale, slip = found["gyro_scale_error"], found["surface_slip"]
    assert scale is not None
    assert slip is not None
    assert scale.number("k") == pytest.approx(-0.03, abs=0.003)
    assert slip.interval_s == pytest.approx((74.0, 104.0), abs=2.5)  # its own deviation is 1.5 s
    assert slip.number("left") == pytest.approx(0.195, abs=0.05)


@pytest.mark.recordings
@pytest.mark.skipif(not SHARED.exists(), reason="the shared recordings are not there")
def test_a_jump_in_a_real_drive_is_found_at_its_moment() -> None:
    """The moments 103.2, 106.0 and 108.4 s are each likelier than those beside it."""
    whole = read_recording(SHARED / "warthog_grass_2024_8_8_15h56s39")
    fog, wheels, reference = (between(log, 0.0, 196.7) for log in (whole.fog, whole.wheels, whole.reference))
    jumped = replace(fog, rate_rad_s=fog.rate_rad_s - np.radians(0.919) * (fog.time_s >= 106.0))
    found = analyse(replace(whole, fog=jumped, wheels=wheels, reference=reference)).conclusion.causes
    (jump,) = (c.selected for c in found if c.effect == "gyro_bias_step")
    assert jump is not None
    assert jump.sigma("t0") < 0.3
    assert jump.number("t0") == pytest.approx(106.0, abs=0.5)
    assert np.degrees(jump.number("b")) == pytest.approx(-0.919, abs=0.1)


def test_a_counter_that_stops_in_a_circle_is_no_other_tread() -> None:
    """Radii and tread are one there without a gyro: the calibration of all of it makes a tread of -1.5 to 2.5."""
    circle = Route().stand(1.0).curve(6.3, np.ones(630), 0.12).stand(1.0)
    dropout = selected("encoder_dropout", side="right", t0=12.0, t1=13.5)
    truth = make_truth(Drive(circle.steps(), 0))
    for seed in range(3):
        made = simulate(truth, DEFAULT, [(dropout.effect, dropout.values)], Conditions(), seed=seed)
        (event,) = observe(replace(made.recording, fog=None))[1].events
        assert event.selected.id == "encoder_dropout"
        assert event.windows[0] == pytest.approx((12.0, 13.5), abs=0.1)


@pytest.mark.parametrize("has_gyro", [True, False])
def test_a_counter_that_stops_while_its_wheel_goes_back_and_ahead_again_is_found(has_gyro: bool) -> None:
    curvature = np.zeros(400)
    curvature[180:220] = -8.0  # a sharp turn to the right, in which the right wheel goes back
    truth = make_truth(Drive(Route().stand(10.0).curve(4.0, curvature, 0.12).stand(1.0).steps(), 0))
    clean = simulate(truth, DEFAULT, [], Conditions(), seed=0).recording
    time_s, (_, right) = clean.encoders.time_s, clean.wheel_angles_rad()
    back = np.flatnonzero(np.diff(right) < 0.0)
    again = back[-1] + int(np.argmax(right[back[-1] :] >= right[back[0]]))
    dropout = selected("encoder_dropout", side="right", t0=float(time_s[back[0]]), t1=float(time_s[again]))
    made = simulate(truth, DEFAULT, [(dropout.effect, dropout.values)], Conditions(), seed=0).recording
    (event,) = observe(made if has_gyro else replace(made, fog=None))[1].events
    assert event.selected.id == "encoder_dropout"


@pytest.mark.parametrize("has_gyro", [True, False])
def test_a_counter_that_stops_while_a_fast_robot_creeps_is_found(has_gyro: bool) -> None:
    route = Route().stand(10.0).straight(12.0, 1.0).stand(1.0).straight(0.8, 0.08).stand(1.0)
    truth = make_truth(Drive(route.steps(), 0))
    end_s = float(simulate(truth, DEFAULT, [], Conditions(), seed=0).recording.encoders.time_s[-1])
    dropout = selected("encoder_dropout", side="left", t0=end_s - 8.0, t1=end_s - 3.0)
    made = simulate(truth, DEFAULT, [(dropout.effect, dropout.values)], Conditions(), seed=0).recording
    (event,) = observe(made if has_gyro else replace(made, fog=None))[1].events
    assert event.selected.id == "encoder_dropout"
    assert event.windows[0] == pytest.approx((end_s - 8.0, end_s - 3.0), abs=0.1)


@pytest.mark.skipif(not SHARED.exists(), reason="the shared recordings are not there")
@pytest.mark.parametrize(
    ("name", "window_s", "share"),
    [("ivanjko_250620201655_run-01", (11.1, 17.71), 0.173), ("circular_250620202236_run-03", (46.3, 66.65), 0.195)],
)
def test_a_real_counter_that_starts_late_has_not_stopped_where_slip_makes_another_tread(
    name: str, window_s: tuple[float, float], share: float
) -> None:
    """With the left wheel slipping for a while the calibration has treads of 2.3 +- 0.7 and 3.2 +- 2.2."""
    recording = read_recording(SHARED / f"optiodom_{name}")
    log = recording.encoders
    assert log.left_counts is not None
    slips = (log.time_s >= window_s[0]) & (log.time_s < window_s[1])
    counts = np.round(np.cumsum(np.diff(log.left_counts, prepend=0.0) * (1.0 + share * slips)))
    assert observe(replace(recording, wheels=replace(log, left_counts=counts)))[1].events == []


@pytest.mark.recordings
@pytest.mark.skipif(not SHARED.exists(), reason="the shared recordings are not there")
def test_a_real_tread_is_found_where_its_turns_are_so_rough_that_they_say_little() -> None:
    """Four turns on the spot show -8.5 % by 8.8 nats: 4 sigmas of what the calibrator measures in any drive."""
    narrow = selected("tread_error", k=-0.0854)
    recording = read_recording(SHARED / "optiodom_square_231220200029_run-01")
    causes = analyse(planted(recording, narrow.effect, narrow.values)).conclusion.causes
    found = {c.effect: c.selected for c in causes if c.status is not Status.SUSPECTED}
    assert found.keys() == {"tread_error"}
    tread = found["tread_error"]
    assert tread is not None
    assert tread.number("k") == pytest.approx(-0.0854, abs=0.02)


@pytest.mark.recordings
@pytest.mark.skipif(not SHARED.exists(), reason="the shared recordings are not there")
def test_a_real_counter_that_stops_in_a_drive_of_30_cm_makes_no_other_robot() -> None:
    """A calibration with it has wheels of 0.9 and 40 % of their size, by which the counter may well have stood."""
    recording = read_recording(SHARED / "optiodom_ivanjko_250620201738_run-12")
    log = recording.encoders
    assert log.right_counts is not None
    stopped = (log.time_s >= 8.2) & (log.time_s < 10.24)
    counts = np.cumsum(np.diff(log.right_counts, prepend=0.0) * ~stopped)
    measured, audited = observe(replace(recording, wheels=replace(log, right_counts=counts)))
    for value, sigma in zip(measured.robot[:3], measured.sigma[:3], strict=True):
        assert abs(value - 1.0) < 1.5 * sigma
    (event,) = audited.events
    assert event.selected.id == "encoder_dropout"
    assert event.windows[0] == pytest.approx((8.2, 10.24), abs=0.1)


def test_without_a_gyro_a_gap_of_the_reference_elsewhere_hides_no_stopped_counter() -> None:
    dropout = selected("encoder_dropout", side="right", t0=60.0, t1=62.0)
    made = replace(recorded(WAREHOUSE, 3, dropout), fog=None)
    assert made.reference is not None
    kept = np.abs(made.reference.time_s - 100.0) > 1.0
    r = made.reference
    gap = replace(r, time_s=r.time_s[kept], x_m=r.x_m[kept], y_m=r.y_m[kept], heading_rad=r.heading_rad[kept])
    for reference in (r, gap):
        (event,) = observe(replace(made, reference=reference))[1].events
        assert event.windows[0] == pytest.approx((60.0, 62.0), abs=0.1)
