"""Picture of the emerging motion."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from drd_tools.mujoco_world.measure import TURNING_RAD_S, Blocks, Manoeuvre
from drd_tools.mujoco_world.world import Motion
from drd_tools.report.style import BLUE, GREY, SKY, TRUE_GREY, VERMILION, draw_path, picture, tidy

TIGHTEST_PER_M: Final = 2.5
SPOT_PER_M: Final = 3.0  # where turns on the spot are drawn


def draw(
    file: Path, title: str, motion: Motion, blocks: Blocks, found: Sequence[Manoeuvre], track_m: float, expected: float
) -> None:
    """Draw the path on the left; effective tread and centre of rotation on the right. Raises OSError.

    `expected`: ratio of effective tread and track for Coulomb friction.
    """
    with picture(file, 11.0, 6.6) as figure:
        figure.suptitle(title, x=0.012, ha="left", fontsize=14, fontweight="bold")
        sides: Any = figure.subfigures(1, 2, width_ratios=(1.0, 1.15))
        draw_path(sides[0].subplots(), motion.x_m, motion.y_m, "True path of the middle between the wheels")
        upper, lower = sides[1].subplots(2, 1)
        _draw_tread(upper, blocks, found, track_m, expected)
        _draw_centre(lower, blocks)


def _draw_tread(axes: Any, blocks: Blocks, found: Sequence[Manoeuvre], track_m: float, expected: float) -> None:
    v, w = blocks.speed_m_s, blocks.rate_rad_s
    turning = np.abs(w) > TURNING_RAD_S
    curvature = np.abs(w[turning]) / np.maximum(np.abs(v[turning]), 1e-3)
    ratio = (blocks.right_m_s - blocks.left_m_s)[turning] / w[turning] / track_m
    shown = curvature < TIGHTEST_PER_M
    axes.plot(curvature[shown], ratio[shown], ".", color=SKY, markersize=3, alpha=0.6)
    for side, color, name in ((1.0, BLUE, "left"), (-1.0, VERMILION, "right")):
        turns = [m for m in found if m.kind != "straight" and m.turned_rad * side > 0.0]
        at = [min(abs(m.curvature_per_m), TIGHTEST_PER_M) if m.kind[0] == "b" else SPOT_PER_M for m in turns]
        marker = "<" if side > 0 else ">"
        axes.plot(at, [m.tread_m / track_m for m in turns], marker, color=color, markersize=6, label=name)
    axes.axhline(expected, color=GREY, linewidth=1.2, dashes=(4, 2), zorder=0, label="ideal friction")
    axes.set_xlim(0.0, SPOT_PER_M + 0.15)
    middle = [m.tread_m / track_m for m in found if m.kind != "straight"] or [expected]
    low, high = min(*middle, expected), max(*middle, expected)
    axes.set_ylim(low - 0.1, high + 0.1)
    axes.set_xlabel("|curvature| / (1/m); spot: turns in place")
    axes.legend(
        loc="lower right", bbox_to_anchor=(1.0, 0.99), borderaxespad=0.0, ncols=3, columnspacing=1.0, handletextpad=0.3
    )
    tidy(axes, "Effective tread / track")
    ticks = np.arange(0.0, TIGHTEST_PER_M + 0.1, 0.5)
    axes.set_xticks([*ticks, SPOT_PER_M], [*(f"{t:g}" for t in ticks), "spot"])


def _draw_centre(axes: Any, blocks: Blocks) -> None:
    v, w = blocks.speed_m_s, blocks.rate_rad_s
    ahead_m = -blocks.lateral_m_s / np.where(np.abs(w) > TURNING_RAD_S, w, np.nan)
    axes.axhline(0.0, color=TRUE_GREY, linewidth=0.8, zorder=0)
    for side, color in ((1.0, BLUE), (-1.0, VERMILION)):
        rows = w * side > TURNING_RAD_S
        axes.plot(v[rows] * w[rows] * side, ahead_m[rows], ".", color=color, markersize=3, alpha=0.6)
    known = ahead_m[np.isfinite(ahead_m)]
    if len(known):
        low, high = np.percentile(known, (2.0, 98.0))
        axes.set_ylim(min(low, -0.05) - 0.05, max(high, 0.05) + 0.05)
    axes.set_xlabel("speed times yaw rate / (m/s²)")
    tidy(axes, "Centre of rotation, ahead of the middle / m", ticks=6)
