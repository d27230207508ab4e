"""A robot far from its robot.yaml whose reference is sparse, knows the ends only, or is absent."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnosis_drives import FAR, LEFT, REFERENCE_S, RIGHT, TREAD, WAREHOUSE, WHEELS_S, recorded, selected

from drd.arrays import Array
from drd.config.schema import ConfigError
from drd_tools.calibrate.wheels.lag import reference_lag
from drd_tools.diagnose.analysis import Analysis, analyse
from drd_tools.diagnose.conclude.outcome import verdict
from drd_tools.diagnose.observe.constants import constants, observe
from drd_tools.diagnose.observe.evidence import gather
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.results import Status, Verdict
from drd_tools.diagnose.select.start import started
from drd_tools.recordings.folder import Recording, read_recording

NAMES = {c.id for c in FAR}
OVER_RADIUS = 1.0 - 0.5 * (LEFT + RIGHT)  # nominal over true, mean of both wheels
SHARED = Path(__file__).parents[4] / "shared" / "recordings"


def every(recording: Recording, seconds: float, late_s: float = 0.0) -> Recording:
    """The recording with a fix every so many seconds, late; of inf with the ends only, of 0 without a reference."""
    reference = recording.reference
    assert reference is not None
    if seconds == 0.0:
        return replace(recording, reference=None)
    times_s = reference.time_s
    at: Array = np.array([0, len(times_s) - 1])
    if np.isfinite(seconds):
        at = np.unique(np.searchsorted(times_s, np.arange(times_s[0], times_s[-1], seconds)))
    kept = {name: getattr(reference, name)[at] for name in ("x_m", "y_m", "heading_rad")}
    return replace(recording, reference=replace(reference, time_s=times_s[at] + late_s, **kept))


def far(seconds: float) -> Analysis:
    return analyse(every(recorded(("field", 200.0), 1, *FAR), seconds, REFERENCE_S))


@pytest.mark.parametrize("seconds", [0.0, np.inf, 20.0, 2.0], ids=["none", "ends", "20 s", "2 s"])
def test_constants_far_off_are_named_and_nothing_else_is(seconds: float) -> None:
    """A gyro tells the tread over the mean radius, the radii's difference and the wheels' lag."""
    causes = {c.effect: c.selected for c in far(seconds).conclusion.causes}
    assert causes.keys() == NAMES
    tread, delay, radii = (causes[name] for name in ("tread_error", "encoder_latency", "wheel_radius_error"))
    assert tread is not None
    assert delay is not None
    assert radii is not None
    assert delay.number("delay") == pytest.approx(WHEELS_S, abs=0.01)
    assert radii.number("right") - radii.number("left") == pytest.approx(RIGHT - LEFT, abs=0.003)
    mean = 1.0 - 0.5 * (radii.number("left") + radii.number("right"))
    assert (1.0 + tread.number("k")) * mean == pytest.approx((1.0 + TREAD) * OVER_RADIUS, rel=0.01)
    assert tread.number("k") == pytest.approx(TREAD, abs=3.0 * tread.sigma("k"))
    if seconds == 0.0:  # nothing tells how large the wheels are
        assert tread.sigma("k") > 0.05


def test_a_sparse_references_lag_is_measured_between_its_fixes_and_tells_no_clock() -> None:
    found = constants(every(recorded(("field", 200.0), 1, *FAR), 2.0, REFERENCE_S))
    assert found.lag_s == pytest.approx(REFERENCE_S, abs=0.02)
    assert found.robot.gyro_clock == 1.0
    few = constants(every(recorded(("field", 200.0), 1, *FAR), 20.0, REFERENCE_S))
    assert (few.lag_s, few.has_lag) == (0.0, False)


@pytest.mark.parametrize(("seconds", "is_known"), [(2.0, True), (20.0, False)])
def test_a_lag_that_nothing_tells_may_be_that_of_real_references(seconds: float, is_known: bool) -> None:
    measured, audited = observe(every(recorded(("field", 200.0), 1, *FAR), seconds, REFERENCE_S))
    prior = {name: sigma for name, sigma, _ in started(audited, measured).problem.nuisances}
    assert (prior["reference_latency"] < 0.2 * REFERENCE_S) == is_known
    assert is_known or prior["reference_latency"] > REFERENCE_S


@pytest.mark.parametrize("seconds", [5.0, 20.0])
def test_without_a_gyro_a_few_fixes_tell_the_constants(seconds: float) -> None:
    recording = replace(every(recorded(WAREHOUSE, 5, *FAR), seconds), fog=None)
    causes = {c.effect: c.selected for c in analyse(recording).conclusion.causes}
    assert causes.keys() == {"tread_error", "wheel_radius_error"}  # whose delay it is nothing tells
    tread = causes["tread_error"]
    assert tread is not None
    assert tread.number("k") == pytest.approx(TREAD, abs=3.0 * tread.sigma("k"))


@pytest.mark.parametrize("seconds", [5.0, 10.0])
@pytest.mark.parametrize("side", ["left", "right"])
def test_a_counter_that_stops_between_sparse_fixes_is_found_without_a_gyro(side: str, seconds: float) -> None:
    """The turns before and after it are the wheels', what they leave of the whole is that of the rest."""
    dropout = selected("encoder_dropout", side=side, t0=61.0, t1=63.0)
    made = replace(every(recorded(WAREHOUSE, 3, dropout), seconds), fog=None)
    (event,) = observe(made)[1].events
    assert event.windows[0] == pytest.approx((61.0, 63.0), abs=0.1)
    (cause,) = analyse(made).conclusion.causes
    assert cause.effect == "encoder_dropout"


