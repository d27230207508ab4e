"""Which order is recommended, and what is refused because the data cannot tell it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rate_table_data import RATES, TEMPERATURES, ErrorLaw, means, of_means, rd2100_error

from drd.arrays import Array
from drd_tools.calibrate.gyro.candidates import (
    Candidate,
    NotObservableError,
    beyond_the_file,
    compare,
    levels,
    recommend,
    require_observable,
    why_not_observable,
)
from drd_tools.calibrate.gyro.data_sets import DataSets
from drd_tools.calibrate.gyro.error_function import Order

FULL = Order(3, 2)


def data(
    law: ErrorLaw = rd2100_error,
    seed: int = 1,
    rates: tuple[float, ...] = RATES,
    temperatures: tuple[float, ...] = TEMPERATURES,
) -> DataSets:
    return of_means(*means(law, np.random.default_rng(seed), rates, temperatures))


LAWS: dict[Order, ErrorLaw] = {
    Order(1, 0): lambda w, T: 0.05 + 0.004 * w + 0.0 * T,
    Order(1, 1): lambda w, T: 0.05 + 0.001 * T + (0.004 + 1e-4 * T) * w,
    Order(3, 0): lambda w, T: 0.05 + 0.004 * w + 4e-7 * w**3 + 0.0 * T,
    Order(3, 2): lambda w, T: 0.05 + 1e-4 * T**2 + (0.004 + 2e-6 * T**2) * w + (4e-7 + 2e-10 * T**2) * w**3,
}


@settings(deadline=None, max_examples=3)
@given(st.integers(0, 2**32 - 1))
@pytest.mark.parametrize("order", LAWS, ids=str)
def test_the_order_of_the_gyro_is_found(order: Order, seed: int) -> None:
    candidates = compare(data(LAWS[order], seed), orders=[Order(r, t) for r in (1, 2, 3) for t in (0, 1, 2)])
    chosen, why = recommend(candidates)
    # The reading's polynomial is not quite the rate's: a weak higher order may be there, a lower one never suffices.
    assert chosen.order.rate >= order.rate
    assert chosen.order.temperature >= order.temperature
    assert chosen.order.coefficients <= order.coefficients + 4
    assert f"Order {chosen.order} is recommended" in why


def test_an_order_beyond_the_file_is_shown_but_never_recommended() -> None:
    fifth: ErrorLaw = lambda w, T: 0.01 * w + 3e-11 * w**5 + 0.0 * T  # noqa: E731
    candidates = compare(data(fifth))
    assert min(candidates, key=lambda c: c.held_out_deg_s).order.rate == 5
    chosen, _ = recommend(candidates)
    assert chosen.order.fits_in_file
    assert "times better" in beyond_the_file(candidates, chosen)


def residuals(order: Order, size: float, count: int = 50) -> Candidate:
    spread = size * np.random.default_rng(order.coefficients).standard_normal(count)
    fitted = compare(data(), orders=[Order(1, 0)])[0].fitted
    return Candidate(order, "", fitted, None, spread)


def test_the_simplest_within_one_standard_error_of_the_best_is_taken() -> None:
    poor, good, best = residuals(Order(1, 0), 2.0), residuals(Order(2, 0), 1.0), residuals(Order(3, 2), 1.0)
    assert good.residual_deg_s is not None
    best = Candidate(best.order, "", best.fitted, None, 0.97 * good.residual_deg_s)
    assert best.held_out_deg_s < good.held_out_deg_s < best.held_out_deg_s + best.standard_error_deg_s
    chosen, why = recommend([poor, good, best])
    assert chosen is good
    assert "within one standard error of the best, order 3,2" in why
    assert recommend([poor, best])[0] is best


def test_held_out_residuals_are_those_of_new_data() -> None:
    candidate = compare(data(), data(seed=2), orders=[FULL])[0]
    assert candidate.new_residual_deg_s is not None
    new = float(np.sqrt(np.mean(candidate.new_residual_deg_s**2)))
    assert candidate.held_out_deg_s == pytest.approx(new, rel=0.3)


def test_a_rejected_data_set_does_not_spoil_the_comparison() -> None:
    good = data()
    rate: Array = good.rate_deg_s.copy()
    rate[50] += 10.0
    bad = of_means(good.table_rate_deg_s, rate, good.temperature_c, good.sigma_deg_s)
    for clean, spoilt in zip(compare(good, orders=[FULL]), compare(bad, orders=[FULL]), strict=True):
        assert spoilt.held_out_deg_s == pytest.approx(clean.held_out_deg_s, rel=0.25)


REFUSED = {
    "one temperature": (
        data(temperatures=(25.0,)),
        "only one temperature (25 degC): the terms in temperature are not observable",
        "`--order 3,0` accepts a calibration for this temperature only",
    ),
    "two temperatures": (
        data(temperatures=(10.0, 40.0)),
        "only two temperatures (",
        "the quadratic term in temperature is not observable; record more, or: `--order 3,1`",
    ),
    "three rates": (
        data(rates=(-50.0, 0.0, 50.0)),
        "only three rates (-50, 0, 50 deg/s): the cubic term in rate is not observable",
        "`--order 2,2`",
    ),
    "a handful": (
        data(rates=(-50.0, 0.0, 50.0, 80.0), temperatures=(0.0, 20.0, 40.0)),
        "12 coefficients and needs 16 data sets, there are 12",
        "`--order 3,1`",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_the_data_cannot_tell_is_refused_with_the_reason_and_the_way_out(name: str) -> None:
    sets, reason, way_out = REFUSED[name]
    if name == "one temperature":
        sets = of_means(sets.table_rate_deg_s, sets.rate_deg_s, 0.0 * sets.rate_deg_s + 25.0, sets.sigma_deg_s)
    with pytest.raises(NotObservableError) as caught:
        require_observable(sets, FULL)
    assert reason in str(caught.value)
    assert way_out in str(caught.value)


def test_temperatures_at_standstill_only_do_not_tell_the_scales_slope() -> None:
    sets = data()
    cross = sets.select((np.abs(sets.table_rate_deg_s) < 25.0) | (np.abs(sets.temperature_c) < 5.0))
    assert why_not_observable(sets, FULL) == ""
    assert "not observable together" in why_not_observable(cross, FULL)


def test_the_way_out_is_itself_observable() -> None:
    sets = data(rates=(-50.0, 50.0), temperatures=(0.0, 15.0, 30.0))
    with pytest.raises(NotObservableError, match=r"`--order 1,0`"):
        require_observable(sets, FULL)
    require_observable(sets, Order(1, 0))
    with pytest.raises(NotObservableError, match="no error function can be determined"):
        require_observable(sets.select(np.array([0, 2])), FULL)


def test_where_nothing_could_be_tried_the_reason_is_told() -> None:
    with pytest.raises(NotObservableError, match="only one rate"):
        recommend(compare(data(rates=(5.0,)), orders=[Order(1, 0), Order(2, 0)]))


def test_levels_are_the_settings_not_the_values() -> None:
    assert levels(np.array([0.0, 0.5, 20.0, 20.4, -19.6, 0.2]), 3.0) == pytest.approx([-19.6, 0.7 / 3.0, 20.2])
