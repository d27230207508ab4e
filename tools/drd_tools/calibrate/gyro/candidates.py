"""Choice of the error function's order: which orders are observable, and how well each does on held-out data sets."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from drd.arrays import Array
from drd_tools.calibrate.gyro.data_sets import Counts, DataSets
from drd_tools.calibrate.gyro.error_function import (
    FILE_ORDER,
    ErrorFunction,
    Order,
    corner_leverage,
    fit_error_function,
)
from drd_tools.evaluate.metrics import rms

ORDERS: Final = tuple(Order(rate, temperature) for rate in range(1, 6) for temperature in range(4))
FOLDS: Final = 10
TEMPERATURE_STEP_C: Final = 3.0  # a gyro that warms itself at one temperature of the chamber stays within it
RATE_STEP: Final = 0.02  # fraction of the whole range of rates
LARGEST_LEVERAGE: Final = 25.0  # at a corner of the range: e is five times less certain there than one data set
POWERS: Final = {1: "linear", 2: "quadratic", 3: "cubic", 4: "fourth-order", 5: "fifth-order"}
NUMBERS: Final = {1: "one", 2: "two", 3: "three", 4: "four", 5: "five"}


class NotObservableError(Exception):
    """The data cannot determine what was requested; the text gives the reason and a remedy."""


@dataclass(frozen=True)
class Candidate:
    """An order of the error function, with its residuals, or with the `reason` why it was not tried.

    `residual_deg_s`: shape (n,), held-out residual of each data set in `unseen`, which has no rejected ones.
    `new_residual_deg_s`: shape (m,), residuals of the separate new data under the fit to all data sets.
    """

    order: Order
    reason: str = ""
    fitted: ErrorFunction | None = None
    unseen: DataSets | None = None
    residual_deg_s: Array | None = None
    new_residual_deg_s: Array | None = None

    @property
    def held_out_deg_s(self) -> float:
        """Root mean square of the held-out residuals; infinite where not tried."""
        return float("inf") if self.residual_deg_s is None else rms(self.residual_deg_s)

    @property
    def standard_error_deg_s(self) -> float:
        """Standard error of `held_out_deg_s`; infinite where not tried."""
        if self.residual_deg_s is None or len(self.residual_deg_s) < 2:
            return float("inf")
        square = self.residual_deg_s**2
        return float(square.std(ddof=1) / np.sqrt(len(square)) / (2.0 * max(self.held_out_deg_s, 1e-300)))


def levels(values: Array, step: float) -> list[float]:
    """Distinct settings among `values`: means of groups whose smallest values are at least `step` apart."""
    groups: list[list[float]] = []
    for value in np.sort(values).tolist():
        if not groups or value - groups[-1][0] >= step:
            groups.append([])
        groups[-1].append(value)
    return [float(np.mean(group)) for group in groups]


def rate_levels(data: DataSets) -> list[float]:
    """The table's rates, deg/s."""
    return levels(data.table_rate_deg_s, max(RATE_STEP * float(np.ptp(data.table_rate_deg_s)), 1e-9))


def temperature_levels(data: DataSets) -> list[float]:
    """The temperatures, degC."""
    return levels(data.temperature_c, TEMPERATURE_STEP_C)


def why_not_observable(data: DataSets, order: Order) -> str:
    """Reason why the data sets do not determine this order; empty if they do."""
    checks = (
        (temperature_levels(data), order.temperature, "temperature", "degC"),
        (rate_levels(data), order.rate, "rate", "deg/s"),
    )
    for found, power, name, unit in checks:
        if len(found) > power:
            continue
        few = ", ".join(f"{round(level, 1):g}" for level in found)
        count = f"only {NUMBERS[len(found)]} {name}{'s' if len(found) > 1 else ''} ({few} {unit})"
        if len(found) == 1:
            return f"{count}: the terms in {name} are not observable"
        return f"{count}: the {POWERS[len(found)]} term in {name} is not observable"
    try:
        leverage, rate, temperature = corner_leverage(data, order)
    except ValueError as error:
        return str(error)
    if leverage > LARGEST_LEVERAGE:
        return (
            f"no data sets near {rate:.3g} deg/s at {temperature:.3g} degC: the terms of order {order} are not "
            "observable together"
        )
    return ""


