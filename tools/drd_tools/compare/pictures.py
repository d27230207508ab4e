"""Pictures of a comparison: an overview, and each channel's mismatch over time, by covariate, and on the map."""

from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.colors import LinearSegmentedColormap, TwoSlopeNorm

from drd.arrays import Array
from drd_tools.compare.results import ChannelResult, Comparison, CovariateResult
from drd_tools.compare.text import COVARIATES, P_SHOWN, rate
from drd_tools.report.style import BLUE, BOUND, GREY, INK, MAP, SKY, TRUE_GREY, VERMILION, legend_below, picture, tidy

SHARES: Final = LinearSegmentedColormap.from_list("share", ("white", SKY, BLUE))
COLUMNS: Final = 4
ROBUST: Final = (2.0, 98.0)  # percentiles that a picture must show: a jump of the reference would flatten all else


def overview_picture(file: Path, c: Comparison) -> None:
    """Draw how far each channel exceeds noise, and which covariate predicts it. Raises OSError."""
    names = [n for n in COVARIATES if any(d.name == n for ch in c.channels for d in ch.covariates)]
    with picture(file, 11.0, 1.7 + 0.46 * len(c.channels)) as figure:
        ratios = (1.0, 2.7) if names else (1.0,)
        panels: Any = figure.subplots(1, len(ratios), width_ratios=ratios, squeeze=False)[0]
        _ratios(panels[0], c)
        if names:
            shares = np.array([[ch.covariate(n).share for n in names] for ch in c.channels])
            axes = panels[1]
            axes.imshow(np.clip(shares, 0.0, 1.0), cmap=SHARES, vmin=0.0, vmax=1.0, aspect="auto")
            for i, ch in enumerate(c.channels):
                for j, n in enumerate(names):
                    d = ch.covariate(n)
                    sure = d.p <= P_SHOWN
                    color = "white" if d.share > 0.6 else INK if sure or d.share > 0.3 else GREY
                    text = f"{max(d.share, 0.0):.2f}"
                    axes.text(
                        j, i, text, ha="center", va="center", color=color, fontweight="bold" if sure else "normal"
                    )
            axes.set_xticks(range(len(names)), [n.replace("yaw acc", "yaw\nacc") for n in names], fontsize=8.5)
            axes.set_yticks([])
            axes.spines[:].set_visible(False)
            axes.tick_params(length=0)
            axes.set_title("Share that the covariate predicts (bold: p ≤ 0.01)")


def _ratios(axes: Any, c: Comparison) -> None:
    places = range(len(c.channels))
    colors = [TRUE_GREY if ch.verdict == "nothing" else VERMILION for ch in c.channels]
    axes.barh(places, [ch.ratio for ch in c.channels], color=colors, height=0.65)
    largest = max(ch.ratio for ch in c.channels)
    for k, ch in enumerate(c.channels):
        axes.text(max(ch.ratio, 1.0) + 0.03 * max(largest, 2.0), k, f"{ch.ratio:.1f}", va="center", fontsize=10)
    axes.axvline(1.0, color=INK, linewidth=1.0, dashes=(4, 2))
    axes.set_xlim(0.0, 1.18 * max(largest, 2.0))
    axes.set_ylim(len(c.channels) - 0.5, -0.5)
    tidy(axes, "Mismatch", 5, x="rms / sigmas of noise (dashed: 1)")
    axes.set_yticks(places, [ch.title for ch in c.channels])
    axes.grid(visible=False, axis="y")


