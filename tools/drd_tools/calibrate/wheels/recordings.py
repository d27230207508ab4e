"""Wheel calibration from recordings: read, fit, test, print and write."""

import textwrap
from collections.abc import Sequence
from pathlib import Path

from drd.config.schema import ConfigError
from drd.units import DEG_PER_RAD
from drd_tools.calibrate.wheels import words
from drd_tools.calibrate.wheels.drive import Drive, make_drive
from drd_tools.calibrate.wheels.file import provenance, write_snippet
from drd_tools.calibrate.wheels.fit import WheelFit, check_one_robot, fit_wheels
from drd_tools.calibrate.wheels.found import Found, find
from drd_tools.calibrate.wheels.keys import sections
from drd_tools.calibrate.wheels.report import held_out_picture, paths_picture
from drd_tools.calibrate.wheels.tables import held_out_table, value_tables
from drd_tools.calibrate.wheels.whole_turns import with_turns
from drd_tools.recordings.folder import Recording, read_recording
from drd_tools.report.page import Page
from drd_tools.report.terminal import print_table

COLUMNS = 110
SCALE_NOTE = (
    "Both radii rest on the reference's own scale: an error of its metres goes into them and cannot be seen here. "
    "The values are effective ones: they hold for the ground, load and way of driving of these recordings."
)
MOUNTING_NOTE = (
    "Solved for beside them: where the reference sits on the robot (all recordings together) and its time against the "
    "wheels' (each by itself)."
)
INITIAL_NOTE = (
    "estimation.initial: sigma and spread between recordings (of one recording at least the default), or what the "
    "held-out recordings' own fit departs by where that is more."
)
FIGURE_NOTE = (
    "Odometry from the reference's start pose: position error at the end, the same as part of the path, rms along the "
    "way, and heading error at the end."
)


def calibrate(folders: Sequence[Path], held_out_folders: Sequence[Path], output: Path) -> int:
    """Fit `folders`, test on `held_out_folders`, print and write. Raises ConfigError, OSError for `output`."""
    recordings = [read_recording(folder) for folder in (*folders, *held_out_folders)]
    _check_different(recordings)
    every = [make_drive(recording) for recording in recordings]
    check_one_robot(every)
    every = with_turns(every)
    drives, tests = every[: len(folders)], every[len(folders) :]
    fit = fit_wheels(drives)
    if not any(fit.determined):
        print("Nothing could be determined.\n")
        print("\n".join(words.not_determined(fit, drives)))
        print("No held-out figure: there is no calibration to test. Nothing was written.")
        return 1
    found = find(recordings[: len(folders)], drives, tests, fit)
    _print(found)
    _write(output, recordings[: len(folders)], found)
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


def _how_tested(found: Found) -> str:
    if found.tests:
        return "Held-out figures: recordings that were not fitted."
    if len(found.drives) > 1:
        return "Held-out figures: each recording with the wheels that all others give."
    return "Held-out figures: each fifth of the recording with the wheels that the rest gives."


def _print(found: Found) -> None:
    fit, drives = found.fit, found.drives
    print(_wrapped(_method(fit, drives)) + "\n")
    for table in value_tables(found):
        print_table(*table)
        print()
    for sentence in [*found.notes, SCALE_NOTE]:
        print(_wrapped(sentence))
    print()
    if found.figures:
        print(_wrapped(f"{_how_tested(found)} {FIGURE_NOTE} Nominal -> calibrated.") + "\n")
        print_table(*held_out_table(found))
        print()
    else:
        print("No held-out figure: the one recording cannot be cut into parts; give --held-out.\n")
    for sentence in found.doubts:
        print(_wrapped(f"warning: {sentence}"))


def _write(output: Path, recordings: Sequence[Recording], found: Found) -> None:
    output.mkdir(parents=True, exist_ok=True)
    inputs = [
        f"{recording.name}: " + ", ".join(f"{name} {digest[:16]}" for name, digest in recording.sha256.items())
        for recording in recordings
    ]
    comments = [
        *provenance([f"{text} (SHA-256)" for text in inputs]),
        INITIAL_NOTE,
        *found.notes,
        *(f"warning: {text}" for text in found.doubts),
    ]
    write_snippet(output / "wheels.yaml", sections(found), comments)
    _write_report(output, inputs, found)
    print(f"\nwritten: {output / 'wheels.yaml'}, {output / 'report.html'}")


def _write_report(output: Path, inputs: Sequence[str], found: Found) -> None:
    fit, drives, figures = found.fit, found.drives, found.figures
    longest = max(drives, key=lambda d: d.path_m)
    shown = [("fitted", longest, fit)]
    if figures:
        # Prefer a drive other than that of the fitted panel.
        held_out = max(figures, key=lambda f: (f.drive.name != longest.name, f.drive.path_m))
        shown.append(("held out", held_out.drive, held_out.fit))
    paths_picture(output / "paths.png", shown)
    lines = [_method(fit, drives), *found.notes, *(f"Warning: {text}" for text in found.doubts)]
    page = Page("Wheel calibration", lines)
    for table in value_tables(found):
        page.table(*table)
    page.text(SCALE_NOTE)
    page.heading("Held out")
    if figures:
        held_out_picture(output / "held_out.png", figures)
        page.text(f"{_how_tested(found)} {FIGURE_NOTE}")
        page.picture(output / "held_out.png", "Errors of the recordings that were held out, nominal and calibrated.")
        page.table(*held_out_table(found), "nominal -> calibrated")
    else:
        page.text("The one recording cannot be cut into parts.")
    page.heading("Paths")
    page.picture(output / "paths.png", "The longest path that was fitted, and the longest other one that was held out.")
    page.heading("Inputs")
    page.code("\n".join(inputs))
    page.save(output / "report.html")
