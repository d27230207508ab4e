"""Noise of real ground: tails, colour, and speeds that a drive holds are seen, and only where they are. (77), (78)"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnosis_drives import recorded, selected

from drd.arrays import Array
from drd_tools.diagnose.analysis import analyse
from drd_tools.diagnose.observe.constants import observe
from drd_tools.diagnose.observe.evidence import gather
from drd_tools.diagnose.observe.parts import between
from drd_tools.diagnose.regression.noise_fit import by_direction, fitted, ratios
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.regression.refine import refine
from drd_tools.diagnose.regression.residuals import long_run, tails
from drd_tools.diagnose.select.start import started
from drd_tools.recordings.folder import Recording, read_recording
from drd_tools.trial.overlay import planted

SHARED = Path(__file__).parents[4] / "shared" / "recordings"
ROWS = 4000
HELD_S = 0.4
FAR = (selected("tread_error", k=0.65), selected("encoder_latency", delay=0.17))


@pytest.mark.parametrize("seed", range(5))
def test_gaussian_rows_are_left_as_they_are(seed: int) -> None:
    rows = np.random.default_rng(seed).normal(0.0, 0.7, ROWS)
    assert np.array_equal(tails(rows, np.ones(ROWS, bool)), 1.0)


@pytest.mark.parametrize("seed", range(5))
def test_rows_of_students_t_get_the_weight_that_their_likelihood_gives_them(seed: int) -> None:
    """Weighted least squares then finds the middle of rows better than their mean does."""
    random = np.random.default_rng(seed)
    rows, moving = random.standard_t(3.0, ROWS), np.arange(ROWS) % 10 > 0
    found = np.asarray(tails(rows, moving))
    assert np.all(found[~moving] == 1.0)
    assert found[moving] == pytest.approx(np.sqrt(1.0 + rows[moving] ** 2 / 3.0), rel=0.15)


def test_the_middle_of_rows_with_heavy_tails_is_found_better() -> None:
    errors = []
    for seed in range(100):
        rows = np.random.default_rng(seed).standard_t(2.5, 400)
        weights = np.broadcast_to(tails(rows, np.ones(400, bool)), rows.shape) ** -2.0
        errors.append((rows.mean(), np.average(rows, weights=weights)))
    mean, weighted = np.sqrt(np.mean(np.square(errors), axis=0))
    assert weighted < 0.8 * mean


@pytest.mark.parametrize("row", [0.0, 3.0, 1e-200])
def test_rows_that_are_all_the_same_have_the_deviation_that_is_stated(row: float) -> None:
    assert long_run(np.full(500, row), 0.1) == 1.0


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_the_long_run_deviation_of_rows_is_the_root_of_their_spectrum_at_zero(share: float) -> None:
    found, phi = [], float(np.exp(-0.1))  # rows of 0.1 s that hang together for 1 s
    for seed in range(20):
        random = np.random.default_rng(seed)
        slow, shocks = np.zeros(ROWS), random.normal(size=ROWS)
        for i in range(1, ROWS):
            slow[i] = phi * slow[i - 1] + np.sqrt(1.0 - phi**2) * shocks[i]
        rows = np.sqrt(1.0 - share) * random.normal(size=ROWS) + np.sqrt(share) * slow
        found.append(long_run(rows, 0.1))
    true = np.sqrt(1.0 - share + share * (1.0 + phi) / (1.0 - phi))
    assert np.mean(found) == pytest.approx(true, rel=0.1)
    assert np.std(found) < 0.15 * true


def held(recording: Recording) -> Recording:
    """The recording of a drive that tells each wheel's speed only every HELD_S, and meanwhile the last one."""
    wheels = recording.wheels
    assert wheels is not None
    assert wheels.left_counts is not None
    assert wheels.right_counts is not None
    t = wheels.time_s
    edges = np.arange(t[0], t[-1] + HELD_S, HELD_S)

    def told(counts: Array) -> Array:
        speed = np.gradient(np.interp(edges, t, counts), edges)
        way = np.concatenate([[0.0], np.cumsum(speed[:-1] * HELD_S)])
        return np.asarray(np.interp(t, edges, counts[0] + way), float)

    left, right = told(wheels.left_counts), told(wheels.right_counts)
    return replace(recording, wheels=replace(wheels, left_counts=left, right_counts=right))


