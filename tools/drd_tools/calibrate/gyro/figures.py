"""The paper's figures 1, 2 and 3 for the user's own gyro."""

from pathlib import Path
from typing import Any

import numpy as np

from drd.arrays import Array
from drd_tools.calibrate.gyro.candidates import rate_levels, temperature_levels
from drd_tools.calibrate.gyro.data_sets import DataSets
from drd_tools.calibrate.gyro.error_function import ErrorFunction
from drd_tools.calibrate.gyro.evaluation import Evaluation
from drd_tools.evaluate.metrics import rms
from drd_tools.report.style import BLUE, BOUND, GREY, SERIES, VERMILION, picture, tidy

MOST_RATES = 5
POINTS = 200


def error_over_rate(file: Path, fitted: ErrorFunction, data: DataSets, residual_deg_s: float) -> float:
    """Draw figure 1: error against rate at a middle temperature, and the residual. Returns that temperature, degC."""
    groups = temperature_levels(data)
    middle = groups[len(groups) // 2]
    near = np.argmin(np.abs(data.temperature_c[:, None] - np.array(groups)), axis=1) == len(groups) // 2
    chosen, used = data.select(near), fitted.weights[near] > 0.0
    w = np.linspace(*fitted.rate_range_deg_s, POINTS)
    e = fitted.error_deg_s(w, middle)
    band = 2.0 * np.hypot(residual_deg_s, fitted.sigma_deg_s(w, middle))
    with picture(file, 10.0, 4.6) as figure:
        both: Any = figure.subplots(1, 2, gridspec_kw={"wspace": 0.08})
        for axes, curve, points in (
            (both[0], e, chosen.error_deg_s),
            (both[1], np.zeros(POINTS), fitted.residual_deg_s(chosen)),
        ):
            axes.fill_between(w - e, curve - band, curve + band, color=BOUND, linewidth=0, label="two sigma")
            axes.plot(w - e, curve, color=BLUE, linewidth=1.8, label=f"fit, order {fitted.order.rate} in rate")
            x, bars = chosen.table_rate_deg_s, 2.0 * chosen.sigma_deg_s
            style = {"color": VERMILION, "markersize": 5, "label": "data sets"}
            axes.errorbar(x[used], points[used], bars[used], fmt="o", linewidth=1.0, zorder=3, **style)
            if not used.all() and axes is both[0]:
                axes.plot(x[~used], points[~used], "x", color=GREY, label="rejected")
        label, unit = "rate of the table / deg/s", "error / deg/s"
        tidy(both[0], f"Error of the reading at {middle:.1f} degC", x=label, y=unit)
        tidy(both[1], "What the fit leaves (finer scale)", x=label, y=unit)
        both[0].legend()
    return middle


def error_over_temperature(file: Path, fitted: ErrorFunction, data: DataSets) -> None:
    """Draw figure 2: the error against the temperature at up to five rates."""
    groups = np.array(rate_levels(data))
    few = np.unique(np.round(np.linspace(0, len(groups) - 1, min(MOST_RATES, len(groups)))).astype(int))
    nearest = np.argmin(np.abs(data.table_rate_deg_s[:, None] - groups), axis=1)
    T = np.linspace(*fitted.temperature_range_c, POINTS)
    with picture(file, 10.0, 5.0) as figure:
        axes: Any = figure.subplots()
        for colour, k in zip(SERIES, few[::-1], strict=False):
            chosen, used = data.select(nearest == k), fitted.weights[nearest == k] > 0.0
            axes.plot(T, _error_at(fitted, float(groups[k]), T), color=colour, linewidth=1.6)
            label = f"{round(float(groups[k]), 1):g} deg/s"
            axes.plot(chosen.temperature_c[used], chosen.error_deg_s[used], "o", color=colour, label=label)
            axes.plot(chosen.temperature_c[~used], chosen.error_deg_s[~used], "x", color=colour)
        title = "Error of the reading at several rates: data sets (points) and fit (lines)"
        tidy(axes, title, x="temperature / degC", y="error / deg/s")
        figure.legend(loc="outside right center", title="rate of the table")


def _error_at(fitted: ErrorFunction, table_rate_deg_s: float, temperature_c: Array) -> Array:
    """Error at a true rate; the error function takes the reading, which includes the error. (1), (5)"""
    error = np.zeros_like(temperature_c)
    for _ in range(20):  # each gains a factor of about a hundred
        error = fitted.error_deg_s(table_rate_deg_s + error, temperature_c)
    return error


def before_and_after(file: Path, evaluation: Evaluation) -> None:
    """Draw figure 3: errors of unseen data sets at all rates and temperatures, (a) as read and (b) corrected."""
    data = evaluation.data
    values: tuple[Array, Array] = evaluation.before_deg_s, evaluation.after_deg_s
    ends = [1.12 * max(float(np.max(np.abs(v))), 1e-9) for v in values]
    titles = (
        f"a) before: rms {rms(values[0]):.3g} deg/s",
        f"b) after: rms {rms(values[1]):.3g} deg/s (scale {ends[0] / ends[1]:.0f} times finer)",
    )
    with picture(file, 10.5, 4.8) as figure:
        both: Any = figure.subplots(1, 2, gridspec_kw={"wspace": 0.08})
        both[0].axhspan(-ends[1], ends[1], color=BOUND, linewidth=0)
        for axes, value, end, title in zip(both, values, ends, titles, strict=True):
            axes.axhline(0.0, color=GREY, linewidth=1.0)
            style = {"c": data.temperature_c, "cmap": "viridis", "s": 22, "zorder": 3}
            points = axes.scatter(data.table_rate_deg_s, value, **style)
            axes.set_ylim(-end, end)
            tidy(axes, title, x="rate of the table / deg/s", y="error / deg/s")
        figure.colorbar(points, ax=both, label="temperature / degC", pad=0.015)
