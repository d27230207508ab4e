"""Physics that is in no catalogue, effects put onto recordings, other methods, the other world."""

import importlib.util
from dataclasses import replace

import numpy as np
import pytest

from drd.effects.catalogue import catalogue
from drd_tools.diagnose.observe.evidence import gather
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.selected import Selected
from drd_tools.simulate.conditions import PERFECT, Conditions, Reference
from drd_tools.simulate.missions import make_drive
from drd_tools.simulate.robot import DEFAULT
from drd_tools.simulate.simulator import Simulated, simulate
from drd_tools.simulate.truth import make_truth
from drd_tools.trial import contacts
from drd_tools.trial.baselines import PACKAGES, baselines, regress
from drd_tools.trial.overlay import overlaid
from drd_tools.trial.size import Whitener, eventful
from drd_tools.trial.unknown import HIDDEN, PREFIX


@pytest.fixture(scope="module")
def null() -> Simulated:
    return simulate(make_truth(make_drive("warehouse", 150.0), "cycle"), DEFAULT, (), Conditions(), 3)


def whitener(null: Simulated) -> Whitener:
    return Whitener(Problem(gather(null.recording)), null.motion)


def scaled(null: Simulated, name: str, d: float) -> Simulated:
    effect = catalogue()[name]
    values = whitener(null).sized(effect, d, np.random.default_rng(0))
    assert values is not None
    return simulate(null.truth, DEFAULT, [(effect, values)], Conditions(), 3)


@pytest.mark.parametrize("name", list(HIDDEN))
def test_hidden_physics_is_in_no_catalogue_and_has_the_detectability_asked_for(name: str, null: Simulated) -> None:
    effect = HIDDEN[name]
    assert name.startswith(PREFIX)
    assert name not in catalogue()
    seen = whitener(null)
    values = seen.sized(effect, 20.0, np.random.default_rng(1))
    assert values is not None
    assert seen.detectability(effect, values) == pytest.approx(20.0, rel=0.03)
    with_it = gather(overlaid(null.recording, null.motion, [effect.error(null.motion, values)]))
    changed = Problem(with_it).data - seen.problem.data
    assert np.linalg.norm(changed) > 10.0


@pytest.mark.parametrize("name", ["gyro_scale_error", "wheel_radius_error", "lateral_slip_turning"])
def test_an_effect_put_onto_a_recording_is_what_the_simulator_makes(name: str) -> None:
    truth = make_truth(make_drive("square-cw", 90.0))
    effect = catalogue()[name]
    values = {q.name: 0.01 for q in effect.parameters}
    plain, made = (simulate(truth, DEFAULT, effects, PERFECT, 3) for effects in ((), [(effect, values)]))
    put = overlaid(plain.recording, plain.motion, [effect.error(plain.motion, values)])
    for a, b in zip(put.wheel_angles_rad(), made.recording.wheel_angles_rad(), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-3)  # three counts
    assert put.fog is not None
    assert made.recording.fog is not None
    np.testing.assert_allclose(put.fog.rate_rad_s, made.recording.fog.rate_rad_s, atol=np.radians(0.0041))
    assert put.reference is not None
    assert made.recording.reference is not None
    np.testing.assert_allclose(put.reference.x_m, made.recording.reference.x_m, atol=2e-3)
    np.testing.assert_allclose(put.reference.y_m, made.recording.reference.y_m, atol=2e-3)


def test_what_was_found_beside_an_effect_takes_its_share_of_the_distance(null: Simulated) -> None:
    seen, effects = whitener(null), catalogue()
    scale, alike = effects["gyro_scale_error"], effects["gyro_scale_asymmetry"]
    alone, own, beside = (
        replace(seen, beside=found).detectability(scale, {"k": 0.001})
        for found in ((), [Selected(scale, {"k": 0.01}, ("k",))], [Selected(alike, {"k": 0.01}, ("k",))])
    )
    assert own == pytest.approx(alone)
    assert 0.0 < beside < 0.95 * alone


@pytest.mark.parametrize("name", ["encoder_dropout", "gyro_saturation", "gyro_deadband"])
def test_what_destroys_readings_is_drawn_where_the_robot_moves(name: str, null: Simulated) -> None:
    effect = catalogue()[name]
    values = eventful(null.motion, effect, np.random.default_rng(2))
    assert values is not None
    assert whitener(null).detectability(effect, values) > 4.0  # 8 nats


def test_the_regression_of_other_methods_sees_an_effect_where_it_is(null: Simulated) -> None:
    strong = scaled(null, "gyro_scale_error", 300.0)
    for conditions in (Reference(), Reference(period_s=20.0)):
        made = simulate(strong.truth, DEFAULT, strong.effects, Conditions(reference=conditions), 3)
        r = regress(made.recording)
        np.testing.assert_allclose(np.mean(r.X**2, axis=0), 1.0, rtol=1e-6)
        correlation = np.abs(r.X.T @ r.y) / len(r.y)
        own = correlation[[i for i, name in enumerate(r.effects) if name == "gyro_scale_error"]]
        assert own.max() > 0.9 * correlation.max()


@pytest.mark.parametrize("method", list(PACKAGES))
def test_other_methods_find_what_is_strong(method: str, null: Simulated) -> None:
    pytest.importorskip(PACKAGES[method])
    strong = scaled(null, "tread_error", 100.0)
    assert baselines(strong.recording, [method])[method]
    assert baselines(strong.recording, []) == {}


def test_a_recording_without_a_gyro_or_a_reference_is_regressed_too(null: Simulated) -> None:
    for one in (replace(null.recording, fog=None), replace(null.recording, reference=None)):
        r = regress(one)
        assert len(r.y) == len(r.X)
        assert r.X.shape[1] == len(r.effects) > 10


@pytest.mark.skipif(importlib.util.find_spec("mujoco") is None, reason="mujoco is not installed")
def test_the_other_world_is_calibrated() -> None:
    driven = contacts.drive("square-ccw", 60.0, 3, 0.9, Reference(), "run")
    m = driven.motion
    half = 0.5 * m.tread_m * m.rate_rad_s
    for wheel, true in ((m.left_m_s, m.speed_m_s - half), (m.right_m_s, m.speed_m_s + half)):
        assert np.sqrt(np.mean((wheel - true) ** 2)) < 0.01
    angle = driven.recording.nominal.wheel_radius_m * driven.recording.wheel_angles_rad()[0]
    assert angle[-1] == pytest.approx(float(np.trapezoid(m.left_m_s, m.time_s)), abs=0.01)
    assert driven.recording.nominal.tread_m > 0.6  # the drawing's track is 0.57 m