def require_observable(data: DataSets, order: Order) -> None:
    """Raise NotObservableError, with the reason and the largest order that the data determine."""
    reason = why_not_observable(data, order)
    if not reason:
        return
    smaller = [o for o in ORDERS if o.rate <= order.rate and o.temperature <= order.temperature]
    possible = [o for o in smaller if not why_not_observable(data, o)]
    if not possible:
        raise NotObservableError(f"{reason}; no error function can be determined from these data sets")
    most = max(possible, key=lambda o: (o.coefficients, o.rate))
    accepted = f"`--order {most}` accepts a calibration without what is missing"
    if len(temperature_levels(data)) == 1:
        accepted = f"`--order {most}` accepts a calibration for this temperature only"
    raise NotObservableError(f"{reason}; record more, or: {accepted}")


def compare(
    data: DataSets,
    new: DataSets | None = None,
    orders: Sequence[Order] = ORDERS,
    progress: Callable[[Iterable[Order]], Iterable[Order]] = lambda orders: orders,
) -> list[Candidate]:
    """Fit each order and test it on held-out data (tenfold cross-validation over whole data sets).

    Data sets rejected by the largest observable order that fits in the file are left out for all orders. `progress`
    may wrap the orders. A candidate that cannot be tried states why.
    """
    reasons = {order: why_not_observable(data, order) for order in orders}
    kept = _not_rejected(data, [order for order in orders if not reasons[order]])
    folds = np.random.default_rng(1).permutation(len(kept)) % FOLDS
    candidates = []
    for order in progress(orders):
        if reasons[order]:
            candidates.append(Candidate(order, reasons[order]))
            continue
        try:
            fitted = fit_error_function(data, order)
            residual, of_new = held_out(kept, order, folds), None if new is None else fitted.residual_deg_s(new)
            candidates.append(Candidate(order, "", fitted, kept, residual, of_new))
        except ValueError as error:
            candidates.append(Candidate(order, f"too few data sets to hold any out: {error}"))
    return candidates


def _not_rejected(data: DataSets, observable: Sequence[Order]) -> DataSets:
    """Data sets that the largest of these orders, among those that fit in the file, does not reject."""
    fitting = [order for order in observable if order.fits_in_file]
    if not fitting:
        return data
    return data.select(fit_error_function(data, max(fitting, key=lambda order: order.coefficients)).weights > 0.0)


def held_out(data: DataSets, order: Order, folds: Counts) -> Array:
    """Residual of each data set under a fit to the other folds, shape (n,). Raises ValueError."""
    residual = np.empty(len(data))
    for fold in np.unique(folds):
        out = folds == fold
        residual[out] = fit_error_function(data.select(~out), order).residual_deg_s(data.select(out))
    return residual


def recommend(candidates: Sequence[Candidate]) -> tuple[Candidate, str]:
    """Choose the simplest order within one standard error of the best, and say why. (Breiman and others 1984)

    Only orders that fit in the calibration file are considered. Raises NotObservableError if none was tried.
    """
    tried = [c for c in candidates if c.fitted is not None and c.order.fits_in_file]
    if not tried:
        raise NotObservableError("; ".join(dict.fromkeys(c.reason for c in candidates if c.reason)))
    best = min(tried, key=lambda c: c.held_out_deg_s)
    limit = best.held_out_deg_s + best.standard_error_deg_s
    chosen = min(
        (c for c in tried if c.held_out_deg_s <= limit), key=lambda c: (c.order.coefficients, c.held_out_deg_s)
    )
    text = f"its residual on held-out data sets ({chosen.held_out_deg_s:.3g} deg/s) is the smallest"
    if chosen is not best:
        text = (
            f"it is the simplest whose residual on held-out data sets ({chosen.held_out_deg_s:.3g} deg/s) is within "
            f"one standard error of the best, order {best.order} ({best.held_out_deg_s:.3g} +- "
            f"{best.standard_error_deg_s:.1g} deg/s)"
        )
    return chosen, f"Order {chosen.order} is recommended: {text}."


def beyond_the_file(candidates: Sequence[Candidate], chosen: Candidate) -> str:
    """Sentence on what an order too high for the file would gain; empty if none was tried."""
    higher = [c for c in candidates if c.fitted is not None and not c.order.fits_in_file]
    if not higher:
        return ""
    best = min(higher, key=lambda c: c.held_out_deg_s)
    gain = chosen.held_out_deg_s / max(best.held_out_deg_s, 1e-300)
    if gain < 1.0:
        return f"No higher order than the file's does better: the best, {best.order}, is {1 / gain:.2f} times worse."
    return (
        f"Of the higher orders {best.order} would be {gain:.2f} times better ({best.held_out_deg_s:.2g} deg/s); "
        f"the calibration file holds up to {FILE_ORDER}."
    )
