"""Pictures of an evaluation: path, error over time, and growth of the error against covariates."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from drd.arrays import Array
from drd_tools.evaluate.consistency import SIGMA_99
from drd_tools.evaluate.growth import Windows, binned
from drd_tools.evaluate.results import Run
from drd_tools.report.style import (
    BLUE,
    BOUND,
    GREY,
    INK,
    SERIES,
    SKY,
    TRUE_GREY,
    legend_below,
    picture,
    short,
    tidy,
    tidy_map,
)

MARKED_ROWS: Final = 60  # a reference of at most so many rows is drawn as points


def path_picture(file: Path, runs: Sequence[tuple[str, Run]]) -> None:
    """Draw a reference and one or more estimates, seen from above; `runs` are labelled. Raises OSError."""
    first = runs[0][1].series
    extent = np.ptp(np.concatenate([first.reference_m, *(r.series.estimate_m for _, r in runs)]), axis=0)
    height = float(np.clip(8.0 * (extent[1] + 0.01) / (extent[0] + 0.01), 3.6, 7.5)) + 1.0
    with picture(file, 8.5, height) as figure:
        axes: Any = figure.subplots()
        is_points = len(first.time_s) <= MARKED_ROWS
        style: Any = {"marker": "o", "markersize": 9, "linestyle": "none"} if is_points else {"linewidth": 5}
        axes.plot(*first.reference_m.T, color=TRUE_GREY, label="reference", **style)
        for (label, run), look in zip(runs, _looks(len(runs)), strict=True):
            axes.plot(*run.series.estimate_m.T, marker="." if is_points else "", label=label, **look)
            axes.plot(
                *run.series.estimate_m[-1], "o", color=look["color"], markeredgecolor="white", markersize=8, zorder=5
            )
        axes.plot(*first.reference_m[-1], "o", color=INK, markeredgecolor="white", markersize=8, label="end", zorder=4)
        ring: Any = {"color": "none", "markeredgecolor": INK, "markeredgewidth": 1.5, "markersize": 13}
        axes.plot(*first.reference_m[0], "o", label="start", zorder=6, **ring)
        tidy_map(axes, f"Path, seen from above: {short(runs[0][1].name)}")
        legend_below(figure, axes, min(4, len(runs) + 3))


def error_picture(file: Path, runs: Sequence[tuple[str, Run]]) -> None:
    """Draw errors along and across the track and of the heading over time, with claimed sigmas. Raises OSError."""
    with picture(file, 10.0, 7.6) as figure:
        panels: Any = figure.subplots(3, 1, sharex=True)
        largest_m = max(float(np.abs(r.series.error[:, :2]).max()) for _, r in runs)
        scale, unit = (1.0, "m") if largest_m >= 0.5 else (100.0, "cm")
        rows = (
            ("Along the track", scale, unit),
            ("Across the track, to the left", scale, unit),
            ("Heading", 1.0, "deg"),
        )
        for k, (axes, (title, factor, shown)) in enumerate(zip(panels, rows, strict=True)):
            axes.axhline(0.0, color=GREY, linewidth=0.8)
            for (label, run), look in zip(runs, _looks(len(runs)), strict=True):
                s = run.series
                if s.sigma is not None and len(runs) == 1:
                    _claim(axes, s.time_s, factor * s.sigma[:, k])
                marker = "o" if len(s.time_s) <= MARKED_ROWS else ""
                axes.plot(s.time_s, factor * s.error[:, k], marker=marker, label=label, **look)
            axes.margins(x=0.0)
            tidy(axes, title, y=f"error / {shown}")
        panels[-1].set_xlabel("time / s")
        legend_below(figure, panels[0], 4)


def _claim(axes: Any, time_s: Array, sigma: Array) -> None:
    wide = SIGMA_99 * sigma
    axes.fill_between(time_s, -wide, wide, color=BOUND, linewidth=0, label="99 %, as claimed")
    axes.fill_between(time_s, -sigma, sigma, color=SKY, alpha=0.45, linewidth=0, label="1 sigma, as claimed")


def growth_picture(file: Path, windows: Windows) -> None:
    """Draw the growth of heading and along-track error against temperature, yaw rate and speed. Raises OSError."""
    covariates = [("yaw rate / deg/s", windows.rate_deg_s), ("speed / m/s", windows.speed_m_s)]
    if windows.temperature_c is not None:
        covariates.insert(0, ("temperature / degC", windows.temperature_c))
    growths = (("Heading", windows.heading_deg_s, 1.0, "deg/s"), ("Along the track", windows.along_m_s, 1000.0, "mm/s"))
    with picture(file, 10.0, 6.6) as figure:
        panels: Any = figure.subplots(2, len(covariates), sharex="col", sharey="row")
        for k, (title, growth, factor, unit) in enumerate(growths):
            # Rare jumps of the reference would otherwise set the scale.
            low, high = np.percentile(factor * growth, (1.0, 99.0))
            for axes, (name, covariate) in zip(panels[k], covariates, strict=True):
                axes.axhline(0.0, color=GREY, linewidth=0.8)
                axes.plot(covariate, factor * growth, ".", color=TRUE_GREY, markersize=3, label="one window")
                means = binned(covariate, factor * growth)
                style: Any = {"color": BLUE, "capsize": 3, "linewidth": 1.4, "markersize": 5}
                axes.errorbar(*means[:, :2].T, yerr=means[:, 2], fmt="o-", label="mean, with standard error", **style)
                is_first = axes is panels[k, 0]
                low = min(low, float((means[:, 1] - means[:, 2]).min()))
                high = max(high, float((means[:, 1] + means[:, 2]).max()))
                labels = {"x": name if k == len(growths) - 1 else "", "y": f"error growth / {unit}" if is_first else ""}
                tidy(axes, title if is_first else "", 5, **labels)
            panels[k, 0].set_ylim(low - 0.1 * (high - low) - 1e-9, high + 0.1 * (high - low) + 1e-9)
        legend_below(figure, panels[0, 0], 2)


def _looks(count: int) -> list[dict[str, Any]]:
    """Line styles; dashed after the first, so that equal lines do not hide each other."""
    dashes: list[Any] = ["-", (0, (5, 3)), (0, (2, 2)), (0, (6, 2, 1, 2))]
    return [
        {"color": SERIES[k % len(SERIES)], "linestyle": dashes[min(k, len(dashes) - 1)], "linewidth": 1.5}
        for k in range(count)
    ]
