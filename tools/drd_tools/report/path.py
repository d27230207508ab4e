"""Pictures of a run: the path, and the estimate's error against its claimed bound."""

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from drd.arrays import Array
from drd_tools.report.style import BLUE, BOUND, DPI, GREY, INK, SKY, TRUE_GREY, VERMILION, save, styled, tidy, tidy_map

WIDTH_IN: Final = 10.0
HEIGHT_IN: Final = 5.8
LEFT: Final = 0.015
HEADER: Final = 0.87  # lower end of title and legend, as a fraction of the height
CAPTION_COLUMNS: Final = 125
LEGEND: Final[Any] = {
    "loc": "lower left",
    "borderaxespad": 0,
    "borderpad": 0,
    "frameon": False,
    "fontsize": 10,
    "handlelength": 1.8,
    "columnspacing": 1.6,
}


@dataclass(frozen=True)
class ErrorSeries:
    """Position errors over time with the claimed 99 % bound, shaded where `valid` is False. Each of shape (k,)."""

    time_s: Array
    error_m: Array
    bound_m: Array | None = None
    valid: npt.NDArray[np.bool_] | None = None


@dataclass(frozen=True)
class Mark:
    """A time marked in the picture of the errors, with its standard deviation."""

    time_s: float
    text: str
    std_s: float = 0.0


def path_picture(
    file: Path,
    truth_xy: Array,
    estimate_xy: Array,
    odometry_xy: Array | None = None,
    *,
    errors: ErrorSeries,
    marks: Sequence[Mark] = (),
    title: str = "",
    caption: str = "",
) -> None:
    """Write a PNG: paths seen from above on the left, the position error over time on the right.

    `truth_xy`, `estimate_xy`, `odometry_xy` (the wheels alone): shape (n, 2) each, n >= 1, m. Raises OSError if
    `file` cannot be written, ValueError if shapes do not match.
    """
    with styled():
        layout = ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.08, wspace=0.05, rect=(0, 0, 1, HEADER))
        figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN), dpi=DPI, facecolor="white", layout=layout)
        shown = [xy for xy in (truth_xy, estimate_xy, odometry_xy) if xy is not None]
        extent = np.ptp(np.concatenate(shown), axis=0)
        # The path's panel is as wide as the path requires, within limits that keep both panels readable.
        width = float(np.clip((extent[0] + 0.1) / (extent[1] + 0.1), 0.55, 1.3))
        path: Any
        error: Any
        path, error = figure.subplots(1, 2, width_ratios=(width, 1.25))
        _draw_paths(path, truth_xy, estimate_xy, odometry_xy)
        _draw_errors(error, errors)
        _draw_marks(error, marks)
        keys = [key for axes in (path, error) for key in axes.get_legend_handles_labels()[0]]
        figure.text(LEFT, 0.98, title, va="top", fontsize=15, fontweight="bold")
        figure.legend(handles=keys, ncols=len(keys), bbox_to_anchor=(LEFT, HEADER + 0.015), **LEGEND)
        figure.supxlabel(_wrapped(caption), x=LEFT, ha="left", fontsize=10, color="#555555", linespacing=1.4)
        save(figure, file)


def _draw_paths(axes: Any, truth_xy: Array, estimate_xy: Array, odometry_xy: Array | None) -> None:
    axes.plot(*truth_xy.T, color=TRUE_GREY, linewidth=6, solid_capstyle="round", label="true path")
    axes.plot(*estimate_xy.T, color=BLUE, linewidth=1.8, zorder=3, label="drd")
    if odometry_xy is not None:
        axes.plot(*odometry_xy.T, color=VERMILION, linewidth=1.6, dashes=(4, 2), label="wheels alone")
        _mark_end(axes, odometry_xy, VERMILION)
    start: Any = {"color": "none", "markeredgecolor": INK, "markeredgewidth": 1.6, "markersize": 14}
    axes.plot(*truth_xy[0], "o", zorder=5, label="start", **start)
    _mark_end(axes, truth_xy, INK, label="end")
    _mark_end(axes, estimate_xy, BLUE)
    axes.margins(0.08)
    tidy_map(axes, "Path, seen from above")


def _mark_end(axes: Any, xy: Array, color: str, label: str | None = None) -> None:
    style: Any = {"color": color, "markersize": 8, "markeredgecolor": "white", "markeredgewidth": 1.0}
    axes.plot(*xy[-1], "o", zorder=6, label=label, **style)


def _draw_errors(axes: Any, errors: ErrorSeries) -> None:
    time_s, error_m, bound_m, valid = errors.time_s, errors.error_m, errors.bound_m, errors.valid
    largest_m = float(np.max(error_m if bound_m is None else np.maximum(error_m, bound_m), initial=0.0))
    scale, unit = (100.0, "cm") if largest_m < 1.0 else (1.0, "m")
    if bound_m is not None:
        axes.fill_between(time_s, 0, scale * bound_m, color=BOUND, linewidth=0, label="99 % bound, as claimed")
        axes.plot(time_s, scale * bound_m, color=SKY, linewidth=1.4)
    axes.plot(time_s, scale * error_m, color=BLUE, linewidth=1.8)
    if valid is not None and not valid.all():
        whole_height = axes.get_xaxis_transform()
        style = {"color": GREY, "alpha": 0.3, "linewidth": 0, "label": "not valid"}
        axes.fill_between(time_s, 0, 1, where=~valid, transform=whole_height, **style)
    axes.set_ylim(bottom=0.0)
    axes.margins(x=0.0)
    tidy(axes, "Position error of drd", x="time / s", y=f"distance from the truth / {unit}")


def _draw_marks(axes: Any, marks: Sequence[Mark]) -> None:
    """Draw vertical lines with their texts, one below the other."""
    whole_height = axes.get_xaxis_transform()
    for k, mark in enumerate(marks):
        if mark.std_s:
            axes.axvspan(mark.time_s - mark.std_s, mark.time_s + mark.std_s, color=GREY, alpha=0.3, linewidth=0)
        axes.axvline(mark.time_s, color=INK, linewidth=1.2, dashes=(4, 2))
        is_late = mark.time_s > 0.5 * sum(axes.get_xlim())
        axes.annotate(
            mark.text, (mark.time_s, 0.97 - 0.07 * k), xycoords=whole_height, textcoords="offset points",
            xytext=(-4 if is_late else 4, 0), ha="right" if is_late else "left", va="top", fontsize=9,
            bbox={"color": "white", "alpha": 0.8, "pad": 1.0},
        )  # fmt: skip


def _wrapped(text: str) -> str:
    """Wrap into lines of about equal length."""
    lines = max(1, math.ceil(len(text) / CAPTION_COLUMNS))
    return textwrap.fill(text, min(CAPTION_COLUMNS, len(text) // lines + 12))
