"""Pictures of an explanation: the budget over time, and the most likely causes of the actual error."""

from pathlib import Path
from typing import Any, Final

import numpy as np

from drd_tools.explain.results import Actual, Explanation
from drd_tools.limit.causes import GROUPS
from drd_tools.report.style import BLUE, GREEN, GREY, INK, ORANGE, PURPLE, SKY, TRUE_GREY, VERMILION, picture, tidy

# A group has the same colour in all pictures.
COLORS: Final = dict(
    zip(
        GROUPS,
        (
            *(SKY, "#004D7A", BLUE, "#7FD1B9", GREEN, VERMILION, "#8C564B"),
            *(ORANGE, "#E7969C", PURPLE, "#F0E442", "#5B4B8A", GREY, "#C7C7C7"),
        ),
        strict=True,
    )
)
MARKED_ROWS: Final = 60
SMALL: Final = 0.005  # of the panel's largest sigma: groups below it are combined


def budget_picture(file: Path, e: Explanation) -> None:
    """Draw position and heading over time: the height is one sigma, colours divide the variance. Raises OSError."""
    position, heading = np.array(e.position_m2), np.array(e.heading_deg2)
    largest_m = float(np.sqrt(position.sum(axis=1).max()))
    if e.actual is not None:
        largest_m = max(largest_m, max(e.actual.error_m, default=0.0))
    factor, unit = (1.0, "m") if largest_m >= 0.5 else (100.0, "cm")
    with picture(file, 10.0, 7.4) as figure:
        panels: Any = figure.subplots(2, 1, sharex=True)
        _stack(panels[0], e, factor * factor * position)
        _stack(panels[1], e, heading)
        if e.actual is not None:
            _error(panels[0], e.actual, factor * np.array(e.actual.error_m))
            _error(panels[1], e.actual, np.abs(e.actual.error_deg))
        for axes, title, shown in zip(panels, ("Position", "Heading"), (unit, "deg"), strict=True):
            axes.set_ylim(bottom=0.0)
            axes.margins(x=0.0)
            tidy(axes, title, y=f"1 sigma / {shown}")
        panels[1].set_xlabel("time / s")
        found = dict(zip(*(panels[0].get_legend_handles_labels()[k] for k in (1, 0)), strict=True))
        found |= dict(zip(*(panels[1].get_legend_handles_labels()[k] for k in (1, 0)), strict=True))
        figure.legend(found.values(), found.keys(), loc="outside lower center", ncols=5)


def _stack(axes: Any, e: Explanation, variances: Any) -> None:
    total = variances.sum(axis=1)
    share = np.divide(variances, total[:, None], out=np.zeros_like(variances), where=total[:, None] > 0.0)
    below = np.zeros(len(total))
    order = np.argsort(-variances[-1])
    names = [line.group for line in e.groups]
    rest = np.zeros(len(total))
    for k in order:
        height = np.sqrt(total) * share[:, k]
        if height.max() < SMALL * np.sqrt(total.max()):
            rest += height
            continue
        axes.fill_between(e.time_s, below, below + height, color=COLORS[names[k]], linewidth=0, label=names[k])
        below = below + height
    if rest.any():
        axes.fill_between(e.time_s, below, np.sqrt(total), color=TRUE_GREY, linewidth=0, label="the rest")


def _error(axes: Any, actual: Actual, error: Any) -> None:
    marker = "o" if len(actual.time_s) <= MARKED_ROWS else ""
    style: Any = {"color": "white", "linewidth": 3.2, "marker": marker, "markersize": 6}
    axes.plot(actual.time_s, error, **style)
    style |= {"color": INK, "linewidth": 1.4, "markersize": 4}
    axes.plot(actual.time_s, error, label="actual error", **style)


def parts_picture(file: Path, actual: Actual) -> None:
    """Draw the most likely parts of the actual error, with two sigma. Raises OSError."""
    parts = [p for p in actual.parts if p.position_sigma_m or p.heading_sigma_deg][::-1]
    factor, unit = (1.0, "m") if max(abs(p.position_m) for p in parts) >= 0.5 else (100.0, "cm")
    position = factor * np.array([(p.position_m, p.position_sigma_m) for p in parts])
    heading = np.array([(p.heading_deg, p.heading_sigma_deg) for p in parts])
    columns = (("Position, in the direction of its error", unit, position), ("Heading", "deg", heading))
    with picture(file, 10.0, 1.6 + 0.36 * len(parts)) as figure:
        panels: Any = figure.subplots(1, 2, sharey=True)
        for axes, (title, shown, figures) in zip(panels, columns, strict=True):
            places, (values, sigmas) = range(len(parts)), figures.T
            axes.axvline(0.0, color=GREY, linewidth=0.8)
            axes.barh(places, values, color=[COLORS.get(p.group, TRUE_GREY) for p in parts], height=0.7)
            axes.errorbar(values, places, xerr=2.0 * sigmas, fmt="none", color=INK, capsize=3, linewidth=1.2)
            tidy(axes, title, 6, x=f"part of the error / {shown}")
        panels[0].set_yticks(range(len(parts)), [p.group for p in parts])
