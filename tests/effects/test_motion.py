"""Motion as effects see it: values as of a moment ago."""

import numpy as np
import pytest
from effect_motions import driven
from hypothesis import given
from hypothesis import strategies as st

from drd.effects.motion import Motion

SPACING_S = 0.025
TIME_S = SPACING_S * np.arange(400, dtype=float)


@pytest.fixture(scope="module")
def moving() -> Motion:
    return driven(TIME_S, np.sin(2.0 * TIME_S), np.zeros_like(TIME_S), np.full_like(TIME_S, 20.0))


@given(delay_s=st.floats(0.0, 0.4))
def test_a_sine_is_delayed_within_the_error_of_a_cubic(moving: Motion, delay_s: float) -> None:
    late = moving.delayed(moving.speed_m_s, delay_s)
    inside = (delay_s + SPACING_S < TIME_S) & (TIME_S - delay_s < TIME_S[-2])
    # A linear interpolation is off by up to (2 * 0.025)^2 / 8 = 3e-4.
    assert np.abs(late - np.sin(2.0 * (TIME_S - delay_s)))[inside].max() < 2e-5


@pytest.mark.parametrize("samples", [1, 4, 7])
def test_its_derivative_is_continuous_where_a_delay_passes_a_sample(moving: Motion, samples: int) -> None:
    rough = np.random.default_rng(1).normal(size=len(moving.time_s))
    at_s, h = samples * SPACING_S, 1e-7
    before = (moving.delayed(rough, at_s - h) - moving.delayed(rough, at_s - 2 * h)) / h
    after = (moving.delayed(rough, at_s + 2 * h) - moving.delayed(rough, at_s + h)) / h
    # A linear interpolation turns there by the second difference over the spacing: some 100.
    assert np.abs(after - before)[samples + 2 :].max() < 0.1


def test_no_delay_changes_nothing_and_the_ends_are_held(moving: Motion) -> None:
    values = np.arange(400.0)
    assert np.array_equal(moving.delayed(values, 0.0), values)
    assert np.allclose(moving.delayed(values, 1.0)[:40], 0.0)
    assert np.allclose(moving.delayed(values, -1.0)[-40:], 399.0)


def test_each_sample_may_have_its_own_delay(moving: Motion) -> None:
    late_s = np.linspace(0.0, 0.2, 400)
    each = [moving.delayed(moving.speed_m_s, late_s[k])[k] for k in (0, 100, 399)]
    assert np.allclose(moving.delayed(moving.speed_m_s, late_s)[[0, 100, 399]], each)
