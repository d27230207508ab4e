"""Pictures of a fleet: all robots and constants in one, and trends of single robots."""

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
from matplotlib import colormaps
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

from drd.arrays import Array
from drd_tools.fleet.events import Event
from drd_tools.fleet.series import CONSTANTS, S_PER_DAY
from drd_tools.fleet.statistics import Fitted
from drd_tools.report.style import BLUE, BOUND, GREEN, GREY, ORANGE, SERIES, VERMILION, picture, tidy

LABELLED: Final = 60  # most robots whose names fit
COLOURS: Final = "RdBu_r"


def overview(file: Path, robots: Sequence[str], names: Sequence[str], changes: Array) -> None:
    """Draw all robots (columns) and constants (rows): `changes` (constants, robots), in prior sigmas of a change."""
    with picture(file, 12.0, 1.4 + 0.32 * len(names)) as figure:
        axes: Any = figure.subplots()
        colours = colormaps[COLOURS].with_extremes(bad="#D8D8D8")
        image = axes.imshow(changes, aspect="auto", cmap=colours, vmin=-1.0, vmax=1.0, interpolation="nearest")
        axes.set_yticks(range(len(names)), [CONSTANTS[n].label for n in names])
        if len(robots) <= LABELLED:
            axes.set_xticks(range(len(robots)), robots, rotation=90, fontsize=7)
        else:
            axes.set_xlabel(f"{len(robots)} robots, the most urgent on the left")
        axes.set_title("Change of each robot since its first recordings")
        bar = figure.colorbar(image, ax=axes, pad=0.01)
        bar.set_label("of a typical change", color=GREY)


def trend(file: Path, fitted: Fitted, robot: str, events: Sequence[Event]) -> None:
    """Draw a robot's constant: recordings by place, level with 90 % band, changes, maintenance, other robots."""
    log, p, c = fitted.log, fitted.population, fitted.log.constant
    number = log.robots.index(robot)
    rows, line = log.rows(number), fitted.trends[number]
    with picture(file, 10.0, 3.2) as figure:
        axes: Any = figure.subplots()
        _others(axes, fitted, number)
        own = log.value[rows] - p.shared(log)[rows]
        for k, place in enumerate(np.unique(log.place[rows])):
            at = log.place[rows] == place
            style: Any = {"color": SERIES[k % len(SERIES)], "fmt": "o", "markersize": 3.5, "elinewidth": 0.7}
            name = log.places[place] or "recordings"
            half = c.factor * log.sigma[rows][at]
            axes.errorbar(times(log.day[rows][at]), c.factor * own[at], half, label=name, **style)
        for _, s, e in line.segments:
            at = slice(s, e + 1)
            level, half = c.factor * line.level[at], c.factor * 1.645 * line.sigma[at]
            axes.fill_between(times(log.day[rows][at]), level - half, level + half, color=BOUND, linewidth=0)
            axes.plot(times(log.day[rows][at]), level, color=BLUE, linewidth=2.0)
        for event in events:
            axes.axvspan(*times(np.array([event.low, event.high])), color=VERMILION, alpha=0.25, linewidth=0)
            if event.maintenance is not None:
                axes.axvline(times(np.array([event.maintenance.day]))[0], color=GREEN, linewidth=1.2, dashes=(4, 2))
        tidy(axes, f"{robot}: {c.label}", y=c.unit)
        dates: Any = AutoDateLocator  # neither it nor its formatter is typed
        locator, formatter = dates(), cast(Any, ConciseDateFormatter)
        axes.xaxis.set_major_locator(locator)
        axes.xaxis.set_major_formatter(formatter(locator))
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))


def _others(axes: Any, fitted: Fitted, number: int) -> None:
    """Shade the range of nine of ten of the other robots' levels."""
    factor = fitted.log.constant.factor
    level = [t.level[-1] for i, t in enumerate(fitted.trends) if i != number and len(t.level)]
    if len(level) > 1:
        low, high = np.quantile(level, (0.05, 0.95))
        axes.axhspan(factor * low, factor * high, color=ORANGE, alpha=0.12, linewidth=0, label="nine of ten others")


def times(days: Array) -> list[datetime]:
    """Convert days since 1970 to datetimes for matplotlib."""
    return [datetime.fromtimestamp(float(day) * S_PER_DAY, UTC) for day in days]
