"""Several effects together act in the catalogue's order, each on what the ones before it left."""

from dataclasses import fields

import numpy as np
import pytest
from effect_motions import in_si, motion
from hypothesis import given, settings
from hypothesis import strategies as st

from drd.effects.catalogue import catalogue
from drd.effects.chain import add
from drd.effects.effect import Effect, Values

EFFECTS = catalogue()


def having(name: str, **values: float | str) -> tuple[Effect, Values]:
    """An effect with its values, which come in the catalogue's units."""
    return EFFECTS[name], in_si(EFFECTS[name], values)


def test_no_effects_change_nothing() -> None:
    m = motion()
    found, lateral_m_s = add(m, [])
    assert found is m
    assert np.array_equal(lateral_m_s, np.zeros_like(m.time_s))


def test_the_motion_given_is_not_written_to() -> None:
    m, same = motion(), motion()
    everything = [
        (e, {**e.variants(m)[0], **{q.name: q.low * q.si for q in e.parameters if q.linear}}) for e in EFFECTS.values()
    ]
    found, lateral_m_s = add(m, everything)
    assert all(np.array_equal(getattr(m, f.name), getattr(same, f.name)) for f in fields(m))
    assert all(np.all(np.isfinite(x)) for x in (found.rate_rad_s, found.left_m_s, found.right_m_s, lateral_m_s))


def test_factors_multiply() -> None:
    m = motion()
    found, _ = add(m, [having("tread_error", k=0.1), having("wheel_radius_error", left=0.2, right=0.0)])
    half = 0.5 * (m.right_m_s - m.left_m_s)
    np.testing.assert_allclose(found.left_m_s, (m.left_m_s - 0.1 * half) * 0.8, atol=1e-12)
    np.testing.assert_allclose(found.right_m_s, m.right_m_s + 0.1 * half, atol=1e-12)


def test_a_larger_wheel_turns_less() -> None:
    m = motion()
    found, _ = add(m, [having("wheel_radius_error", left=0.2, right=0.0)])
    assert np.ptp(found.left_wheel_rad) == pytest.approx(0.8 * np.ptp(m.left_wheel_rad), rel=0.01)
    np.testing.assert_array_equal(found.right_wheel_rad, m.right_wheel_rad)


def test_a_limit_clips_the_sum_of_all() -> None:
    m = motion()
    limit = 0.5 * float(np.max(np.abs(m.rate_rad_s)))
    effects = [
        (EFFECTS["gyro_saturation"], {"limit": limit}),
        having("gyro_scale_error", k=0.05),
        having("gyro_bias_step", b=0.5, t0=10.0),
        having("gyro_latency", delay=0.1),
    ]
    found, _ = add(m, effects)
    unlimited, _ = add(m, effects[1:])
    np.testing.assert_allclose(found.rate_rad_s, np.clip(unlimited.rate_rad_s, -limit, limit), atol=1e-15)
    assert np.max(np.abs(unlimited.rate_rad_s)) > 1.5 * limit


def test_a_latency_delays_what_is_there() -> None:
    m = motion(20.0)
    effects = [having("gyro_latency", delay=0.5), having("gyro_bias_step", b=1.0, t0=60.0)]
    found, _ = add(m, effects)
    without, _ = add(m, effects[:1])
    jump = found.rate_rad_s - without.rate_rad_s
    seen_s = m.time_s[np.flatnonzero(jump > 1e-3)[0]]
    assert seen_s == pytest.approx(60.5, abs=0.051)


def test_a_counter_that_stands_still_does_so_whatever_else_acts() -> None:
    m = motion()
    found, _ = add(
        m,
        [
            having("encoder_dropout", side="left", t0=30.0, t1=40.0),
            having("tread_error", k=0.1),
            having("turn_scrub", k=0.1),
            having("encoder_latency", delay=0.1),
        ],
    )
    inside = (m.time_s >= 30.0) & (m.time_s < 40.0)
    assert np.all(found.left_m_s[inside] == 0.0)
    assert np.all(found.left_m_s[~inside] != 0.0)


def test_the_body_moves_by_the_truth_and_sensors_read_the_rest() -> None:
    m = motion()
    effects = [
        having("gyro_scale_error", k=0.05),
        having("wheel_radius_error", left=0.1, right=0.1),
        having("rotation_centre_offset", a=0.2),
        having("lateral_slip_turning", k=0.1),
    ]
    found, lateral_m_s = add(m, effects)
    np.testing.assert_allclose(lateral_m_s, 0.2 * m.rate_rad_s - 0.1 * m.speed_m_s * m.rate_rad_s, atol=1e-12)
    for name in ("time_s", "speed_m_s", "heading_rad", "acceleration_m_s2", "temperature_c"):
        assert np.array_equal(getattr(found, name), getattr(m, name))


def test_one_effect_may_act_twice() -> None:
    m = motion()
    found, _ = add(
        m,
        [
            having("surface_slip", t0=10.0, t1=20.0, left=0.1, right=0.0),
            having("surface_slip", t0=50.0, t1=60.0, left=0.2, right=0.0),
        ],
    )
    share = found.left_m_s / m.left_m_s - 1.0
    assert share[250] == pytest.approx(0.1)
    assert share[1050] == pytest.approx(0.2)
    assert share[700] == 0.0


@settings(deadline=None, max_examples=20)
@given(order=st.permutations(range(5)), seed=st.integers(0, 2**32 - 1))
def test_the_order_in_which_they_are_given_does_not_matter(order: list[int], seed: int) -> None:
    m = motion(10.0, 30.0, seed)
    effects = [
        having("gyro_saturation", limit=20.0),
        having("gyro_scale_error", k=0.05),
        having("gyro_lag", tau=0.2),
        having("gyro_warmup", b=0.1, tau=50.0),
        having("slip_acceleration", k=0.1),
    ]
    one, _ = add(m, effects)
    two, _ = add(m, [effects[i] for i in order])
    assert np.array_equal(one.rate_rad_s, two.rate_rad_s)
    assert np.array_equal(one.left_m_s, two.left_m_s)
