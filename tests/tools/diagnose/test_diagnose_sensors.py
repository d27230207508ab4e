"""All combinations of sensors and references: an honest answer, or one clear error; of absent sensors nothing."""

import itertools
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from diagnosis_drives import recorded, selected, simulated
from diagnosis_runs import diagnosed, names, written

from drd.cli import main
from drd.effects.catalogue import catalogue
from drd.effects.effect import Errors
from drd_tools.diagnose.analysis import analyse
from drd_tools.diagnose.conclude.identify import not_observable
from drd_tools.diagnose.error_model.path import dead_reckon
from drd_tools.diagnose.error_model.sensitivities import Sensitivities
from drd_tools.diagnose.observe.evidence import gather
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.regression.refine import refine
from drd_tools.diagnose.results import Status
from drd_tools.diagnose.selected import Selected
from drd_tools.recordings.folder import Recording, read_recording
from drd_tools.simulate.conditions import Conditions, Reference

DRIVE = ("warehouse", 150.0)
SCALE = selected("gyro_scale_error", k=0.01)
REFERENCES = ("full", "sparse:60", "ends", "none")


def folder(path: Path, *selection: Any, gyro: bool, wheels: bool, reference: str, drive: Any = DRIVE) -> Path:
    written(path, *selection, reference=reference, drive=drive, seed=3)
    for name, there in (("fog.csv", gyro), ("encoders.csv", wheels)):
        if not there:
            (path / name).unlink()
    if not wheels:
        robot = yaml.safe_load((path / "robot.yaml").read_text())
        robot |= {"wheel": None, "tread_m": None, "encoders": None}
        (path / "robot.yaml").write_text(yaml.safe_dump(robot))
    return path


def without_wheels(recording: Recording) -> Recording:
    return replace(recording, wheels=None)


@pytest.mark.parametrize("share", [0.8, 0.95])
def test_readings_that_pile_up_are_a_limit_without_wheels_too(share: float) -> None:
    made = recorded(("slalom", 120.0), 3, conditions=Conditions(quantise=False))
    assert made.fog is not None
    limit = float(np.quantile(np.abs(made.fog.rate_rad_s), share))
    clipped = replace(made.fog, rate_rad_s=np.clip(made.fog.rate_rad_s, -limit, limit))
    (found,) = analyse(without_wheels(replace(made, fog=clipped))).conclusion.causes
    assert found.effect == "gyro_saturation"
    assert found.selected is not None
    assert found.selected.number("limit") == pytest.approx(limit, rel=1e-6)
    assert analyse(without_wheels(made)).conclusion.causes == []


@pytest.mark.parametrize("reference", REFERENCES)
@pytest.mark.parametrize(("gyro", "wheels"), list(itertools.product((True, False), repeat=2)))
@pytest.mark.parametrize("missing", [(), (SCALE,)])
def test_each_combination_is_answered_or_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], missing: Any, gyro: bool, wheels: bool, reference: str
) -> None:
    run = folder(tmp_path / "run", *missing, gyro=gyro, wheels=wheels, reference=reference)
    if gyro + wheels + (reference != "none") < 2 or not (gyro or wheels):
        assert main(["diagnose", str(run), "--output", str(tmp_path / "out")]) == 2
        assert capsys.readouterr().err.count("\n") == 1
        assert not (tmp_path / "out").exists()
        return
    result = analyse(read_recording(run)).conclusion
    named = [name for f in result.causes for name in (f.effect, *f.also_fits)]
    absent = ([] if gyro else ["gyro"]) + ([] if wheels else ["wheels", "body"])
    of_absent = {name for name, effect in catalogue().items() if effect.channel in absent}
    shown = {*named, *result.detectable}
    silent = {row.effect for row in not_observable(result.found.problem.evidence, shown)}
    assert not of_absent & shown
    assert not silent & shown
    assert of_absent <= silent
    assert ("gyro_scale_error" in named) == (bool(missing) and gyro)
    if reference == "ends" and not wheels:
        # A fix at the end alone cannot prove on one half what was fitted to the other.
        assert not any(f.status is Status.CONFIRMED for f in result.causes)
    assert bool(named) == (bool(missing) and gyro)


