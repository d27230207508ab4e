"""Pictures of the wheel calibration."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from drd_tools.calibrate.wheels.drive import Drive
from drd_tools.calibrate.wheels.fit import WheelFit
from drd_tools.calibrate.wheels.heldout import HeldOut, aligned_path
from drd_tools.calibrate.wheels.umbmark import Returns, Umbmark
from drd_tools.report.style import BLUE, GREY, INK, TRUE_GREY, VERMILION, legend_below, picture, short, tidy, tidy_map

ROW_IN: Final = 0.28
NAME_LETTERS: Final = 38


def paths_picture(file: Path, panels: Sequence[tuple[str, Drive, WheelFit]]) -> None:
    """Draw the paths of nominal wheels, calibrated wheels and reference, one panel per drive. Raises OSError."""
    with picture(file, 10.0, 5.4) as figure:
        all_axes: Any = figure.subplots(1, len(panels), squeeze=False)[0]
        for axes, (title, drive, fit) in zip(all_axes, panels, strict=True):
            axes.plot(*drive.reference_xy_m.T, color=TRUE_GREY, linewidth=5, label="reference")
            nominal, calibrated = (aligned_path(drive, w, fit.mounting)[0] for w in (drive.nominal, fit.wheels))
            axes.plot(*nominal.T, color=VERMILION, linewidth=1.4, dashes=(4, 2), label="nominal wheels")
            axes.plot(*calibrated.T, color=BLUE, linewidth=1.6, label="calibrated wheels")
            axes.plot(*drive.reference_xy_m[0], "o", color="none", markeredgecolor=INK, markersize=11, label="start")
            tidy_map(axes, f"{title}\n{short(drive.name, NAME_LETTERS)}", 6)
        legend_below(figure, all_axes[0], 4)


def held_out_picture(file: Path, figures: Sequence[HeldOut]) -> None:
    """Draw the error of each held-out drive, before and after, in position and heading. Raises OSError."""
    with picture(file, 10.0, 1.7 + ROW_IN * len(figures)) as figure:
        both: Any = figure.subplots(1, 2, sharey=True)
        rows = np.arange(len(figures))[::-1]
        position_m = np.array([(f.nominal.rms_m, f.calibrated.rms_m) for f in figures])
        heading_rad = np.array([(f.nominal.end_heading_rad, f.calibrated.end_heading_rad) for f in figures])
        panels = (
            ("Position, rms along the way", "m", position_m),
            ("Heading at the end", "deg", np.degrees(np.abs(heading_rad))),
        )
        for axes, (title, unit, values) in zip(both, panels, strict=True):
            axes.hlines(rows, values.min(axis=1), values.max(axis=1), color=TRUE_GREY, linewidth=2)
            axes.plot(values[:, 0], rows, "o", color=VERMILION, label="nominal wheels")
            axes.plot(values[:, 1], rows, "o", color=BLUE, label="calibrated without this recording")
            if values.max() > 30.0 * max(float(np.median(values[:, 1])), 1e-9):
                axes.set_xscale("log")
            else:
                axes.set_xlim(left=0.0)
            tidy(axes, title, 6, x=f"error / {unit}")
            axes.set_yticks(rows, [short(f.drive.name, NAME_LETTERS) for f in figures], fontsize=8)
        legend_below(figure, both[0], 2)


def returns_picture(file: Path, returns: Returns, result: Umbmark) -> None:
    """Draw UMBmark's return positions cw and ccw, their centroids, and the residuals. Raises OSError."""
    with picture(file, 7.5, 6.0) as figure:
        axes: Any = figure.subplots()
        axes.axhline(0.0, color=GREY, linewidth=0.8)
        axes.axvline(0.0, color=GREY, linewidth=0.8)
        sides = (("cw", returns.cw_m, VERMILION, "v"), ("ccw", returns.ccw_m, BLUE, "^"))
        for k, (name, runs_m, color, marker) in enumerate(sides):
            predicted_m = runs_m.mean(axis=0) - result.misfit_m[k]
            corrected_m = runs_m - predicted_m
            axes.plot(*runs_m.T, marker, color=color, markersize=6, linestyle="none", label=f"{name}, as driven")
            axes.plot(*runs_m.mean(axis=0), marker, color="none", markeredgecolor=color, markersize=15)
            style: Any = {"color": "white", "markeredgecolor": color, "markersize": 5, "linestyle": "none"}
            axes.plot(*corrected_m.T, marker, **style, label=f"{name}, less what the calibration explains")
            axes.plot(*zip((0.0, 0.0), runs_m.mean(axis=0), strict=True), color=color, linewidth=1.0, dashes=(3, 3))
        tidy_map(axes, "Return-position errors (large marks: centroids)")
        legend_below(figure, axes, 2)
