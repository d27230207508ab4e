"""Wheel calibration from recordings: reads, fits, tests, prints, writes."""

import math
import textwrap
from collections.abc import Sequence
from pathlib import Path

from drd.config import Initial
from drd.schema import ConfigError
from drd.units import DEG_PER_RAD
from drd_tools.calibrate.wheels import words
from drd_tools.calibrate.wheels.drive import Drive, make_drive
from drd_tools.calibrate.wheels.file import provenance, write_snippet
from drd_tools.calibrate.wheels.fit import WheelFit, check_one_robot, fit_wheels
from drd_tools.calibrate.wheels.heldout import Error, HeldOut, compare, leave_one_out
from drd_tools.calibrate.wheels.report import held_out_picture, paths_picture
from drd_tools.recordings.folder import Recording, read_recording
from drd_tools.report.page import Page

COLUMNS = 110
SCALE_NOTE = (
    "Both radii rest on the reference's own scale: an error of its metres goes into them and cannot be seen here. "
    "The values are effective ones: they hold for the ground, load and way of driving of these recordings."
)
MOUNTING_NOTE = (
    "Solved for beside them: where the reference sits on the robot (all recordings together) and its time against the "
    "wheels' (each by itself)."
)
INITIAL_NOTE = "estimation.initial: the sigmas, or what the held-out recordings' own fit departs by where that is more."
FIGURE_NOTE = (
    "Odometry from the reference's start pose: position error at the end, the same as part of the path, rms along the "
    "way, and heading error at the end."
)
VALUE_HEADER = ("value", "nominal", "calibrated", "sigma", "change")
FIGURE_HEADER = ("held out", "path m", "end cm", "end % of path", "rms cm", "heading deg", "deg per 100 m")


def calibrate(folders: Sequence[Path], held_out_folders: Sequence[Path], output: Path) -> int:
    """Fit `folders`, test on `held_out_folders`, print and write. Raises ConfigError, OSError for `output`."""
    recordings = [read_recording(folder) for folder in (*folders, *held_out_folders)]
    _check_different(recordings)
    every = [make_drive(recording) for recording in recordings]
    check_one_robot(every)
    drives, tests = every[: len(folders)], every[len(folders) :]
    fit = fit_wheels(drives)
    if not any(fit.determined):
        print("Nothing could be determined.\n")
        print("\n".join(words.not_determined(fit, drives)))
        print("No held-out figure: there is no calibration to test. Nothing was written.")
        return 1
    figures = [compare(drive, fit) for drive in tests] if tests else leave_one_out(drives, fit)
    other = fit_wheels(tests) if tests else None
    doubts = words.warnings(fit, drives) + words.held_out_warnings(fit, drives, other, tests, figures)
    _print(fit, drives, figures, doubts, bool(tests))
    _write(output, recordings[: len(folders)], drives, tests, fit, other, figures, doubts)
    return 0


def _check_different(recordings: Sequence[Recording]) -> None:
    seen: dict[tuple[str, str | None], Recording] = {}
    for recording in recordings:
        digest = (recording.sha256["encoders.csv"], recording.sha256.get("reference.csv"))
        if digest in seen:
            raise ConfigError(
                str(recording.folder), "encoders.csv", "each recording once", f"the same data as {seen[digest].folder}"
            )
        seen[digest] = recording


def value_rows(fit: WheelFit, drive: Drive) -> list[list[str]]:
    """The three values, as text."""
    radii = fit.determined[0] and fit.determined[1]
    old, new = drive.nominal, fit.wheels
    rows = []
    for name, nominal, value, sigma, is_known in (
        ("left radius", old.left_radius_m, new.left_radius_m, fit.sigma[0], radii),
        ("right radius", old.right_radius_m, new.right_radius_m, fit.sigma[1], radii),
        ("effective tread", old.tread_m, new.tread_m, fit.sigma[2], fit.determined[2]),
    ):
        known = [
            f"{value:.5f} m",
            f"{sigma * value:.5f} m ({100 * sigma:.2f} %)",
            f"{100 * (value / nominal - 1):+.2f} %",
        ]
        rows.append([name, f"{nominal:.5f} m", *(known if is_known else [f"{value:.5f} m", "not determined", "-"])])
    return rows


