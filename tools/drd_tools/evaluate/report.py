"""Pictures and HTML page from saved results."""

import re
from pathlib import Path

from tqdm import tqdm

from drd_tools.evaluate import text
from drd_tools.evaluate.pictures import error_picture, growth_picture, path_picture
from drd_tools.evaluate.results import Evaluation, Run
from drd_tools.limit import text as limit_text
from drd_tools.report.page import Page
from drd_tools.report.terminal import print_table


def write_report(evaluation: Evaluation, folder: Path) -> list[Path]:
    """Draw everything into `folder`; return the files. Raises OSError."""
    runs = evaluation.runs
    names = ", ".join(run.name for run in runs[:3]) + (f" and {len(runs) - 3} more" if len(runs) > 3 else "")
    page = Page(f"Evaluation of {names}", [_lead(run) for run in runs[:6]])
    caption = "Errors at the end and of the return, absolute trajectory error (rmse), drift and consistency"
    page.table(text.SUMMARY_HEADER, text.summary_rows(runs), caption)
    pooled = text.nees_together(runs)
    if pooled:
        page.table(text.NEES_HEADER, text.nees_rows(pooled), "Consistency of all runs together, taken as independent")
    files: list[Path] = []
    for number, run in enumerate(tqdm(runs, desc="drawing", disable=True if len(runs) < 3 else None, leave=False), 1):
        safe = re.sub(r"[^A-Za-z0-9._-]+", "_", run.name)[:60]
        prefix = "" if len(runs) == 1 else f"{number:02d}_{safe}_"
        files += _run_section(page, run, folder, prefix)
    page.save(folder / "report.html")
    return [folder / "report.html", *files]


def _lead(run: Run) -> str:
    drift = "" if run.drift is None else f", a drift of {run.drift.percent:.2g} %"
    return (
        f"{run.name}: {run.end.position_m:.3g} m off after {run.path_m:.4g} m in {run.duration_s:.0f} s{drift}, "
        f"heading {run.end.heading_deg:+.2g} deg off at the end."
    )


def _run_section(page: Page, run: Run, folder: Path, prefix: str) -> list[Path]:
    page.heading(run.name)
    page.text(*text.sentences(run))
    files = [folder / f"{prefix}path.png", folder / f"{prefix}error.png"]
    path_picture(files[0], [("estimate", run)])
    page.picture(files[0], "The estimate, as aligned, on the reference.")
    error_picture(files[1], [("error", run)])
    caption = "Error in the axes of the reference (forward, left) against time."
    if run.series.sigma is not None:
        caption += " Shaded: what the covariance claims for it, the reference's own noise included."
    page.picture(files[1], caption)
    growth = folder / f"{prefix}drivers.png"
    if run.windows.why_not:
        page.text(f"Growth of the error against temperature, rate and speed: {run.windows.why_not}.")
        growth.unlink(missing_ok=True)  # from an earlier evaluation
    else:
        growth_picture(growth, run.windows)
        files.append(growth)
        page.picture(
            growth,
            f"Growth of the error (not what had piled up before) in windows of {run.windows.window_s:g} s. Yaw rate "
            f"and speed are the estimate's. {'' if run.windows.temperature_c is not None else no_temperature(run)}",
        )
    for table in text.relative_tables(run):
        page.table(*table)
    if run.consistency.nees:
        page.table(text.NEES_HEADER, text.nees_rows(run.consistency.nees), "Consistency")
    if run.limit is not None:
        for table in limit_text.tables(run.limit):
            page.table(*table)
    page.text(f"Poses sha256 {run.poses_sha256[:16]}, reference sha256 {run.reference_sha256[:16]}.")
    return files


def no_temperature(run: Run) -> str:
    """Sentence saying why a picture has no temperature."""
    return f"No temperature: {run.reference} has no fog.csv with temperature_c."


def print_run(run: Run) -> None:
    """Print all figures of one run."""
    print(f"{run.name}\n")
    for sentence in text.sentences(run):
        print(f"- {sentence}")
    if run.windows.why_not:
        print(f"- Growth of the error against temperature, rate and speed: {run.windows.why_not}.")
    elif run.windows.temperature_c is None:
        print(f"- {no_temperature(run)}")
    for header, rows, caption in text.relative_tables(run):
        print(f"\n{caption}\n")
        print_table(header, rows)


def print_runs(evaluation: Evaluation) -> None:
    """Print one run in full, or a table of several and their joint consistency."""
    runs = evaluation.runs
    if len(runs) == 1:
        print_run(runs[0])
        return
    kinds = sorted({run.alignment.kind for run in runs})
    print(f"{len(runs)} runs, alignment {', '.join(kinds)}\n")
    print_table(text.SUMMARY_HEADER, text.summary_rows(runs))
    pooled = text.nees_together(runs)
    if pooled:
        print("\nConsistency of all runs together, taken as independent\n")
        print_table(text.NEES_HEADER, text.nees_rows(pooled))
