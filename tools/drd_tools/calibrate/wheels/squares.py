"""Wheel calibration by UMBmark: read, compute, print and write."""

import math
from pathlib import Path

import numpy as np

from drd.arrays import Array
from drd.estimation.estimate import MEASURED_TREAD, WHEEL_SCALE
from drd.units import DEG_PER_RAD
from drd_tools.calibrate.wheels.file import provenance, write_snippet
from drd_tools.calibrate.wheels.report import returns_picture
from drd_tools.calibrate.wheels.umbmark import (
    Estimate,
    Returns,
    Umbmark,
    evaluate,
    leave_one_pair_out,
    one_way_rad,
    read_returns,
    runs_problem,
)
from drd_tools.recordings.folder import file_hash
from drd_tools.report.page import Page
from drd_tools.report.terminal import print_table

HEADER = ("value", "estimate", "sigma", "meaning")
MISFIT_SIGMA = 3.0


def calibrate(file: Path, side_m: float, tread_m: float, output: Path | None) -> int:
    """Evaluate the returns in `file`, print, and write where `output` is given. Raises ConfigError, OSError."""
    returns = read_returns(file)
    if not len(returns.cw_m) or not len(returns.ccw_m):
        _print_one_way(returns, side_m)
        return 1
    result = evaluate(returns, side_m, tread_m)
    before_m, after_m = leave_one_pair_out(returns, side_m)
    notes = [text for text in (runs_problem(returns), *significance(result), *misfit(result, returns)) if text]
    figure = held_out_sentence(before_m, after_m)
    print(f"{len(returns.cw_m)} squares cw, {len(returns.ccw_m)} ccw, side {side_m:g} m, nominal tread {tread_m:g} m\n")
    print_table(HEADER[:3], [row[:3] for row in rows(result)])
    print("", *notes, figure, sep="\n")
    if output is not None:
        _write(file, output, returns, result, notes, figure)
    return 0


def _print_one_way(returns: Returns, side_m: float) -> None:
    way, name, sign = (1, "ccw", "+") if len(returns.ccw_m) else (-1, "cw", "-")
    runs = returns.ccw_m if way == 1 else returns.cw_m
    both_deg = DEG_PER_RAD * one_way_rad(runs, side_m, way)
    print(
        f"E_d and E_b: not determined, all {len(runs)} squares are {name}. One direction tells only alpha {sign} beta "
        f"({both_deg:.3f} deg): a tread error and unequal wheels look alike. Drive squares the other way too.\n"
        "No held-out figure: there is no calibration to test. Nothing was written."
    )


def rows(result: Umbmark) -> list[list[str]]:
    """Values as text: name, estimate, sigma, meaning."""

    def row(name: str, estimate: Estimate, digits: int, unit: str, meaning: str, factor: float = 1.0) -> list[str]:
        sigma = "unknown" if math.isnan(estimate.sigma) else f"{factor * estimate.sigma:.{digits}f}{unit}"
        return [name, f"{factor * estimate.value:.{digits}f}{unit}", sigma, meaning]

    return [
        row("alpha", result.alpha_rad, 3, " deg", "each turn is larger than 90 deg by it (type A)", DEG_PER_RAD),
        row("beta", result.beta_rad, 3, " deg", "each side bends to the left by it (type B)", DEG_PER_RAD),
        row("E_b", result.E_b, 5, "", "actual over nominal tread"),
        row("E_d", result.E_d, 5, "", "right over left wheel diameter"),
        row("c_l", result.c_l, 5, "", "left_scale"),
        row("c_r", result.c_r, 5, "", "right_scale"),
        row("corrected tread", result.tread_m, 5, " m", "tread_m"),
        row("E_max,syst before", result.e_max_before_m, 4, " m", "distance of the farther centroid"),
        row("E_max,syst after", result.e_max_after_m, 4, " m", "what the calibration leaves of it, predicted"),
    ]


def significance(result: Umbmark) -> list[str]:
    """A sentence for each error that is not significant."""
    sentences = []
    for name, estimate, is_sure in (
        ("tread (alpha, E_b)", result.alpha_rad, result.significant[0]),
        ("wheel diameters (beta, E_d)", result.beta_rad, result.significant[1]),
    ):
        if math.isnan(estimate.sigma):
            sentences.append(f"{name}: with one run in a direction its uncertainty is unknown.")
        elif not is_sure:
            sigmas = abs(estimate.value) / estimate.sigma
            sentences.append(f"{name}: not significant: {sigmas:.1f} sigma. The spread of the runs could make it.")
    return sentences


def misfit(result: Umbmark, returns: Returns) -> list[str]:
    """A sentence if errors of tread and wheel diameters cannot explain the centroids."""
    worst = 0.0
    for runs_m, left_m in zip((returns.cw_m, returns.ccw_m), result.misfit_m, strict=True):
        if len(runs_m) > 1:
            sigma_m = np.std(runs_m, axis=0, ddof=1) / math.sqrt(len(runs_m))
            worst = max(worst, float(np.max(np.abs(left_m) / np.maximum(sigma_m, 1e-4))))
    if worst < MISFIT_SIGMA:
        return []
    return [
        f"The centroids do not fit a wrong tread and unequal wheels ({worst:.1f} sigma away): were x and y, and the "
        "signs, as --help has them? Was the odometry's own return position subtracted?"
    ]


def held_out_sentence(before_m: Array, after_m: Array) -> str:
    """Sentence with the held-out figure, or why there is none."""
    if not len(before_m):
        return "No held-out figure: leaving one pair out needs two runs in each direction."
    rms = [float(np.sqrt(np.mean(distance_m**2))) for distance_m in (before_m, after_m)]
    return (
        f"Held-out figure: with one run of each direction left out in turn ({len(before_m)} pairs), their distance "
        f"from the origin is {rms[0]:.4f} m rms as driven and {rms[1]:.4f} m rms by the calibration of the others, "
        f"{rms[0] / max(rms[1], 1e-9):.1f} times less; the largest {before_m.max():.4f} m and {after_m.max():.4f} m."
    )


def _write(file: Path, output: Path, returns: Returns, result: Umbmark, notes: list[str], figure: str) -> None:
    output.mkdir(parents=True, exist_ok=True)
    source = f"{file.name}: {file_hash(file)[:16]} (SHA-256)"
    sigma_b = result.tread_m.sigma / result.tread_m.value
    initial = {"wheel_scale": WHEEL_SCALE, "tread": MEASURED_TREAD if math.isnan(sigma_b) else sigma_b}
    write_snippet(
        output / "wheels.yaml",
        {
            "robot": {"left_scale": result.c_l.value, "right_scale": result.c_r.value, "tread_m": result.tread_m.value},
            "estimation": {"initial": initial},
        },
        [
            *provenance([source]),
            "The scales are factors on those that were in force while the squares were driven (usually 1).",
            "UMBmark does not measure the mean radius: wheel_radius_m stays, and wheel_scale is the usual uncertainty.",
            *notes,
            figure,
        ],
    )
    returns_picture(output / "returns.png", returns, result)
    page = Page("Wheel calibration by UMBmark", [*notes, figure])
    page.table(HEADER, rows(result), text_columns=(3,))
    page.picture(
        output / "returns.png",
        "Return-position errors of the squares, and what is left when the fitted tread and diameters are taken off.",
    )
    page.heading("Inputs")
    page.code(source)
    page.save(output / "report.html")
    print(f"\nwritten: {output / 'wheels.yaml'}, {output / 'report.html'}")