def initial_sigmas(fit: WheelFit, other: WheelFit | None) -> dict[str, float]:
    """`estimation.initial`: the sigmas, but no less than what `other`, the held-out recordings' own fit, departs by."""
    w, v = fit.wheels, fit.wheels if other is None else other.wheels
    wheel = max(
        *fit.sigma[:2], abs(v.left_radius_m / w.left_radius_m - 1), abs(v.right_radius_m / w.right_radius_m - 1)
    )
    tread = max(fit.sigma[2], abs(v.tread_m / w.tread_m - 1))
    radii = all(f is None or all(f.determined[:2]) for f in (fit, other))
    is_tread = all(f is None or f.determined[2] for f in (fit, other))
    return {
        "wheel_scale": wheel if radii else max(Initial().wheel_scale, *fit.sigma[:2]),
        "tread": tread if is_tread else max(Initial().tread, fit.sigma[2]),
    }


def figure_rows(figures: Sequence[HeldOut], tread_m: float) -> list[list[str]]:
    """Held-out figures as text, nominal -> calibrated, and over all of them."""
    rows = [_figure_row(f.name, f.path_m, f.nominal, f.calibrated, tread_m) for f in figures]
    count = len(figures)
    if count > 1:
        means = []
        for errors in ([f.nominal for f in figures], [f.calibrated for f in figures]):
            sums = [sum(abs(getattr(e, n)) for e in errors) for n in ("end_m", "end_heading_rad")]
            means.append(Error(sums[0] / count, math.sqrt(sum(e.rms_m**2 for e in errors) / count), sums[1] / count))
        rows.append(_figure_row("all (mean)", sum(f.path_m for f in figures) / count, means[0], means[1], tread_m))
    return rows


def _figure_row(name: str, path_m: float, nominal: Error, calibrated: Error, tread_m: float) -> list[str]:
    def pair(digits: int, values: Sequence[float]) -> str:
        return f"{values[0]:.{digits}f} -> {values[1]:.{digits}f}"

    both = (nominal, calibrated)
    heading_deg = [DEG_PER_RAD * e.end_heading_rad for e in both]
    moved = path_m > 2.0 * tread_m
    return [
        name,
        f"{path_m:.1f}",
        pair(1, [100 * e.end_m for e in both]),
        pair(2, [100 * e.end_m / path_m for e in both]) if moved else "-",
        pair(1, [100 * e.rms_m for e in both]),
        pair(2, heading_deg),
        pair(0, [100 * abs(h) / path_m for h in heading_deg]) if moved else "-",
    ]