@pytest.mark.parametrize("is_held", [False, True])
def test_speeds_that_a_drive_holds_are_jitter_of_a_far_robots_wheels_and_no_effect(is_held: bool) -> None:
    recording = recorded(("field", 200.0), 3, *FAR)
    made = analyse(held(recording) if is_held else recording)
    problem = made.conclusion.found.problem
    assert {c.effect for c in made.conclusion.causes} == {c.id for c in FAR}
    if is_held:
        assert 0.1 * HELD_S < problem.noise.jitter_s < HELD_S
        assert any("holds its speeds" in one.sentence for one in made.scatter()[0])
    else:
        assert problem.noise.jitter_s == 0.0
        assert (ratios(problem)["slip"] or 0.0) < 1.5


@pytest.mark.skipif(not SHARED.is_dir(), reason="the shared recordings are not here")
def test_noise_does_not_take_the_place_of_slip_where_no_gyro_tells_it() -> None:
    """Before any effect is found all of it is noise, three times as much as stated, beside which nothing is found."""
    recording = read_recording(SHARED / "optiodom_ivanjko_250620201655_run-09")
    slip = selected("surface_slip", left=0.17, right=0.09, t0=5.8, t1=8.1)
    found = analyse(planted(recording, slip.effect, slip.values)).conclusion
    (cause,) = found.causes
    assert cause.effect == "surface_slip"
    assert cause.selected is not None
    assert cause.selected.number("left") == pytest.approx(0.17, abs=3.0 * cause.selected.sigma("left"))
    assert (ratios(found.found.problem)["slip"] or 0.0) < 2.0


@pytest.mark.skipif(not SHARED.is_dir(), reason="the shared recordings are not here")
@pytest.mark.parametrize(("t0", "left", "right"), [(67.1, 0.095, 0.085), (75.95, 0.195, 0.051)])
def test_slip_of_half_a_minute_does_not_stay_in_the_long_run_variance(t0: float, left: float, right: float) -> None:
    recording = read_recording(SHARED / "warthog_asphalt_2024_9_25_12h8s57")
    slip = selected("surface_slip", t0=t0, t1=t0 + 30.0, left=left, right=right)
    found = analyse(planted(recording, slip.effect, slip.values)).conclusion
    (one,) = (c for c in found.found.fit.selection if c.id == "surface_slip")
    assert one.number("t0") == pytest.approx(t0, abs=2.0)
    assert one.number("left") == pytest.approx(left, abs=3.0 * one.sigma("left"))


@pytest.mark.parametrize(("share", "ahead"), [(0.25, True), (0.65, True), (0.75, False), (1.0, False)])
def test_a_reference_that_scatters_by_less_than_it_states_is_off_by_the_rest(share: float, ahead: bool) -> None:
    """Where 10 mm are stated and the fixes scatter by 2.5 mm, a lever arm of some 9.7 mm is nobody's physics."""
    recording = recorded(("slalom", 120.0), 1)
    stated_m = gather(recording).datasheet.position_m / share
    problem = Problem(
        gather(replace(recording, nominal=replace(recording.nominal, reference_position_sigma_m=stated_m)))
    )
    noise, _ = fitted(problem, refine(problem, ()), searched=True)
    found = {name: sigma for name, sigma, _ in Problem(problem.evidence, noise=noise).nuisances}
    assert found.get("reference_ahead") == (
        pytest.approx(stated_m * (1.0 - share**2) ** 0.5, rel=0.1) if ahead else None
    )


@pytest.mark.skipif(not SHARED.is_dir(), reason="the shared recordings are not here")
def test_a_lever_arm_does_what_a_centre_of_turning_elsewhere_does() -> None:
    """Where fixes scatter by 0.2 mm, what they do to the heading that turns it would be 5 % of another cause."""
    measured, audited = observe(read_recording(SHARED / "warthog_asphalt_2024_9_25_12h8s57"))
    start = started(audited, measured)
    problem = start.problem.around(start.held)
    problem = problem.with_noise(replace(problem.noise, position_m=2e-4), None, problem.inflation)
    rows = problem.effect_rows([selected("rotation_centre_offset", a=0.3)])
    left = rows - problem.nuisance @ np.linalg.lstsq(problem.nuisance, rows, rcond=None)[0]
    assert np.linalg.norm(left) < 0.01 * np.linalg.norm(rows)