def test_of_two_rests_between_the_same_fixes_the_surer_is_told() -> None:
    """One difference of headings is all that tells of both: of a counter that stops, and is read late."""
    dropout = selected("encoder_dropout", side="right", t0=61.0, t1=63.0)
    made = replace(every(recorded(WAREHOUSE, 3, dropout), 10.0), fog=None)
    log, reference = made.encoders, made.reference
    assert log.right_counts is not None
    assert reference is not None
    late_s = 64.0
    assert np.searchsorted(reference.time_s, 62.0) == np.searchsorted(reference.time_s, late_s + 0.5)
    held = (log.time_s > late_s) & (log.time_s <= late_s + 0.5)
    counts = np.where(held, np.interp(late_s, log.time_s, log.right_counts).round(), log.right_counts)
    (event,) = observe(replace(made, wheels=replace(log, right_counts=counts)))[1].events
    assert event.windows[0] == pytest.approx((61.0, 63.0), abs=0.1)


@pytest.mark.parametrize("has_gyro", [True, False])
def test_a_reference_without_rows_is_as_none_or_refused(has_gyro: bool) -> None:
    recording = recorded(WAREHOUSE, 3)
    assert recording.reference is not None
    none = np.zeros(0)
    empty = replace(
        recording, reference=replace(recording.reference, time_s=none, x_m=none, y_m=none, heading_rad=none)
    )
    if has_gyro:
        assert analyse(empty).conclusion.causes == []
        return
    with pytest.raises(ConfigError):
        analyse(replace(empty, fog=None))


def test_a_fix_after_the_last_whole_step_counts() -> None:
    """Without a gyro, start and end: else nothing is compared, and nothing missing."""
    recording = replace(every(recorded(WAREHOUSE, 5, *FAR), np.inf), fog=None)
    times_s, reference = recording.encoders.time_s, recording.reference
    assert reference is not None
    at_s = np.array([times_s[0] + 0.03, times_s[-1]])
    e = gather(replace(recording, reference=replace(reference, time_s=at_s)))
    assert e.fix_time_s == pytest.approx(at_s)
    assert e.fix_share[-1] < 0.0
    path = Problem(e).path
    assert path.pose[-1] + (path.pose[-1] - path.pose[-2]) * -e.fix_share[-1] == pytest.approx(e.fix[-1], abs=0.05)


@pytest.mark.parametrize(("seconds", "status"), [(np.inf, Status.SUPPORTED), (20.0, Status.CONFIRMED)])
def test_what_one_fix_tells_another_of_its_numbers_does_not_bear_out(seconds: float, status: Status) -> None:
    recording = every(recorded(WAREHOUSE, 3, selected("tread_error", k=0.1)), seconds)
    (cause,) = analyse(replace(recording, fog=None)).conclusion.causes
    assert cause.effect == "tread_error"
    assert cause.status is status