def test_a_gyro_alone_is_judged_by_its_heading_on_unseen_data_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run, other = (
        folder(tmp_path / n, SCALE, gyro=True, wheels=False, reference="full", drive=(DRIVE[0], s))
        for n, s in (("run", 150.0), ("other", 100.0))
    )
    found = diagnosed(run, tmp_path / "out", "--held-out", str(other))
    assert names(found)[0] == "gyro_scale_error"
    k = found["findings"][0]["parameters"]["k"]
    assert abs(k["value"] - 0.01) < 4.0 * k["std"] < 2e-3
    held = found["fit"]["held_out"]
    for before, after in (
        (found["fit"]["train"]["before"], found["fit"]["train"]["after"]),
        (held["before"]["other"], held["after"]["other"]),
    ):
        assert after["heading_rms_deg"] < 0.3 * before["heading_rms_deg"]
        assert "position_rms_m" not in before
    assert found["unexplained"]["end_error_m"] is None
    assert {row["effect"] for row in found["not_observable"]} >= {"tread_error", "lateral_slip_turning"}
    assert "not observable" in capsys.readouterr().out
    assert yaml.safe_load((tmp_path / "out/model.yaml").read_text()).keys() == {"effects", "provenance"}
    assert json.loads((tmp_path / "out/series.json").read_text())["noise"].keys() == {"heading", "gyro"}


@pytest.mark.parametrize(
    "late", [selected("gyro_lag", tau=0.12), selected("gyro_latency", delay=0.12)], ids=lambda c: c.id
)
def test_without_a_reference_nothing_is_lost_where_the_time_is_shifted_by_a_claim(late: Selected) -> None:
    """Turns that were dragged back into their old place would cost some 200 nats at the stops."""
    conditions = Conditions(reference=Reference.parse("none"))
    p = Problem(gather(recorded(("eights", 240.0), 7, late, conditions=conditions)))
    as_it_is, shifted = (-refine(q, [late]).cost for q in (p, p.around([late])))
    assert shifted > as_it_is - 5.0
    (name,) = late.values
    found = refine(p.around([late]), [replace(late, free=(name,))]).selection[0]
    assert abs(found.number(name) - 0.12) < 4.0 * found.sigma(name)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("reference", ["full", "sparse:20"])
def test_a_sound_gyro_alone_is_no_reason_to_find_something(seed: int, reference: str) -> None:
    late = Conditions(reference=replace(Reference.parse(reference), latency_s=0.005), tails=4.0)
    recording = without_wheels(recorded(("slalom", 120.0), seed, conditions=late))
    assert analyse(recording).conclusion.causes == []


def test_without_wheels_positions_say_nothing_and_headings_all() -> None:
    e = gather(without_wheels(recorded(DRIVE, 1)))
    problem = Problem(e)
    assert len(problem.data) == len(e.fix) + e.still.sum() == len(problem.row_time_s)
    sensitivities = Sensitivities.on(e, problem.path)
    assert np.abs(problem.whiten([sensitivities.of(Errors(lateral_m_s=np.ones(len(sensitivities.h))))])).max() < 1e-9
    turning = sensitivities.of(Errors(gyro_rad_s=0.01 * sensitivities.motion.rate_rad_s))
    assert np.linalg.norm(problem.whiten([turning])) > 10.0


@pytest.mark.parametrize(("reference", "known"), [("full", True), ("sparse:60", False)])
def test_the_speed_without_wheels_comes_from_a_dense_reference_only(reference: str, known: bool) -> None:
    run = simulated(DRIVE, 1, conditions=Conditions(reference=Reference.parse(reference)))
    e = gather(without_wheels(run.recording))
    speed = 0.5 * (e.left_m + e.right_m) / e.step_s
    true = np.interp(e.time_s - 0.5 * e.step_s, run.truth.middle_s, run.truth.speed_m_s)
    assert (np.abs(speed - true)[20:-20] < 0.25).all() == known
    assert known == bool(e.travel_m.any())