@pytest.mark.parametrize(("period_s", "size_rad_s", "is_noise"), [(285.0, 3.5e-5, False), (6.0, 2e-4, True)])
def test_what_a_gyro_does_over_minutes_is_no_noise_of_it(period_s: float, size_rad_s: float, is_noise: bool) -> None:
    """Over seconds it is: there no effect of the catalogue could be told from it."""
    recording = recorded(("stand", 600.0), 1)
    assert recording.fog is not None
    swing = size_rad_s * np.sin(2.0 * np.pi * recording.fog.time_s / period_s)
    fog = replace(recording.fog, rate_rad_s=recording.fog.rate_rad_s + swing)
    problem = Problem(gather(replace(recording, fog=fog)))
    noise, _ = fitted(problem, refine(problem, ()), searched=True)
    assert (noise.walk_rad_per_sqrt_s > problem.evidence.datasheet.walk_rad_per_sqrt_s) == is_noise


@pytest.mark.skipif(not SHARED.is_dir(), reason="the shared recordings are not here")
@pytest.mark.parametrize(
    ("name", "faults"), [("square_231220200029_run-05", {"drift", "delay"}), ("square_230620202258_run-05", set())]
)
def test_what_a_motion_capture_may_be_off_by_itself_is_no_finding(name: str, faults: set[str]) -> None:
    """Its marker is a millimetre off the axle, its stated deviation; in some runs its lag falls by 0.1 s."""
    recording = read_recording(SHARED / f"optiodom_{name}")
    analysis = analyse(recording)
    assert analysis.conclusion.causes == []
    assert set(analysis.reference) == {"ahead", "heading", *faults}
    assert 0.0005 < abs(analysis.reference["ahead"].value) < 0.002
    if faults:
        changes_s = 1e-6 * analysis.reference["drift"].value * float(np.ptp(recording.encoders.time_s))
        assert 0.03 < changes_s < 0.15
        assert 0.01 < analysis.reference["delay"].value < 0.06
        assert all(amount.std < 0.3 * abs(amount.value) for amount in analysis.reference.values())


@pytest.mark.skipif(not SHARED.is_dir(), reason="the shared recordings are not here")
@pytest.mark.parametrize("name", ["square_231220200029_run-05", "square_230620202042_run-01"])
def test_a_delay_of_wheels_without_a_gyro_is_found_alone_and_with_its_size(name: str) -> None:
    """The robot turns on the spot within 0.1 s. Its lag of before falls from 0.07 to -0.02 s in the run."""
    late = selected("encoder_latency", delay=0.15)
    analysis = analyse(planted(read_recording(SHARED / f"optiodom_{name}"), late.effect, late.values))
    (cause,) = analysis.conclusion.causes
    assert cause.selected is not None
    assert cause.selected.number("delay") == pytest.approx(0.15 + 0.03, abs=0.04)


@pytest.mark.skipif(not SHARED.is_dir(), reason="the shared recordings are not here")
@pytest.mark.parametrize("name", ["square_231220200040_run-03", "square_231220200029_run-05"])
def test_tread_and_radius_that_are_both_off_are_both_found_without_a_gyro(name: str) -> None:
    """Each turn on the spot spikes the speeds, in both directions: variance for that would hide the tread."""
    made = read_recording(SHARED / f"optiodom_{name}")
    nominal = made.nominal
    wrong = replace(nominal, tread_m=1.1 * nominal.tread_m, wheel_radius_m=0.97 * nominal.wheel_radius_m)
    found = {c.effect: c.selected for c in analyse(replace(made, nominal=wrong)).conclusion.causes}
    assert found.keys() == {"tread_error", "wheel_radius_error"}
    assert found["tread_error"] is not None
    assert found["tread_error"].number("k") == pytest.approx(1.0 / 1.1 - 1.0, abs=0.012)