def aligned(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table for the terminal: the first column to the left, the others to the right."""
    table = [list(header), *map(list, rows)]
    widths = [max(len(row[k]) for row in table) for k in range(len(header))]
    return "\n".join(
        "  ".join(
            cell.ljust(w) if k == 0 else cell.rjust(w) for k, (cell, w) in enumerate(zip(row, widths, strict=True))
        )
        for row in table
    )


def _wrapped(text: str) -> str:
    return textwrap.fill(text, COLUMNS, subsequent_indent="  ")


def _method(fit: WheelFit, drives: Sequence[Drive]) -> str:
    path_m = sum(drive.path_m for drive in drives)
    left, right = (DEG_PER_RAD * sum(drive.turns_rad[k] for drive in drives) for k in (0, 1))
    times = sorted(1000 * mounting.time_s for mounting in fit.own)
    m = fit.mounting
    return (
        f"{len(drives)} recordings, {fit.windows} windows, {path_m:.1f} m of path, turns of {left:.0f} deg left and "
        f"{right:.0f} deg right. {MOUNTING_NOTE} Forward {1000 * m.forward_m:.1f} mm, left {1000 * m.left_m:.1f} mm, "
        f"heading {DEG_PER_RAD * m.heading_rad:.2f} deg; the reference is later than the wheels by {-times[-1]:.0f} to "
        f"{-times[0]:.0f} ms."
    )


def _how_tested(is_apart: bool, drives: Sequence[Drive]) -> str:
    if is_apart:
        return "Held-out figures: recordings that were not fitted."
    if len(drives) > 1:
        return "Held-out figures: each recording with the wheels that all others give."
    return "Held-out figures: each fifth of the recording with the wheels that the rest gives."


def _print(
    fit: WheelFit, drives: Sequence[Drive], figures: Sequence[HeldOut], doubts: Sequence[str], is_apart: bool
) -> None:
    print(_wrapped(_method(fit, drives)) + "\n")
    print(aligned(VALUE_HEADER, value_rows(fit, drives[0])) + "\n")
    for sentence in [*words.not_determined(fit, drives), SCALE_NOTE]:
        print(_wrapped(sentence))
    print()
    if figures:
        print(_wrapped(f"{_how_tested(is_apart, drives)} {FIGURE_NOTE} Nominal -> calibrated.") + "\n")
        print(aligned(FIGURE_HEADER, figure_rows(figures, drives[0].nominal.tread_m)) + "\n")
    else:
        print("No held-out figure: the one recording cannot be cut into parts; give --held-out.\n")
    for sentence in doubts:
        print(_wrapped(f"warning: {sentence}"))


def _write(
    output: Path,
    recordings: Sequence[Recording],
    drives: Sequence[Drive],
    tests: Sequence[Drive],
    fit: WheelFit,
    other: WheelFit | None,
    figures: Sequence[HeldOut],
    doubts: Sequence[str],
) -> None:
    output.mkdir(parents=True, exist_ok=True)
    nominal = drives[0].nominal
    inputs = [
        f"{recording.name}: " + ", ".join(f"{name} {digest[:16]}" for name, digest in recording.sha256.items())
        for recording in recordings
    ]
    notes = words.not_determined(fit, drives)
    write_snippet(
        output / "wheels.yaml",
        {
            "wheel_radius_m": nominal.left_radius_m,
            "left_scale": fit.wheels.left_radius_m / nominal.left_radius_m,
            "right_scale": fit.wheels.right_radius_m / nominal.right_radius_m,
            "tread_m": fit.wheels.tread_m,
        },
        initial_sigmas(fit, other),
        [
            *provenance([f"{text} (SHA-256)" for text in inputs]),
            INITIAL_NOTE,
            *notes,
            *(f"warning: {text}" for text in doubts),
        ],
    )
    longest = max(drives, key=lambda d: d.path_m)
    shown = [("fitted", longest, fit)]
    if figures:
        # Another one than the fitted panel has, where there is another.
        held_out = max(figures, key=lambda f: (f.name != longest.name, f.path_m))
        shown.append(("held out", held_out.drive, held_out.fit))
    paths_picture(output / "paths.png", shown)
    page = Page("Wheel calibration", [_method(fit, drives), *notes, *(f"Warning: {text}" for text in doubts)])
    page.table(VALUE_HEADER, value_rows(fit, drives[0]))
    page.text(SCALE_NOTE)
    page.heading("Held out")
    if figures:
        held_out_picture(output / "held_out.png", figures)
        page.text(f"{_how_tested(bool(tests), drives)} {FIGURE_NOTE}")
        page.picture(output / "held_out.png", "Errors of the recordings that were held out, nominal and calibrated.")
        page.table(FIGURE_HEADER, figure_rows(figures, nominal.tread_m), "nominal -> calibrated")
    else:
        page.text("The one recording cannot be cut into parts.")
    page.heading("Paths")
    page.picture(output / "paths.png", "The longest path that was fitted, and the longest other one that was held out.")
    page.heading("Inputs")
    page.code("\n".join(inputs))
    page.save(output / "report.html")
    print(f"\nwritten: {output / 'wheels.yaml'}, {output / 'report.html'}")
