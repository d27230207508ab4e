"""Figures as sentences and table rows, for the terminal and the page."""

from collections.abc import Iterator, Sequence
from typing import Final

from drd.units import DEG_PER_RAD
from drd_tools.evaluate.consistency import PARTS, Nees, together
from drd_tools.evaluate.lag import in_words
from drd_tools.evaluate.metrics import Relative
from drd_tools.evaluate.results import Run
from drd_tools.limit import text as limit_text
from drd_tools.report.terminal import metres

SUMMARY_HEADER: Final = (
    "run", "path / m", "end / m", "return / m", "ATE / m", "heading ATE / deg", "drift / %", "heading drift / deg/h",
    "NEES of 3", "limit / m", "limit drift / %",
)  # fmt: skip
_LENGTH_HEADER: Final = ("length / m", "segments", "rmse / m", "rmse / deg", "mean / %", "mean / deg/m")
_TIME_HEADER: Final = ("duration / s", "segments", "rmse / m", "rmse / deg")
NEES_HEADER: Final = ("part", "average NEES", "expected", "99 % interval", "rows", "worth", "verdict")
UNKNOWN: Final = "-"


def summary_rows(runs: Sequence[Run]) -> list[list[str]]:
    """Rows of SUMMARY_HEADER, one per run."""
    rows = []
    for run in runs:
        nees = next((n for n in run.consistency.nees if n.part == "pose"), None)
        cells = [f"{v:.3g}" if v is not None else UNKNOWN for v in main_figures(run)]
        cells.append(UNKNOWN if nees is None else f"{nees.average:.3g} ({nees.verdict})")
        bound = (None, None) if run.limit is None else (run.limit.position_rms_m, run.limit.drift_percent)
        rows.append([run.name, *cells, *(UNKNOWN if v is None else f"{v:.2g}" for v in bound)])
    return rows


def main_figures(run: Run) -> tuple[float | None, ...]:
    """Figures of the summary, in the order of its header: path, end, return, ATE, its heading, two drifts."""
    return (
        run.path_m,
        run.end.position_m,
        run.end.return_m,
        run.absolute.position_rmse_m,
        run.absolute.heading_rmse_deg,
        None if run.drift is None else run.drift.percent,
        run.heading.deg_per_h,
    )


def sentences(run: Run) -> Iterator[str]:
    """Sentences on all single figures, with their meaning."""
    yield from _basis(run)
    yield from in_words(run.lag_taken_s, run.lag_left_s)
    yield f"Alignment: {run.alignment.sentence}."
    yield from _end(run)
    a = run.absolute
    yield (
        f"Absolute trajectory error: {metres(a.position_rmse_m)} rmse{_limit(run, 'position_rms_m')}, "
        f"{metres(a.position_mean_m)} mean, {metres(a.position_max_m)} max; heading {a.heading_rmse_deg:.3g} deg "
        f"rmse{_limit(run, 'heading_rms_deg')}, "
        f"{a.heading_max_deg:.3g} deg max."
    )
    if run.drift is None:
        why = "the robot did not move" if run.path_m == 0.0 else "no segment has both ends near rows of the reference"
        yield f"Drift (KITTI): not determined; {why}."
    else:
        d = run.drift
        yield (
            f"Drift (KITTI): {d.percent:.3g} %{_limit(run, 'drift_percent')} and {d.deg_per_m:.3g} deg/m, mean of "
            f"{d.segments} overlapping segments of {d.shortest_m:.3g} to {d.longest_m:.3g} m (10 to 80 % of the path, "
            "where the reference has rows)."
        )
    yield _heading(run)
    yield from _consistency(run)
    if run.limit is not None:
        yield from limit_text.sentences(run.limit)


def _limit(run: Run, name: str) -> str:
    """Limit of an error, in parentheses; empty if there is none."""
    if run.limit is None:
        return ""
    value = float(getattr(run.limit, name))
    unit = "%" if name == "drift_percent" else "deg"
    return f" (limit {metres(value) if name.endswith('_m') else f'{value:.2g} {unit}'})"


