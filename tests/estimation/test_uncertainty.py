"""The published covariance, as far as it is more than the filter's."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drd.estimation.lead import onward, seen_from
from drd.estimation.uncertainty import UncertainHeading, lead_moments

PLACES = st.tuples(st.floats(-100, 100), st.floats(-100, 100), st.floats(-7, 7))


@pytest.mark.parametrize(("lag_s", "sigma_s"), [(0.0, 0.2), (0.05, 0.05), (-0.03, 0.02), (0.1, 0.02), (-0.2, 0.04)])
def test_the_leads_error_is_that_of_a_lag_that_is_no_lead_where_it_is_negative(lag_s: float, sigma_s: float) -> None:
    lags_s = np.random.default_rng(1).normal(lag_s, sigma_s, 1_000_000)
    error_s = max(lag_s, 0.0) - np.maximum(lags_s, 0.0)
    part, square_s2 = lead_moments(lag_s, sigma_s**2)
    assert part == pytest.approx(-np.cov(error_s, lags_s)[0, 1] / sigma_s**2, abs=0.005)
    assert square_s2 == pytest.approx(np.mean(error_s**2), abs=0.005 * sigma_s**2)


def test_a_lag_that_is_known_leads_wholly_or_not_at_all() -> None:
    assert lead_moments(0.1, 1e-6) == (1.0, 1e-6)
    assert lead_moments(-0.1, 1e-6) == (0.0, 0.0)
    assert lead_moments(0.0, 0.0)[1] == 0.0  # a robot without a gyro


@given(PLACES, PLACES)
def test_a_place_seen_from_another_leads_back(origin: tuple[float, ...], place: tuple[float, ...]) -> None:
    back = onward(origin, seen_from(origin, place))  # type: ignore[arg-type]  # hypothesis' tuples have no length
    assert back == pytest.approx(place, abs=1e-9)


def test_the_blind_ways_variance_holds_a_heading_that_was_wrong() -> None:
    """10 m straight on, then back: what turned the way is at most what (36) has of it."""
    sigma_rad, steps = 0.7, [1.0] * 10 + [-1.0] * 10
    blind = UncertainHeading()
    grown = [blind.growth(step, 0.0, sigma_rad**2) for step in steps]
    assert min(grown) == 0.0 == sum(grown[10:])  # the way back adds nothing
    headings = np.random.default_rng(2).normal(0.0, sigma_rad, 100_000)
    back_m = 10.0 * (1.0 - np.cos(headings))
    assert math.sqrt(sum(grown)) == pytest.approx(math.sqrt(np.mean(back_m**2)), rel=0.25)
    assert sum(grown) > np.mean(back_m**2)