def channel_picture(file: Path, c: Comparison, ch: ChannelResult) -> None:
    """Draw one channel: blocks and their sum over time, curves of the covariates, and the map. Raises OSError."""
    covariates = [d for n in COVARIATES if n != "place" for d in ch.covariates if d.name == n]
    count = -(-(len(covariates) + 1) // COLUMNS) if covariates else 0
    with picture(file, 11.0, 3.5 + 2.9 * count) as figure:
        halves: Any = figure.subfigures(2, 1, height_ratios=(3.5, 2.9 * count)) if covariates else [figure]
        panels: Any = halves[0].subplots(1, 2 if covariates else 3)
        _over_time(panels[0], c, ch)
        _added(panels[1], c, ch)
        legend_below(halves[0], panels[0], 3)
        if covariates:
            _curves(halves[1], count, c, ch, covariates)
        else:
            _map(figure, panels[2], c, ch)


def _curves(figure: Any, count: int, c: Comparison, ch: ChannelResult, covariates: list[CovariateResult]) -> None:
    cells = figure.subplots(count, COLUMNS, squeeze=False).ravel().tolist()
    limits = _limits(ch, covariates)
    for k, (axes, d) in enumerate(zip(cells, covariates, strict=False)):
        _curve(axes, ch, d, limits)
        if k % COLUMNS == 0:
            axes.set_ylabel(rate(ch)[1])
        else:
            axes.tick_params(labelleft=False)
    _map(figure, cells[-1], c, ch)
    for axes in cells[len(covariates) : -1]:
        axes.set_visible(False)


def _over_time(axes: Any, c: Comparison, ch: ChannelResult) -> None:
    factor, unit = rate(ch)
    time, mean, sigma = np.array(c.time_s), factor * np.array(ch.block_mean), factor * np.array(ch.block_sigma)
    _band(axes, time, sigma)
    axes.axhline(0.0, color=GREY, linewidth=0.8)
    axes.plot(time, mean, ".", color=BLUE, markersize=5, label="block")
    _zoom(axes, mean, 2.0 * float(np.median(sigma)))
    axes.margins(x=0.01)
    tidy(axes, f"{ch.title[0].upper()}{ch.title[1:]}: recorded less simulated", 6, x="time / s", y=unit)


def _added(axes: Any, c: Comparison, ch: ChannelResult) -> None:
    sigma = np.array(ch.sum_sigma)
    ends = np.array(c.time_s) + 0.5 * np.array(c.length_s)
    _band(axes, ends, sigma)
    axes.axhline(0.0, color=GREY, linewidth=0.8)
    axes.plot(ends, ch.sum, color=BLUE, linewidth=1.8)
    axes.margins(x=0.01)
    tidy(axes, "Added up", 6, x="time / s", y=ch.unit)


def _band(axes: Any, x: Array, sigma: Array) -> None:
    axes.fill_between(x, -2.0 * sigma, 2.0 * sigma, color=BOUND, linewidth=0, label="noise, 2 sigma")
    axes.fill_between(x, -sigma, sigma, color=SKY, alpha=0.4, linewidth=0, label="noise, 1 sigma")


def _zoom(axes: Any, values: Array, least: float) -> None:
    low, high = np.percentile(values, ROBUST)
    low, high = min(low, -least), max(high, least)
    margin = 0.25 * (high - low)
    outside = int(((values < low - margin) | (values > high + margin)).sum())
    axes.set_ylim(low - margin, high + margin)
    if outside:
        text = f"{outside} block{'s' if outside > 1 else ''} outside"
        axes.text(0.99, 0.02, text, transform=axes.transAxes, ha="right", fontsize=9, color=GREY)


def _limits(ch: ChannelResult, covariates: list[CovariateResult]) -> tuple[float, float]:
    """Common limits, which ignore poorly determined ends of curves."""
    factor = rate(ch)[0]
    value, sigma, noise = (
        factor * np.concatenate([getattr(d, name) for d in covariates]) for name in ("value", "sigma", "noise_sigma")
    )
    known = sigma <= 3.0 * np.median(sigma)
    least = 2.0 * float(np.median(noise))
    low = min(float((value - sigma)[known].min()), -least)
    high = max(float((value + sigma)[known].max()), least)
    return low - 0.08 * (high - low), high + 0.08 * (high - low)


def _curve(axes: Any, ch: ChannelResult, d: CovariateResult, limits: tuple[float, float]) -> None:
    factor = rate(ch)[0]
    knots, value, sigma, noise = (np.array(v) for v in (d.knots, d.value, d.sigma, d.noise_sigma))
    _band(axes, knots, factor * noise)
    axes.axhline(0.0, color=GREY, linewidth=0.8)
    color = VERMILION if d.name in ch.named else BLUE if d.p <= P_SHOWN else GREY
    style: Any = {"capsize": 2.5, "linewidth": 1.3, "markersize": 4, "color": color}
    axes.errorbar(knots, factor * value, yerr=factor * sigma, fmt="o-", **style)
    axes.set_ylim(*limits)
    axes.set_xlabel(f"{d.name} / {d.unit}".replace("s2", "s²").replace("degC", "°C"))
    tidy(axes, "", 4)
    _title(axes, d.name, d)


def _title(axes: Any, name: str, d: CovariateResult | None) -> None:
    is_sure = d is not None and d.p <= P_SHOWN
    share = "" if d is None else f": {max(d.share, 0.0):.2f}"
    axes.set_title(f"{name}{share}", color=INK if is_sure else GREY, fontweight="bold" if is_sure else "normal")


def _map(figure: Any, axes: Any, c: Comparison, ch: ChannelResult) -> None:
    factor, unit = rate(ch)
    value = factor * np.array(ch.block_mean)
    largest = max(float(np.percentile(np.abs(value), 95.0)), 1e-12)
    axes.plot(c.x_m, c.y_m, color="#DDDDDD", linewidth=1.0, zorder=1)
    norm = TwoSlopeNorm(0.0, -largest, largest)
    dots = axes.scatter(c.x_m, c.y_m, c=value, s=14, cmap=MAP, norm=norm, zorder=2, linewidths=0)
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.08)
    place = next((d for d in ch.covariates if d.name == "place"), None)
    axes.set_xlabel("x / m")
    tidy(axes, "", 4)
    _title(axes, "place", place)
    bar = figure.colorbar(dots, ax=axes, pad=0.02, aspect=16)
    bar.outline.set_visible(False)
    bar.ax.tick_params(labelsize=8, color=GREY)
    bar.ax.set_title(unit, fontsize=8, fontweight="normal", loc="left", pad=4)
