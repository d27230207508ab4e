"""What to drive next."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from drd.effects.catalogue import catalogue
from drd_tools.diagnose.advise.manoeuvres import MANOEUVRES, drive
from drd_tools.diagnose.advise.next_drive import (
    SETTLED_NATS,
    _driven,
    next_drive,
    open_questions,
    options_for,
)
from drd_tools.diagnose.conclude.cause import Cause
from drd_tools.diagnose.conclude.conclusion import Conclusion
from drd_tools.diagnose.observe.evidence import gather
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.regression.refine import Fit, refine_all
from drd_tools.diagnose.results import NOTHING, NextDrive, Status, Support
from drd_tools.diagnose.select.search import Found
from drd_tools.diagnose.select.splines import Curve
from drd_tools.diagnose.selected import Selected
from drd_tools.recordings.folder import Recording
from drd_tools.simulate.conditions import Conditions, Reference
from drd_tools.simulate.missions import make_drive
from drd_tools.simulate.robot import DEFAULT
from drd_tools.simulate.simulator import simulate
from drd_tools.simulate.truth import make_truth

CIRCLES = next(name for name in MANOEUVRES if name.startswith("circles"))
WEAK = ("a slalom", "straight lines", "figures of eight")


def selected(name: str, **values: float) -> Selected:
    effect = catalogue()[name]
    return Selected(effect, values, tuple(q.name for q in effect.parameters if q.name in values and not q.fixed))


def finding(
    of: Selected | None, *also_fits: str, status: Status = Status.CONFIRMED, curve: Curve | None = None
) -> Cause:
    return Cause(of, status, also_fits, (), Support(50.0, 0.001, 1e6), 0.9, "", {}, curve)


@cache
def recorded(reference: str) -> tuple[Recording, Problem]:
    truth = make_truth(make_drive("slalom", 60.0))
    recording = simulate(truth, DEFAULT, (), Conditions(reference=Reference.parse(reference))).recording
    return recording, Problem(gather(recording))


def diagnosed(*findings: Cause, reference: str = "full") -> Conclusion:
    problem = recorded(reference)[1]
    fit = Fit(tuple(f.selected for f in findings if f.selected is not None), 0.0, np.zeros(0), problem.data)
    found = Found(problem, fit, 0.0, 0.0)
    return Conclusion(list(findings), found, [], {}, [], 0.0)


def advised(*findings: Cause, reference: str = "full") -> NextDrive:
    advice = next_drive(diagnosed(*findings, reference=reference), DEFAULT)
    assert advice is not None
    return advice


def test_without_an_open_question_there_is_nothing_to_drive() -> None:
    assert next_drive(diagnosed(), DEFAULT) is None
    assert next_drive(diagnosed(finding(selected("tread_error", k=0.02))), DEFAULT) is None
    step = selected("gyro_bias_step", b=1e-4, t0=30.0)
    assert next_drive(diagnosed(finding(step, status=Status.SUSPECTED)), DEFAULT) is None


def test_questions_are_all_that_also_fits_and_what_is_only_suspected() -> None:
    sure = finding(selected("gyro_scale_error", k=0.001))
    either = finding(selected("tread_error", k=0.02), "turn_scrub", "terrain_tread", status=Status.SUSPECTED)
    maybe = finding(selected("gyro_lag", tau=0.1), status=Status.SUSPECTED)
    assert open_questions([sure, either, maybe]) == [
        (either, "turn_scrub"),
        (either, "terrain_tread"),
        (maybe, NOTHING),
    ]


@pytest.mark.parametrize(("name", "rival"), [("tread_error", "turn_scrub"), ("turn_scrub", "tread_error")])
def test_constant_against_growing_tread_takes_tight_and_wide_turns(name: str, rival: str) -> None:
    conclusion = diagnosed(finding(selected(name, k=0.05), rival))
    advice = next_drive(conclusion, DEFAULT)
    assert advice is not None
    assert advice.manoeuvre == CIRCLES
    assert advice.separates == [[name, rival]]
    assert (advice.nats or 0.0) >= SETTLED_NATS
    assert f"{name} from {rival}" in advice.sentence
    options = options_for(conclusion.found, DEFAULT, open_questions(conclusion.causes))
    best = {o.manoeuvre: o.nats[0] for o in options if o.minutes == advice.minutes}
    assert all(nats < 0.8 * best[CIRCLES] for manoeuvre, nats in best.items() if manoeuvre.startswith(WEAK))


def test_warm_up_against_temperature_takes_a_temperature_that_falls_again() -> None:
    warmup = selected("gyro_warmup", b=math.radians(0.012), tau=175.0)
    advice = advised(finding(warmup, "gyro_bias_temperature", "gyro_bias_temperature_rate"))
    assert "cooled" in advice.manoeuvre
    assert len(advice.separates) == 2
    assert "power-on" in advice.sentence
    assert all(a.settles == 0 or "cooled" in a.manoeuvre for a in advice.alternatives)


def test_what_no_drive_settles_is_said() -> None:
    advice = advised(finding(selected("tread_error", k=1e-4), "turn_scrub"))
    assert advice.separates == []
    assert advice.unsettled == [["tread_error", "turn_scrub"]]
    assert advice.nats is not None
    assert advice.nats < SETTLED_NATS
    assert advice.sentence.startswith("None of the drives")


def test_more_minutes_bring_more() -> None:
    conclusion = diagnosed(finding(selected("gyro_scale_error", k=0.0003), "gyro_scale_asymmetry"))
    options = options_for(conclusion.found, DEFAULT, open_questions(conclusion.causes))
    for name in {o.manoeuvre for o in options}:
        nats = [o.nats[0] for o in sorted(options, key=lambda o: o.minutes) if o.manoeuvre == name]
        assert np.all(np.diff(nats) > -0.5)
        assert nats[-1] > nats[0]


@pytest.mark.parametrize("reference", ["full", "sparse:20", "ends", "none"])
def test_it_serves_every_kind_of_reference(reference: str) -> None:
    suspected = finding(selected("tread_error", k=0.01), status=Status.SUSPECTED)
    assert advised(suspected, reference=reference).separates == [["tread_error", NOTHING]]


def test_it_says_the_same_twice() -> None:
    suspected = finding(selected("gyro_warmup", b=math.radians(0.02), tau=100.0), status=Status.SUSPECTED)
    first = advised(suspected)
    _driven.cache_clear()
    assert advised(suspected) == first


def test_a_curve_without_a_name_is_put_against_names() -> None:
    knots = np.linspace(-40.0, 40.0, 8)
    curve = Curve("gyro", "yaw_rate", "deg/s", "deg/s", knots, 1e-4 * knots**2, np.full(8, 0.01), 20.0)
    advice = advised(finding(None, "gyro_scale_error", curve=curve))
    assert advice.separates == [["unknown", "gyro_scale_error"]]


def test_a_stretch_of_ground_is_driven_over_again() -> None:
    slip = selected("surface_slip", t0=20.0, t1=30.0, left=0.03, right=0.03)
    assert "same ground again" in advised(finding(slip, status=Status.SUSPECTED)).sentence


def test_a_robot_without_gyro_or_thermometer() -> None:
    recording, problem = recorded("full")
    without = replace(recording, fog=None)
    gyroless = Problem(gather(without))
    conclusion = diagnosed(finding(selected("wheel_radius_error", left=0.004, right=0.004), "wheel_radius_speed"))
    found = replace(conclusion.found, problem=gyroless)
    advice = next_drive(replace(conclusion, found=found), without.nominal)
    assert advice is not None
    assert advice.separates
    assert problem.evidence.gyro_rad is not None


def test_the_nats_are_those_of_real_drives() -> None:
    tread = selected("tread_error", k=0.03)
    conclusion = diagnosed(finding(tread, "turn_scrub"))
    options = options_for(conclusion.found, DEFAULT, open_questions(conclusion.causes))
    promised = next(o.nats[0] for o in options if o.manoeuvre == CIRCLES and o.minutes == 2)
    truth = drive(CIRCLES, 2, DEFAULT.standstill_at_start_s)
    gained = []
    for seed in range(4):
        recording = simulate(truth, DEFAULT, ((tread.effect, tread.values),), Conditions(), seed).recording
        problem = Problem(gather(recording))
        right, wrong = refine_all(problem, [[tread], [selected("turn_scrub", k=0.03)]])
        gained.append(wrong.cost - right.cost)
    assert promised > 10.0
    assert 0.4 * promised < np.mean(gained) < 2.5 * promised