def test_the_believed_standstill_is_one_only_while_nothing_turns() -> None:
    recording = without_wheels(recorded(("slalom", 60.0), 1))
    e = gather(recording)
    assert 8.0 < e.time_s[e.still].max() <= 10.5
    long = replace(recording, nominal=replace(recording.nominal, standstill_at_start_s=40.0))
    turning = np.abs(gather(long).gyro_rad) > 0.1 * e.step_s  # type: ignore[arg-type]
    assert turning[: len(e.time_s) // 2].any()
    assert not (gather(long).still & turning).any()


def test_the_report_lists_what_the_recording_says_nothing_of(tmp_path: Path) -> None:
    run = folder(tmp_path / "run", gyro=True, wheels=False, reference="full")
    assert main(["diagnose", str(run), "--output", str(tmp_path / "out")]) == 0
    page = (tmp_path / "out/report.html").read_text()
    assert "not observable in this recording" in page
    assert "the recording has no wheel encoders" in page


def test_one_mark_that_a_gyro_misses_is_no_outlier() -> None:
    """A gyro on a bench, turned half around and back: it reads 173 degrees, and a single mark tells."""
    whole = without_wheels(recorded(("square-ccw", 120.0), 3))
    log, fog = whole.reference, whole.fog
    assert log is not None
    assert fog is not None
    time_s = 0.1 * np.arange(1.0, 600.0)
    rate = np.zeros(len(time_s))
    rate[100:150], rate[300:350] = np.radians(36.0), -np.radians(36.0)
    noise = np.random.default_rng(1).normal(0.0, np.radians(0.004), len(time_s))
    at_s = np.array([2.0, 5.0, 20.0, 25.0, 40.0, 45.0, 50.0])
    marks = replace(
        log,
        time_s=at_s,
        x_m=np.zeros(len(at_s)),
        y_m=np.zeros(len(at_s)),
        heading_rad=np.where((at_s > 15) & (at_s < 30), np.pi, 0.0),
    )
    bench = replace(whole, reference=marks)
    for factor, wrong in ((1.0, False), (173.0 / 180.0, True)):
        read = replace(fog, time_s=time_s, rate_rad_s=factor * rate + noise, temperature_c=np.full(len(time_s), 20.0))
        findings = analyse(replace(bench, fog=read)).conclusion.causes
        said = {name for f in findings for name in (f.effect, *f.also_fits)}
        assert ("gyro_scale_error" in said) == wrong
        assert bool(findings) == wrong


def test_clocks_that_nothing_tells_apart_are_a_class() -> None:
    """Without a reference a gyro that counts its samples too fast looks like encoders' clocks that run slow."""
    conditions = Conditions(reference=Reference.parse("none"))
    recording = recorded(("spins", 270.0), 4, selected("gyro_sample_clock", ratio=0.99985), conditions=conditions)
    (found,) = analyse(recording).conclusion.causes
    assert {"gyro_sample_clock", "encoder_clock_skew"} <= {found.effect, *found.also_fits}


def test_times_are_told_by_turns_as_sharp_as_they_are_and_sizes_by_turns_without_noise() -> None:
    """Turns that begin and end within a step; a size found along their noise would explain that noise by itself."""
    e = gather(replace(recorded(DRIVE, 1, conditions=Conditions(reference=Reference.parse("ends"))), fog=None))
    turns = e.time_s % 20.0 > 15.0
    rate = 0.6 * turns
    noise_m = (
        e.datasheet.slip_m_per_sqrt_m * np.sqrt(0.5 * e.step_s) * np.random.default_rng(1).normal(size=(2, len(rate)))
    )
    left, right = (0.5 * e.step_s + sign * 0.5 * e.tread_m * rate * e.step_s for sign in (-1.0, 1.0))
    e = replace(e, left_m=left + noise_m[0], right_m=right + noise_m[1], still=np.zeros(len(rate), bool))
    made = Sensitivities.on(
        e, dead_reckon((e.right_m - e.left_m) / e.tread_m, 0.5 * (e.left_m + e.right_m), np.zeros(3))
    )
    by_step = {name: getattr(made, name).rate_rad_s.reshape(len(rate), -1).mean(axis=1) for name in ("motion", "sharp")}
    edge = np.abs(np.diff(rate, prepend=0.0)) > 0.0
    off = {name: float(np.sqrt(np.mean((found - rate)[edge][1:-1] ** 2))) for name, found in by_step.items()}
    assert off["sharp"] < 0.5 * off["motion"]
    straight = ~turns & ~np.roll(turns, 30) & ~np.roll(turns, -30)
    assert np.std(by_step["motion"][straight]) < 0.35 * np.std(
        (noise_m[1] - noise_m[0])[straight] / e.tread_m / e.step_s[straight]
    )


@pytest.mark.parametrize("name", catalogue())
def test_along_a_motion_that_is_not_changed_an_effect_is_as_it_was(name: str) -> None:
    """Also what is told by sharper turns, or smoother ones, than the others: held out, it is not told by others."""
    recording = recorded(DRIVE, 1, conditions=Conditions(reference=Reference.parse("full")))
    problem = Problem(gather(replace(recording, fog=None)))
    effect = catalogue()[name]
    values = {**effect.variants(problem.sensitivities.motion)[0], **dict.fromkeys(effect.linear(), 0.1)}
    one = [Selected(effect, values, ())]
    assert np.array_equal(problem.along(lambda motion: motion).effect_rows(one), problem.effect_rows(one))
