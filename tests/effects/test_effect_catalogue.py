"""The catalogue is whole, says what it must about each effect, and its table is up to date."""

import json
import math
import re
from pathlib import Path

import pytest
from effect_motions import motion

from drd.effects import table
from drd.effects.catalogue import catalogue
from drd.effects.effect import ActsOn, Effect, Errors

ROOT = Path(__file__).resolve().parents[2]
SHARED = ROOT.parent / "shared"
# The ids of the reference, by where they act.
GYRO = """
    gyro_scale_error gyro_scale_nonlinearity gyro_scale_asymmetry gyro_bias_temperature gyro_bias_temperature_rate
    gyro_scale_temperature gyro_warmup gyro_bias_step gyro_lag gyro_latency gyro_deadband gyro_saturation
    gyro_heading_dependent_bias gyro_vibration_bias gyro_sample_clock
"""
WHEELS = """
    wheel_radius_error tread_error turn_scrub slip_acceleration surface_slip tyre_deflation wheel_radius_speed
    wheel_eccentricity encoder_missed_counts bump_counts encoder_latency encoder_clock_skew encoder_dropout
    terrain_tread
"""
BODY = "lateral_slip_turning rotation_centre_offset"
ACTS_ON = {i: where for where, ids in (("gyro", GYRO), ("wheels", WHEELS), ("body", BODY)) for i in ids.split()}
BESIDE = {"encoder_lag": "wheels"}  # that are not the reference's
COVARIATES = {
    "acceleration", "curvature", "heading", "lateral_acceleration", "place", "speed", "temperature",
    "temperature_rate", "time", "wheel_phase", "yaw_rate",
}  # fmt: skip
EVERY = pytest.mark.parametrize("effect", catalogue().values(), ids=lambda effect: effect.id)


def test_the_effects_are_those_of_the_reference_and_act_where_it_says() -> None:
    assert len(ACTS_ON) == 31
    assert {e.id: e.channel for e in catalogue().values()} == ACTS_ON | BESIDE


@pytest.mark.recordings
def test_the_list_above_is_the_reference_s() -> None:
    file = SHARED / "reference/effects.md"
    if not file.is_file():
        pytest.skip("no shared reference")
    rows = re.findall(r"^\| (\w+) \| (gyro|wheels|body) \|", file.read_text(), re.MULTILINE)
    assert dict(rows) == ACTS_ON


@pytest.mark.recordings
def test_parameters_are_named_as_in_the_trials() -> None:
    file = SHARED / "trials/answers.json"
    if not file.is_file():
        pytest.skip("no shared trials")
    for found in (answer for case in json.loads(file.read_text()) for answer in case["effects"]):
        if "shape" not in found["parameters"]:  # a form that is on purpose not the catalogue's
            assert set(found["parameters"]) <= {q.name for q in catalogue()[found["effect"]].parameters}


def test_effects_come_in_the_order_in_which_they_act() -> None:
    order = [list(ActsOn).index(e.acts_on) for e in catalogue().values()]
    assert order == sorted(order)


@EVERY
def test_each_effect_explains_itself(effect: Effect) -> None:
    assert effect.sentence.endswith(".")
    assert all((effect.formula, effect.source, effect.manoeuvre))
    assert effect.covariate in COVARIATES
    assert 0.0 < effect.remainder <= 1.0
    # What removal leaves whole is what cannot be undone; and the reason is a clause, not a sentence.
    assert effect.remainder < 1.0 or effect.irreversible
    assert not effect.irreversible.endswith(".")


def test_what_is_not_the_reference_s_is_no_rival_of_what_is() -> None:
    assert {e.id for e in catalogue().values() if not e.is_diagnosed} == set(BESIDE)


@EVERY
def test_parameters_have_a_sensible_range(effect: Effect) -> None:
    names = [q.name for q in effect.parameters]
    assert names
    assert len(set(names)) == len(names)
    for q in effect.parameters:
        assert q.text
        assert q.si > 0.0
        if q.choices:
            assert not q.linear
            continue
        assert math.isfinite(q.high)
        assert q.low < q.high
        if q.linear:  # a size, over which one can search in decades
            assert q.low > 0.0
            assert q.unit
        assert not (q.fixed and q.linear)


@EVERY
def test_variants_give_each_parameter_that_is_not_linear_and_are_few(effect: Effect) -> None:
    variants = effect.variants(motion())
    expected = {q.name for q in effect.parameters} - set(effect.linear())
    assert 1 <= len(variants) <= 40
    assert len({tuple(v.items()) for v in variants}) == len(variants)
    for q in effect.parameters:
        values = [v[q.name] for v in variants if q.name in v]
        if q.choices:
            assert set(values) == set(q.choices)
        assert not q.fixed or len(values) == 1
    assert all(set(v) == expected for v in variants)


@EVERY
def test_an_effect_adds_only_where_it_acts(effect: Effect) -> None:
    m = motion()
    fields = {"gyro": ("gyro_rad_s",), "wheels": ("left_m_s", "right_m_s"), "body": ("lateral_m_s",)}[effect.channel]
    variant = effect.variants(m)[0]
    sizes = {q.name: q.high * q.si for q in effect.parameters if q.linear}
    for errors in (effect.error(m, {**variant, **sizes}), *effect.other_shapes(m)):
        others = errors._replace(**dict.fromkeys(fields, 0.0))
        assert others == Errors()


def test_the_table_in_the_documentation_is_up_to_date() -> None:
    assert (ROOT / "drd/effects/CATALOGUE.md").read_text() == table.markdown(), "run python -m drd.effects"