def _basis(run: Run) -> Iterator[str]:
    source = "by the reference" if run.is_dense else "by the estimate, since the reference is sparse"
    yield (
        f"{run.rows} rows of the reference {run.reference} in {run.duration_s:.1f} s, "
        f"{run.path_m:.4g} m of path ({source}); "
        f"left out: {run.outside} rows before or after the poses, {run.in_gaps} between poses more than "
        f"{run.max_gap_s:g} s apart."
    )
    if run.position_sigma_m == 0.0 or run.heading_sigma_deg == 0.0:
        unknown = [n for n, s in (("position", run.position_sigma_m), ("heading", run.heading_sigma_deg)) if s == 0.0]
        yield f"The reference's standard deviation of {' and '.join(unknown)} is not stated, and taken as 0."


def _end(run: Run) -> Iterator[str]:
    e = run.end
    share = "" if e.share_of_path is None else f", {100.0 * e.share_of_path:.3g} % of the path"
    yield (
        f"Error at the end ({e.time_s:.1f} s): {metres(e.position_m)}{_limit(run, 'end_m')}{share} (along "
        f"{metres(e.along_m, '+')}, to the left {metres(e.cross_m, '+')}), heading {e.heading_deg:+.3g} "
        f"deg{_limit(run, 'end_deg')}."
    )
    if e.return_m is None or e.return_heading_deg is None:
        yield f"Return position error: none, as the path ends {metres(e.reference_to_start_m)} from its start."
    else:
        yield (
            f"Return position error (closed path, ends {metres(e.reference_to_start_m)} from its start): "
            f"{metres(e.return_m)}, heading {e.return_heading_deg:+.3g} deg, relative to the start, whatever the "
            "alignment."
        )


def _heading(run: Run) -> str:
    h = run.heading
    if h.low_deg_per_h is None or h.high_deg_per_h is None:
        return f"Heading drift: {h.deg_per_h:+.3g} deg/h; {run.rows} rows do not determine its uncertainty."
    excluded = "" if h.low_deg_per_h <= 0.0 <= h.high_deg_per_h else ", without zero"
    interval = f"{h.low_deg_per_h:+.3g} to {h.high_deg_per_h:+.3g}"
    return f"Heading drift: {h.deg_per_h:+.3g} deg/h, 95 % interval {interval}{excluded}."


def _consistency(run: Run) -> Iterator[str]:
    c = run.consistency
    if c.why_not:
        yield f"Consistency (NEES): {c.why_not}."
    for n in c.nees:
        yield (
            f"Consistency of the {n.part}: NEES {n.average:.3g} where {n.dof} is expected, 99 % interval {n.low:.2g} "
            f"to {n.high:.3g} ({n.rows} rows, worth {n.effective:.1f} independent ones): {n.verdict}."
        )
    if c.inside_99 is not None:
        yield f"Within the claimed 99 % radius: {100.0 * c.inside_99:.1f} % of the rows."
    if c.before is not None:
        yield (
            f"Of what the poses claim, {metres(c.before[0])} and {c.before[1] * DEG_PER_RAD:.2g} deg (1 sigma) are "
            "from before the first common time, and no error is: NEES is too small for that, and the radius too large."
        )


def relative_tables(run: Run) -> Iterator[tuple[Sequence[str], list[list[str]], str]]:
    """Yield header, rows and caption of each table of relative errors."""
    if run.by_length:
        yield _LENGTH_HEADER, list(map(_relative_row, run.by_length)), "Relative error over segments of the path"
    if run.by_time:
        yield _TIME_HEADER, list(map(_relative_row, run.by_time)), "Relative error over intervals of time"


def _relative_row(r: Relative) -> list[str]:
    """Cells of a row, without means per metre if there are none."""
    cells = [f"{r.size:.3g}", str(r.segments), f"{r.position_rmse_m:.3g}", f"{r.heading_rmse_deg:.3g}"]
    if r.mean_m_per_m is not None and r.mean_deg_per_m is not None:
        cells += [f"{100.0 * r.mean_m_per_m:.3g}", f"{r.mean_deg_per_m:.3g}"]
    return cells


def nees_rows(parts: Sequence[Nees]) -> list[list[str]]:
    """Rows of NEES_HEADER."""
    rows = []
    for n in parts:
        interval = f"{n.low:.2g} to {n.high:.3g}"
        rows.append([n.part, f"{n.average:.3g}", str(n.dof), interval, str(n.rows), f"{n.effective:.1f}", n.verdict])
    return rows


def nees_together(runs: Sequence[Run]) -> list[Nees]:
    """NEES over all runs that have it; empty if fewer than two do."""
    found = []
    for part in PARTS:
        parts = [n for run in runs for n in run.consistency.nees if n.part == part]
        if len(parts) > 1:
            found.append(together(parts))
    return found