def test_a_late_reference_is_put_right_where_there_are_no_wheels() -> None:
    recording = every(replace(recorded(WAREHOUSE, 1), wheels=None), 0.1, REFERENCE_S)
    analysis = analyse(recording)
    assert analysis.conclusion.causes == []
    assert analysis.reference["lag"].value == pytest.approx(REFERENCE_S, abs=0.02)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_gyro_that_scatters_is_told_as_such_where_there_are_no_wheels(seed: int) -> None:
    """An angle random walk ten times as large passes for no bias."""
    recording = every(recorded(WAREHOUSE, seed), 0.1, REFERENCE_S)
    assert recording.fog is not None
    walk_rad = 10.0 * gather(recording).datasheet.walk_rad_per_sqrt_s
    times_s = recording.fog.time_s
    more = np.random.default_rng(seed).normal(0.0, walk_rad / np.median(np.diff(times_s)) ** 0.5, len(times_s))
    fog = replace(recording.fog, rate_rad_s=recording.fog.rate_rad_s + more)
    analysis = analyse(replace(recording, wheels=None, fog=fog))
    assert analysis.conclusion.causes == []
    assert verdict(analysis.conclusion) is Verdict.PARTLY
    (told,), _ = analysis.scatter()
    assert told.channel == "gyro"
    assert 4.0 < told.ratio < 20.0  # tried in steps of a factor of 1.8
    assert told.sentence.startswith("the gyro noise is ")


def test_the_lag_between_fixes_is_as_sure_as_it_says() -> None:
    z = []
    for seed in range(10):
        lag = reference_lag(every(recorded(WAREHOUSE, seed), 1.0, REFERENCE_S))
        assert lag is not None
        assert lag.determined
        z.append((lag.lag_s - REFERENCE_S) / lag.sigma_s)
    assert 0.3 < np.sqrt(np.mean(np.square(z))) < 2.0


@pytest.mark.recordings
@pytest.mark.skipif(not SHARED.is_dir(), reason="the shared recordings are not here")
@pytest.mark.parametrize("seconds", [0.0, np.inf], ids=["none", "ends"])
@pytest.mark.parametrize("name", ["asphalt_2024_9_25_12h8s57", "grass_2024_7_29_14h8s51"])
def test_a_real_skid_steer_robots_constants_are_named_without_a_reference(name: str, seconds: float) -> None:
    analysis = analyse(every(read_recording(SHARED / f"warthog_{name}"), seconds))
    assert {c.effect for c in analysis.conclusion.causes} == NAMES


@pytest.mark.recordings
@pytest.mark.skipif(not SHARED.is_dir(), reason="the shared recordings are not here")
def test_wheels_of_half_their_size_do_not_stand_for_a_tread() -> None:
    """Without a reference either explains a real drive's turns; only along the way to it the two are unlike."""
    recording = read_recording(SHARED / "warthog_grass_2024_7_29_14h8s51")
    log = recording.encoders
    assert log.left_rad_s is not None
    assert log.right_rad_s is not None
    mean, half = 0.5 * (log.right_rad_s + log.left_rad_s), 0.5 * (log.right_rad_s - log.left_rad_s) * (1.0 - 0.1412)
    narrower = replace(recording, wheels=replace(log, left_rad_s=mean - half, right_rad_s=mean + half), reference=None)
    causes = {c.effect: c.selected for c in analyse(narrower).conclusion.causes}
    assert causes.keys() == NAMES
    radii = causes["wheel_radius_error"]
    assert radii is not None
    assert abs(radii.number("left")) < 0.1


@pytest.mark.recordings
@pytest.mark.skipif(not SHARED.is_dir(), reason="the shared recordings are not here")
@pytest.mark.parametrize("seconds", [np.inf, 30.0], ids=["ends", "30 s"])
def test_few_fixes_of_a_real_robot_are_expected_as_far_off_as_its_wheels_slip(seconds: float) -> None:
    """Wheels that slip against each other by 0.02 m/sqrt(m), as datasheets do not have it, slip together, too."""
    found = analyse(every(read_recording(SHARED / "warthog_grass_2024_8_8_15h56s39"), seconds)).conclusion.found
    assert 0.015 < found.problem.noise.forward_m_per_sqrt_m < 0.04
