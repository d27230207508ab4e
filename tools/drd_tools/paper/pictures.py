"""Pictures of `drd paper`."""

from pathlib import Path
from typing import Any, Final

import numpy as np

from drd_tools.paper.printed import TABLE_II_CM
from drd_tools.paper.results import Results
from drd_tools.paper.studies import STATES
from drd_tools.paper.text import HEADINGS
from drd_tools.report.style import BLUE, GREEN, GREY, INK, ORANGE, SERIES, TRUE_GREY, VERMILION, picture, tidy, tidy_map

COLORS: Final = (VERMILION, ORANGE, GREEN, BLUE)  # of the cells


def draw_all(results: Results, folder: Path) -> list[Path]:
    """Write path.png, table2.png, figure3.png, onway.png and variances.png. Raises OSError."""
    drawn = {"path": (_path, 5.0), "table2": (_table2, 4.8), "figure3": (_figure3, 4.4), "onway": (_on_the_way, 4.4)}
    drawn["variances"] = (_variances, 4.4)
    files = [folder / f"{name}.png" for name in drawn]
    for file, (draw, height_in) in zip(files, drawn.values(), strict=True):
        with picture(file, 10.0, height_in) as figure:
            draw(figure, results)
    return files


def _path(figure: Any, results: Results) -> None:
    """Draw the whole path, and its end enlarged, where the errors are visible."""
    axes = figure.subplots(1, 2)
    for whole, panel in zip((True, False), axes, strict=True):
        panel.plot(*results.example_true_m.T, color=TRUE_GREY, linewidth=5, label="true path")
        if whole:
            panel.plot(*results.via_m.T, "+", color=INK, markersize=13, zorder=4, label="via points")
        for cell, path in enumerate(results.example_m):
            panel.plot(*path.T, color=COLORS[cell], linewidth=1.5, label=HEADINGS[cell])
            panel.plot(*path[-1], "o", color=COLORS[cell], markersize=7, markeredgecolor="white", zorder=5)
        panel.plot(*results.example_true_m[-1], "o", color="none", markeredgecolor=INK, markersize=13, label="true end")
        tidy_map(panel, "Run 1, first gyro" if whole else "Its end")
    axes[1].set_aspect("equal", adjustable="box")
    ends = np.vstack([results.example_m[:, -1], results.example_true_m[-1:]])
    middle, half = ends.mean(axis=0), 0.75 * max(0.2, float(np.ptp(ends, axis=0).max()))
    axes[1].set(xlim=(middle[0] - half, middle[0] + half), ylim=(middle[1] - half, middle[1] + half))
    axes[0].legend(loc="center")


def _table2(figure: Any, results: Results) -> None:
    """Draw our errors as bars with the spread of the gyros, the paper's averages as marks."""
    axes = figure.subplots()
    n, ours = results.runs_each_way, 100.0 * results.return_m
    for group, (runs, printed) in enumerate(((slice(0, n), TABLE_II_CM[:5]), (slice(n, 2 * n), TABLE_II_CM[5:]))):
        mean = ours[:, runs].mean(axis=1)
        low, high = np.percentile(mean, (5.0, 95.0), axis=0)
        for cell, color in enumerate(COLORS):
            at, value = cell + 0.4 * group - 0.2, mean[:, cell].mean()
            spread = [[value - low[cell]], [high[cell] - value]]
            style: Any = {"color": color, "alpha": 1.0 if group == 0 else 0.6, "width": 0.36}
            axes.bar(at, value, yerr=spread, error_kw={"ecolor": INK, "capsize": 3, "elinewidth": 1}, **style)
            axes.plot(at, printed[:, cell].mean(), "D", color=INK, markeredgecolor="white", markersize=8, zorder=6,
                      label="paper, average of five runs" if cell == group == 0 else None)  # fmt: skip
            axes.text(at, value * 1.02 + 0.3, f"{value:.0f} ", ha="right", va="bottom", fontsize=9)
    axes.set_yscale("log")
    axes.legend(loc="upper right")
    title = "Table II: left bars clockwise, right bars counter-clockwise; whiskers 5 % to 95 % of the gyros"
    tidy(axes, title, y="return position error / cm")
    axes.set_xticks(range(len(HEADINGS)), HEADINGS)
    axes.grid(visible=False, axis="x")


def _figure3(figure: Any, results: Results) -> None:
    rate, temperature, *errors = results.figure3.T
    before, after = figure.subplots(1, 2)
    for panel, error, title in zip(
        (before, after), errors, ("a. without compensation", "b. with compensation"), strict=True
    ):
        for color, t in zip(SERIES, np.unique(np.round(temperature)), strict=False):
            here = np.round(temperature) == t
            order = np.argsort(rate[here])
            panel.plot(rate[here][order], error[here][order], ".-", color=color, linewidth=1, label=f"{t:.0f} degC")
        rms = np.sqrt(np.mean(error**2))
        tidy(panel, f"{title}: {rms:.3g} deg/s rms", x="table rate / deg/s", y="error / deg/s")
    before.legend(ncols=2, fontsize=9)


def _on_the_way(figure: Any, results: Results) -> None:
    axes = figure.subplots()
    seconds = np.arange(results.trace_m.shape[2])
    for cell, color in enumerate(COLORS):
        low, middle, high = 100.0 * results.trace_m[:, cell]
        axes.fill_between(seconds, low, high, color=color, alpha=0.15, linewidth=0)
        axes.plot(seconds, middle, color=color, linewidth=1.8, label=HEADINGS[cell])
    axes.set_ylim(bottom=0.0)
    axes.legend(loc="upper left")
    axes.margins(x=0.0)
    title = "Position error on the way: median and 5 % to 95 % of all runs"
    tidy(axes, title, x="time / s", y="position error / cm")


def _variances(figure: Any, results: Results) -> None:
    axes = figure.subplots()
    position = np.hypot(*results.variance_sigma[:, :2].T)
    curves = {"position": position, **dict(zip(STATES, results.variance_sigma.T, strict=True))}
    for name, (color, dashes) in _VARIANCE_LINES.items():
        curve = curves[name]
        relative = curve / (curve[0] or curve.max())
        axes.plot(results.variance_time_s, relative, color=color, linewidth=1.6, dashes=dashes, label=name)
    axes.set_ylim(bottom=3e-4)
    axes.set_yscale("log")
    axes.legend(ncols=3, fontsize=9)
    axes.margins(x=0.0)
    title = (
        "The filter's standard deviations on three laps, relative to their start (position, heading: to their largest)"
    )
    tidy(axes, title, x="time / s", y="standard deviation, relative")


_VARIANCE_LINES: Final[dict[str, tuple[str, tuple[float, ...]]]] = {
    "position": (GREY, (1, 0)),
    "heading": (INK, (1, 0)),
    "right scale": (GREEN, (1, 0)),
    "left scale": (GREEN, (3, 2)),
    "tread": (VERMILION, (1, 0)),
    "gyro scale": (ORANGE, (1, 0)),
    "gyro bias": (BLUE, (1, 0)),
}
