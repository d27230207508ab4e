"""Compare saved evaluations: tables and overlaid pictures."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from drd.config.schema import ConfigError
from drd_tools.evaluate import text
from drd_tools.evaluate.pictures import error_picture, path_picture
from drd_tools.evaluate.results import Evaluation, Run
from drd_tools.report.page import Page
from drd_tools.report.style import short
from drd_tools.report.terminal import print_table

DRAWN: Final = 6  # references whose pictures are drawn
MEDIAN_HEADER: Final = ("evaluation", *text.SUMMARY_HEADER[1:8])
Labelled = tuple[str, Run]


def compare(folders: Sequence[Path], output: Path) -> list[Path]:
    """Print tables, and write compare.html with its pictures. Returns the files. Raises ConfigError, OSError."""
    labels = _labels(folders)
    evaluations = [Evaluation.load(folder) for folder in folders]
    groups = _groups(labels, evaluations)
    shared = [group for group in groups if len(group) > 1]
    page = Page(f"Comparison of {', '.join(labels)}", notes(groups))
    for note in notes(groups):
        print(f"- {note}")
    rows = [row for group in groups for row in _rows(group)]
    print()
    print_table(text.SUMMARY_HEADER, rows)
    page.table(text.SUMMARY_HEADER, rows, "Each run; those against the same reference stand together")
    if len(shared) > 1:
        medians = median_rows(labels, shared)
        print("\nMedians of absolute values over the references that all have in common\n")
        print_table(MEDIAN_HEADER, medians)
        page.table(MEDIAN_HEADER, medians, "Medians of absolute values over the references that all have in common")
    files = [output / "compare.html"]
    for number, group in enumerate(shared[:DRAWN], 1):
        prefix = "" if len(shared) == 1 else f"{number:02d}_"
        pictures = [output / f"{prefix}compare_path.png", output / f"{prefix}compare_error.png"]
        path_picture(pictures[0], group)
        error_picture(pictures[1], group)
        page.heading(group[0][1].reference)
        page.picture(pictures[0], "Each estimate, as aligned, on the reference.")
        page.picture(pictures[1], "Errors in the axes of the reference against time.")
        files += pictures
    if len(shared) > DRAWN:
        page.text(f"Pictures of the first {DRAWN} of {len(shared)} references.")
    page.save(files[0])
    return files


def _labels(folders: Sequence[Path]) -> list[str]:
    """Names of the folders, or their whole paths if two names are the same."""
    names = [folder.resolve().name for folder in folders]
    if len({folder.resolve() for folder in folders}) < len(folders):
        raise ConfigError("--compare", "DIR", "different folders", "one of them twice")
    return names if len(set(names)) == len(names) else [str(folder) for folder in folders]


def _groups(labels: Sequence[str], evaluations: Sequence[Evaluation]) -> list[list[Labelled]]:
    """Group runs by the content of their reference file, in the order of the first evaluation."""
    groups: dict[str, list[Labelled]] = {}
    for label, evaluation in zip(labels, evaluations, strict=True):
        once = len({run.reference_sha256 for run in evaluation.runs}) == len(evaluation.runs)
        for run in evaluation.runs:
            groups.setdefault(run.reference_sha256, []).append((label if once else f"{label}: {run.name}", run))
    return list(groups.values())


def notes(groups: Sequence[Sequence[Labelled]]) -> list[str]:
    """Sentences on which runs can be compared, and which differ in more than the estimate."""
    shared = [group for group in groups if len(group) > 1]
    found = [f"{len(shared)} of {len(groups)} references were used by more than one run."]
    for group in shared:
        name = group[0][1].reference
        kinds = {run.alignment.short for _, run in group}
        if len(kinds) > 1:
            found.append(f"{name}: alignments differ ({', '.join(sorted(kinds))}), so absolute errors do not compare.")
        lags_s = {run.lag_taken_s for _, run in group}
        if len(lags_s) > 1:
            taken = f"{min(lags_s):.2f} to {max(lags_s):.2f} s earlier"
            found.append(f"{name}: the reference's times were taken {taken}, which is part of what errors differ by.")
        if len({(run.position_sigma_m, run.heading_sigma_deg) for _, run in group}) > 1:
            found.append(f"{name}: the reference's standard deviations differ, so NEES does not compare.")
        rows = {run.rows for _, run in group}
        if len(rows) > 1:
            found.append(f"{name}: {min(rows)} to {max(rows)} rows of the reference were used, so times differ.")
    return found


def _rows(group: Sequence[Labelled]) -> list[list[str]]:
    cells = text.summary_rows([run for _, run in group])
    return [[f"{short(run.reference)} | {label}", *row[1:]] for (label, run), row in zip(group, cells, strict=True)]


def median_rows(labels: Sequence[str], shared: Sequence[Sequence[Labelled]]) -> list[list[str]]:
    """Rows with each evaluation's medians of absolute values over the references common to all."""
    common = [dict(group) for group in shared if {label for label, _ in group} >= set(labels)]
    rows = []
    for label in labels if common else ():
        columns = zip(*(text.main_figures(group[label]) for group in common), strict=True)
        cells = []
        for column in columns:
            known = [abs(value) for value in column if value is not None]
            cells.append(f"{np.median(known):.3g}" if len(known) == len(column) else text.UNKNOWN)
        rows.append([label, *cells])
    return rows
