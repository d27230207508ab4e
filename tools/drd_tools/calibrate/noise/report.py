"""Pictures and page of a gyro's noise: Allan deviation, warm-up, and conclusions."""

from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.ticker import LogLocator, NullFormatter

from drd_tools.calibrate.noise.allan import TERMS, K, N, shapes
from drd_tools.calibrate.noise.analysis import GyroNoise, unit_of
from drd_tools.calibrate.noise.text import DEG_H, HEADER, duration, rows, sentences, snippet
from drd_tools.calibrate.noise.warmup import block_means
from drd_tools.report.page import Page
from drd_tools.report.style import BLUE, GREEN, GREY, INK, ORANGE, PURPLE, SKY, VERMILION, picture, tidy

COLORS: Final = (PURPLE, GREEN, ORANGE, VERMILION, SKY)


def allan_picture(file: Path, result: GyroNoise) -> None:
    """Write a PNG: the measured Allan deviation with its 90 % limits, the model, and its visible terms.

    Raises OSError.
    """
    curve = result.curve
    tau_s = np.geomspace(curve.tau_s[0], curve.tau_s[-1], 200)
    parts = shapes(tau_s) * result.fit.squares
    model = np.sqrt(parts.sum(axis=1)) * DEG_H
    n, k = result.filter.angle_random_walk, result.filter.rate_random_walk
    with picture(file, 10.0, 5.6) as figure:
        axes: Any = figure.subplots()
        deviation = curve.deviation * DEG_H
        limits = np.abs(np.stack([curve.low, curve.high]) * DEG_H - deviation)
        axes.errorbar(curve.tau_s, deviation, limits, fmt="o", ms=4, color=INK, lw=1.2, label="measured, 90 % limits")
        axes.plot(tau_s, model, color=BLUE, lw=2.2, zorder=3, label="model")
        for term in (t for t in result.fit.terms if result.intervals[t].is_visible):
            name = f"{unit_of(term)[0]} {TERMS[term]}"
            axes.plot(tau_s, np.sqrt(parts[:, term]) * DEG_H, color=COLORS[term], lw=1.3, ls="--", label=name)
        filtered = np.sqrt(shapes(tau_s)[:, N] * n**2 + shapes(tau_s)[:, K] * k**2) * DEG_H
        axes.plot(tau_s, filtered, color=GREY, lw=1.6, ls=":", label="the filter's noise profile")
        axes.set_xscale("log")
        axes.set_yscale("log")
        low = float(min(deviation.min(), model.min()))
        axes.set_ylim(0.4 * low, 2.0 * float(max(deviation.max(), model.max())))
        title = f"Allan deviation of {duration(result.log.duration_s)} at standstill"
        tidy(axes, title, x="averaging time / s", y="Allan deviation / (deg/h)")
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(LogLocator(numticks=12))
            axis.set_minor_formatter(NullFormatter())
        axes.legend(loc="upper center")


def warm_up_picture(file: Path, result: GyroNoise) -> None:
    """Write a PNG: bias over time, fitted warm-up and the part left out; temperature below, if known.

    Raises OSError.
    """
    whole = result.whole
    time_s, rate_rad_s, temperature_c = block_means(whole)
    minutes = time_s / 60.0
    ratios = (1,) if temperature_c is None else (2, 1)
    with picture(file, 10.0, 4.4 if temperature_c is None else 6.2) as figure:
        panels: Any = figure.subplots(len(ratios), 1, sharex=True, squeeze=False, height_ratios=ratios)[:, 0]
        bias = panels[0]
        bias.plot(minutes, rate_rad_s * DEG_H, ".", color=INK, ms=5, label=f"means over {time_s[1] - time_s[0]:.3g} s")
        if result.warm_up is not None:
            bias.plot(minutes, result.warm_up.at(time_s) * DEG_H, color=BLUE, lw=2.0, label="fitted warm-up")
            if 0.0 < result.wait_s < whole.duration_s:
                bias.axvline(result.wait_s / 60.0, color=VERMILION, lw=1.4, ls="--", label="settled")
        for axes in panels:
            if result.left_out_s:
                label = "left out" if axes is bias else None
                axes.axvspan(0.0, result.left_out_s / 60.0, color=GREY, alpha=0.18, lw=0, label=label)
        bias.legend(loc="best")
        tidy(bias, "The bias over the log", y="rate / (deg/h)")
        if temperature_c is not None:
            panels[1].plot(minutes, temperature_c, color=VERMILION, lw=1.6)
            tidy(panels[1], "The gyro's temperature", 5, y="temperature / degC")
        panels[-1].set_xlabel("time / min")
        panels[-1].set_xlim(0.0, whole.duration_s / 60.0)


def noise_page(file: Path, result: GyroNoise, allan_png: Path, warm_up_png: Path) -> None:
    """Write the HTML page. Raises OSError."""
    page = Page(f"Gyro noise: {Path(result.whole.file).name}", sentences(result))
    page.heading("Noise terms")
    page.table(HEADER, rows(result), text_columns=(1, 2, 3, 4))
    page.text(
        "Values are fitted to the overlapping Allan deviation. The intervals hold 90 of 100 gyros' true values if the "
        "noise is of this form; an upper bound holds 95. They come from simulated logs of the same length, and so "
        "allow for neighbouring points of the curve being alike."
    )
    page.picture(
        allan_png,
        "Allan deviation: the difference between the means over consecutive averaging times. The dotted line "
        "is what the filter will assume.",
    )
    page.heading("Warm-up")
    page.picture(warm_up_png, "The bias from the log's start, and the gyro's temperature where the log has it.")
    page.heading("For the configuration")
    page.code(snippet(result))
    page.save(file)