@pytest.mark.skipif(not SHARED.is_dir(), reason="the shared recordings are not here")
@pytest.mark.parametrize("begin_s", [40.0, 50.0])
def test_a_gyros_constant_bias_does_not_explain_slow_errors(begin_s: float) -> None:
    """Cut from a longer drive, this one hardly stands at first; its reference's lag varies."""
    made = read_recording(SHARED / "warthog_asphalt_2024_9_25_12h8s57")
    logs = (between(log, begin_s, 130.0) for log in (made.fog, made.wheels, made.reference))
    fog, wheels, reference = (replace(log, time_s=log.time_s - begin_s) for log in logs)
    names = {c.effect for c in analyse(replace(made, fog=fog, wheels=wheels, reference=reference)).conclusion.causes}
    assert {"tread_error", "encoder_latency"} <= names
    assert not {name for name in names if name.startswith("gyro_")}


def test_noise_sideways_is_not_taken_for_noise_of_turns_where_all_is_to_be_told() -> None:
    """Without a gyro one factor for all directions is that of the loudest: three times the slip of turns, too."""
    e = gather(replace(recorded(("warehouse", 130.0), 2), fog=None))
    p, random = Problem(e), np.random.default_rng(2)
    heading = p.path.middle_rad
    aside_m = 20.0 * e.datasheet.lateral_m_per_sqrt_m * np.sqrt(e.travel_m / 2.0) * random.standard_normal(len(heading))
    drifted = np.cumsum(np.column_stack([-np.sin(heading), np.cos(heading)]) * aside_m[:, None], axis=0)
    fix = e.fix.copy()
    fix[:, :2] += drifted[e.fix_step]
    p = Problem(replace(e, fix=fix))
    fit = refine(p, [])
    alike, apart = fitted(p, fit, searched=True)[0], by_direction(p, fit).noise
    assert alike.slip_m_per_sqrt_m > 1.5 * e.datasheet.slip_m_per_sqrt_m
    assert apart.slip_m_per_sqrt_m < 1.2 * e.datasheet.slip_m_per_sqrt_m
    assert apart.lateral_m_per_sqrt_m > 2.0 * e.datasheet.lateral_m_per_sqrt_m


@pytest.mark.skipif(not SHARED.is_dir(), reason="the shared recordings are not here")
def test_without_a_gyro_clocks_drift_by_their_timing_not_by_a_scale_of_the_travel() -> None:
    """The wheels are 0.3 % smaller than stated; by itself the lag grows by 0.8 ms/s in this run."""
    late = selected("encoder_latency", delay=0.227)
    recording = read_recording(SHARED / "optiodom_square_230620202317_run-07")
    drift = analyse(planted(recording, late.effect, late.values)).reference["drift"]
    assert drift.value == pytest.approx(826.0, abs=3.0 * drift.std)
    assert drift.std < 250.0


@pytest.mark.skipif(not SHARED.is_dir(), reason="the shared recordings are not here")
def test_without_a_gyro_a_clock_is_named_beyond_what_references_drift_by_themselves() -> None:
    """The lag of this robot's reference grows by 0.05 to 0.11 s in each run; with the planted clock by 0.25 s."""
    slow = selected("encoder_clock_skew", ppm=2e-3)
    recording = read_recording(SHARED / "optiodom_square_230620202144_run-03")
    analysis = analyse(planted(recording, slow.effect, slow.values))
    (cause,) = analysis.conclusion.causes
    assert cause.effect == slow.id
    assert cause.selected is not None
    assert cause.selected.number("ppm") == pytest.approx(2e-3 + 0.76e-3, abs=3e-4)
    assert 0.75 < cause.probabilities[slow.id] < 0.95
    assert "may also be the reference's own" in cause.sentence
    assert "drift" not in analysis.reference  # said once


def test_the_ratio_of_the_wheels_noise_is_that_of_rows_whose_sensors_were_read() -> None:
    """Beside rows of any size, the jitter of the others would not show."""
    e = gather(recorded(("field", 120.0), 1, *FAR))
    noisy = replace(e.datasheet, jitter_s=0.1)
    lost = np.where((e.time_s > 60.0) & (e.time_s < 65.0), 1.0, 0.0)
    whole, gap = (ratios(Problem(own, noise=noisy))["slip"] for own in (e, replace(e, gyro_inflation_rad2=lost)))
    assert whole is not None
    assert whole > 1.5
    assert gap == pytest.approx(whole, rel=0.1)
