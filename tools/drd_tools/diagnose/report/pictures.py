"""Pictures of a diagnosis: the paths, each finding with its evidence, the residual over time, and held-out data."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from drd.arrays import Array
from drd_tools.diagnose.conclude.outcome import BAND_SIGMAS
from drd_tools.diagnose.report.place_map import place_map
from drd_tools.diagnose.report.text import named_quantity, pretty
from drd_tools.diagnose.results import Scatter
from drd_tools.diagnose.series import Bar, Drive, Gain, Line, Mismatch, Paths, Residual, Spread
from drd_tools.report.style import BLUE, BOUND, GREEN, GREY, INK, ORANGE, TRUE_GREY, VERMILION, picture, short, tidy

WIDTH_IN: Final = 10.0  # a page's, inches
MOST_PATHS: Final = 6  # more would hide each other
MARKED_ROWS: Final = 60  # a reference of so few rows is drawn as points
ROBUST: Final = (2.0, 98.0)  # percentiles that a picture shows: one outlier would flatten all else
MOST_BARRED: Final = 12  # recordings, for legible bars; those of a hundred would be taller than a PNG may be
LONGEST_BAR: Final = 1.6  # of the value before; a longer one is cut, with its number beside it
ALONE: Final[dict[str, Any]] = {"color": BLUE, "linewidth": 1.6, "zorder": 3}  # the nominal path, if it is the only one
FEW: Final = 4  # labels that fit on an axis
WORSE: Final = 1.02  # times the value before: less may be chance
Windows = Sequence[Sequence[float]]


def paths_picture(file: Path, recordings: Sequence[Drive], windows: Windows = ()) -> None:
    """Draw each path from above; with a reference, also the distance from it over time. Raises OSError.

    `windows` (s) of findings are marked on the first recording, to which they belong.
    """
    shown = recordings[:MOST_PATHS]
    has_reference = any(r.path.reference is not None for r in shown)
    with picture(file, WIDTH_IN, 4.6 * len(shown) + 0.6) as figure:
        panels: Any = figure.subplots(len(shown), 2 if has_reference else 1, squeeze=False, width_ratios=(1.2, 1.0)[: 1 + has_reference])  # fmt: skip  # noqa: E501
        for row, recording in zip(panels, shown, strict=True):
            here = windows if recording is shown[0] else ()
            _path(row[0], recording.path, here)
            tidy(row[0], "Seen from above" if len(recordings) == 1 else short(recording.name, 38), 6)
            if has_reference:
                _distance(row[1], recording.path, here)
        keys = {label: key for row in panels for axes in row for key, label in zip(*axes.get_legend_handles_labels(), strict=True)}  # fmt: skip  # noqa: E501
        figure.legend(keys.values(), keys.keys(), loc="outside lower center", ncols=6)


def _path(axes: Any, path: Paths, windows: Windows) -> None:
    lines: list[tuple[str, str, dict[str, Any]]] = [
        ("reference", "reference", {"color": TRUE_GREY, "linewidth": 5, "solid_capstyle": "round"}),
        ("nominal", "nominal model", {"color": VERMILION, "linewidth": 1.4, "dashes": (5, 2), "zorder": 3}),
        ("corrected", "corrected", {"color": BLUE, "linewidth": 1.6, "zorder": 4}),
    ]
    for name, label, look in lines:
        line: Line | None = getattr(path, name)
        if name == "nominal" and path.corrected is None:
            look = ALONE  # noqa: PLW2901
        if line is None or not line.x_m.size:
            continue
        if name == "reference" and line.x_m.size <= MARKED_ROWS:
            look = {"color": GREY, "linestyle": "none", "marker": "o", "markersize": 5, "markeredgecolor": "white"}  # noqa: PLW2901
        axes.plot(line.x_m, line.y_m, label=label, **look)
        end: Any = {"color": look["color"], "markeredgecolor": "white", "markersize": 8}
        axes.plot(line.x_m[-1], line.y_m[-1], "o", zorder=6, **end)
    best = path.corrected or path.nominal
    for k, (start_s, end_s) in enumerate(windows):
        inside = (best.time_s >= start_s) & (best.time_s <= end_s)
        style: Any = {"color": ORANGE, "linewidth": 9, "alpha": 0.45, "solid_capstyle": "round", "zorder": 2.5}
        axes.plot(best.x_m[inside], best.y_m[inside], label="" if k else "interval of a finding", **style)
    if best.x_m.size:
        ring: Any = {"color": "none", "markeredgecolor": INK, "markeredgewidth": 1.5, "markersize": 13}
        axes.plot(best.x_m[0], best.y_m[0], "o", label="start", zorder=7, **ring)
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.08)
    axes.set_xlabel("x / m")
    axes.set_ylabel("y / m")


def _distance(axes: Any, path: Paths, windows: Windows) -> None:
    reference = path.reference
    if reference is None or not reference.time_s.size or not path.nominal.time_s.size:
        axes.set_axis_off()
        why = "no wheels, hence no path" if reference and reference.time_s.size else "no reference"
        axes.text(0.5, 0.5, why, color=GREY, ha="center", transform=axes.transAxes)
        return
    looks: dict[str, Any] = {
        "nominal": {"color": BLUE if path.corrected is None else VERMILION, "linewidth": 1.2},
        "corrected": {"color": BLUE, "linewidth": 1.2},
    }
    marker = "o" if reference.time_s.size <= MARKED_ROWS else ""
    for name, look in looks.items():
        line: Line | None = getattr(path, name)
        if line is not None and line.time_s.size:
            x_m, y_m = (np.interp(reference.time_s, line.time_s, values) for values in (line.x_m, line.y_m))
            off = [x_m - reference.x_m, y_m - reference.y_m]
            axes.plot(reference.time_s, np.hypot(*off), marker=marker, markersize=4, **look)
    _shade(axes, windows)
    axes.set_ylim(bottom=0.0)
    axes.margins(x=0.0)
    axes.set_xlabel("time / s")
    axes.set_ylabel("distance / m")
    tidy(axes, "Distance from the reference", 6)


def finding_picture(
    file: Path, curve: Mismatch | None, evidence: Gain, windows: Windows = (), path: Line | None = None
) -> None:
    """Draw the mismatch against its covariate, fitted curve and gain over time, where known. Raises OSError.

    `path`: of the drive, for a map of the mismatch by place.
    """
    has_evidence = bool(evidence.time_s.size)
    with picture(file, WIDTH_IN, 4.0 if curve else 3.0) as figure:
        panels: Any = figure.subplots(1, 2 if curve and has_evidence else 1, squeeze=False)[0]
        if curve and curve.y.size:
            place_map(figure, panels[0], curve, path, quantity("mismatch", curve.error_unit))
        elif curve:
            _curve(panels[0], curve)
            figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
        if has_evidence:
            _evidence(panels[-1], evidence, windows)


def _evidence(axes: Any, evidence: Gain, windows: Windows) -> None:
    time_s, seams = end_to_end(evidence.time_s)
    axes.axhline(0.0, color=GREY, linewidth=0.8)
    axes.fill_between(time_s, 0.0, evidence.nats, color=BOUND, linewidth=0)
    axes.plot(time_s, evidence.nats, color=BLUE, linewidth=1.8)
    _shade(axes, () if seams else windows)
    _seams(axes, seams)
    axes.set_ylabel("cumulative gain / nats")
    tidy(axes, "Evidence over time", 6)


def _curve(axes: Any, curve: Mismatch) -> None:
    axes.axhline(0.0, color=GREY, linewidth=0.8)
    if curve.fit_x.size:
        order = np.argsort(curve.fit_x)
        x, fit, low, high = (values[order] for values in (curve.fit_x, curve.fit, curve.low, curve.high))
        axes.fill_between(x, low, high, color=BOUND, linewidth=0, label="its 95 % band")
        axes.plot(x, fit, color=BLUE, linewidth=1.8, label="fitted effect")
    else:  # no effect has this shape: the mismatch itself is the curve
        order = np.argsort(curve.x)
        x, value, wide = curve.x[order], curve.mismatch[order], BAND_SIGMAS * curve.sigma[order]
        axes.fill_between(x, value - wide, value + wide, color=BOUND, linewidth=0, label="its 95 % band")
        axes.plot(x, value, color=BLUE, linewidth=1.4)
    style: Any = {"color": INK, "ecolor": GREY, "elinewidth": 1.1, "capsize": 2.5, "markersize": 4.5, "zorder": 4}
    axes.errorbar(curve.x, curve.mismatch, yerr=curve.sigma, fmt="o", label="mismatch, 1 sigma", **style)
    _zoom(axes, curve)
    axes.set_xlabel(quantity(spaced(curve.covariate), curve.covariate_unit))
    axes.set_ylabel(quantity("mismatch", curve.error_unit))
    tidy(axes, f"{spaced(curve.channel).capitalize()}: mismatch against {spaced(curve.covariate)}", 6)


def _zoom(axes: Any, curve: Mismatch) -> None:
    """Limit the axis to the whole fit and the bins of typical uncertainty."""
    known = np.isfinite(curve.mismatch) & np.isfinite(curve.sigma)
    if known.any():
        known &= curve.sigma <= 3.0 * np.median(curve.sigma[known])
    ends = [curve.mismatch - curve.sigma, curve.mismatch + curve.sigma]
    low, high = (
        float(np.percentile(end[known], edge)) if known.any() else 0.0 for end, edge in zip(ends, ROBUST, strict=True)
    )
    for values in (curve.fit, curve.low, curve.high):
        finite = values[np.isfinite(values)]
        low, high = min([low, *finite]), max([high, *finite])
    margin = 0.12 * (high - low) or 1.0
    axes.set_ylim(low - margin, high + margin)


def residual_picture(file: Path, residual: Residual, has_findings: bool = True) -> None:
    """Draw the rms of the whitened data per block, before and (with findings) after. Raises OSError."""
    with picture(file, WIDTH_IN, 3.4) as figure:
        axes: Any = figure.subplots()
        time_s, seams = end_to_end(residual.time_s)
        axes.axhline(1.0, color=INK, linewidth=1.0, label="noise alone")
        style: Any = {"linewidth": 1.6, "marker": "."}
        before: Any = {"color": VERMILION, "dashes": (5, 2)} if has_findings else {"color": BLUE}
        axes.plot(time_s, residual.before, label="nominal model", **style, **before)
        if has_findings:
            axes.plot(time_s, residual.after, label="with the findings", color=BLUE, **style)
        _seams(axes, seams)
        axes.set_ylim(bottom=0.0)
        axes.set_ylabel("rms / sigmas of noise")
        tidy(axes, "Whitened residual by block", 7)
        figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3)


def scatter_picture(file: Path, noise: Scatter, spread: Spread) -> None:
    """Draw a noise relative to its stated size: over time and, if known, by bins of a covariate. Raises OSError."""
    with picture(file, WIDTH_IN, 3.4) as figure:
        panels: Any = figure.subplots(1, 2 if noise.levels else 1, squeeze=False)[0]
        panels[0].plot(spread.time_s, spread.ratio, color=BLUE, linewidth=1.2, marker=".")
        _shade(panels[0], () if noise.window is None else (noise.window,))
        panels[0].set_xlabel("time / s")
        tidy(panels[0], "Over time", 6)
        if noise.levels:
            x = np.arange(len(noise.levels))
            sizes, sigmas = ([getattr(row, name) for row in noise.levels] for name in ("ratio", "std"))
            panels[1].errorbar(x, sizes, sigmas, color=BLUE, linestyle="none", marker="o", capsize=4)
            panels[1].set_xticks(x, [row.at for row in noise.levels], rotation=20 if len(x) <= FEW else 90)
            panels[1].set_xlabel(quantity(spaced(noise.covariate or ""), noise.unit))
            tidy(panels[1], f"By {spaced(noise.covariate or '')}", len(x))
        for axes in panels:
            axes.axhline(1.0, color=INK, linewidth=1.0)
            axes.set_ylim(bottom=0.0)
            axes.set_ylabel("ratio to stated noise")


def held_out_picture(file: Path, rows: Sequence[Bar]) -> None:
    """Draw for each quantity a bar before and one after, relative to the value before. Raises OSError.

    For more than MOST_BARRED recordings, draw a dot for each in place of the bars.
    """
    names = list(dict.fromkeys(row.name for row in rows))
    if len(names) > MOST_BARRED:
        _dots_picture(file, rows)
        return
    ordered = sorted(rows, key=lambda row: names.index(row.name))
    places: list[float] = []
    for k, row in enumerate(ordered):
        is_new = len(names) > 1 and (k == 0 or row.name != ordered[k - 1].name)
        places.append((places[-1] + 1.0 if places else 0.0) + (0.7 if is_new else 0.0))
    with picture(file, WIDTH_IN, 1.3 + 0.62 * (places[-1] + 1.0)) as figure:
        axes: Any = figure.subplots()
        for k, (place, row) in enumerate(zip(places, ordered, strict=True)):
            if len(names) > 1 and (k == 0 or row.name != ordered[k - 1].name):
                axes.text(0.0, place - 0.62, short(row.name, 50), fontweight="bold", fontsize=10, va="center")
            _bars(axes, place, row)
        axes.axvline(1.0, color=GREY, linewidth=0.8, dashes=(4, 2))
        axes.set_xlim(0.0, LONGEST_BAR + 0.25)
        axes.set_ylim(places[-1] + 0.6, -0.6)
        axes.set_xlabel("ratio to the value before")
        tidy(axes, "On data not used in the fit", 6)
        axes.set_yticks(places, [named_quantity(row.quantity, row.unit)[0] for row in ordered])
        axes.tick_params(axis="y", length=0)
        axes.grid(visible=False, axis="y")
        axes.spines["left"].set_visible(False)
        keys = dict(zip(*axes.get_legend_handles_labels()[::-1], strict=True))
        figure.legend(keys.values(), keys.keys(), loc="outside lower center", ncols=3)


def _dots_picture(file: Path, rows: Sequence[Bar]) -> None:
    kinds = list(dict.fromkeys((row.quantity, row.unit) for row in rows))
    with picture(file, WIDTH_IN, 1.5 + 0.62 * len(kinds)) as figure:
        axes: Any = figure.subplots()
        for place, kind in enumerate(kinds):
            pairs = [(r.before, r.after) for r in rows if (r.quantity, r.unit) == kind]
            shares = np.array([after / before for before, after in pairs if before and after is not None])
            is_worse = shares > WORSE
            for which, color, label in ((~is_worse, GREEN, "after"), (is_worse, VERMILION, "after, worse")):
                shown = np.minimum(shares[which], LONGEST_BAR)
                axes.plot(shown, np.full(len(shown), place), "o", color=color, alpha=0.4, label=label)
            text = f"{int(is_worse.sum())} of {len(shares)} worse"
            axes.text(LONGEST_BAR + 0.03, place, text, va="center", fontsize=9.5)
        axes.axvline(1.0, color=GREY, linewidth=0.8, dashes=(4, 2))
        axes.set_xlim(0.0, LONGEST_BAR + 0.25)
        axes.set_ylim(len(kinds) - 0.4, -0.6)
        axes.set_xlabel("ratio to the value before")
        tidy(axes, "On data not used in the fit: one dot per recording", 6)
        axes.set_yticks(range(len(kinds)), [named_quantity(*kind)[0] for kind in kinds])
        axes.grid(visible=False, axis="y")
        keys = dict(zip(*axes.get_legend_handles_labels()[::-1], strict=True))
        figure.legend(keys.values(), keys.keys(), loc="outside lower center", ncols=2)


def _bars(axes: Any, place: float, row: Bar) -> None:
    before, after = row.before, row.after
    is_worse = before is not None and after is not None and after > WORSE * before
    for value, shift, name in ((before, -0.19, "before"), (after, 0.19, "after, worse" if is_worse else "after")):
        if value is None:
            axes.text(0.015, place + shift, "not known", va="center", fontsize=9.5, color=GREY)
            continue
        share = min(value / before, LONGEST_BAR) if before else float(value > 0.0)
        color = {"before": TRUE_GREY, "after": GREEN, "after, worse": VERMILION}[name]
        axes.barh(place + shift, share, height=0.34, color=color, label=name)
        look: Any = {"va": "center", "fontsize": 9.5, "fontweight": "normal" if name == "before" else "bold"}
        axes.text(share + 0.015, place + shift, f"{value:.3g} {named_quantity(row.quantity, row.unit)[1]}", **look)


def end_to_end(time_s: Array) -> tuple[Array, list[float]]:
    """Times of several recordings laid end to end, and the seams between them."""
    back = np.flatnonzero(np.diff(time_s) < 0.0) + 1
    laid = time_s.astype(float)
    for k in back:
        laid[k:] = time_s[k:] + laid[k - 1]
    return laid, [float(laid[k - 1]) for k in back]


def _seams(axes: Any, seams: Sequence[float]) -> None:
    for seam_s in seams:
        axes.axvline(seam_s, color=GREY, linewidth=1.0, dashes=(2, 2))
    axes.margins(x=0.01)
    axes.set_xlabel("time, recordings concatenated / s" if seams else "time / s")


def _shade(axes: Any, windows: Windows) -> None:
    for start_s, end_s in windows:
        axes.axvspan(start_s, end_s, color=ORANGE, alpha=0.2, linewidth=0)


def quantity(name: str, unit: str) -> str:
    """Label of an axis: name and unit."""
    shown = pretty(unit)
    return name if unit in {"", "1"} else f"{name} / {shown}" if "/" not in shown else f"{name} / ({shown})"


def spaced(name: str) -> str:
    """A name of the files, in words."""
    return name.replace("_", " ")
