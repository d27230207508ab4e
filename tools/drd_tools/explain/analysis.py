"""Explain a recording: the budget at the end and on the way, and the actual error."""

import math
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np

from drd.arrays import Array
from drd.config.schema import ConfigError
from drd.units import DEG_PER_RAD
from drd_tools.evaluate.alignment import rotation, turned_covariance
from drd_tools.evaluate.lag import shifted, taken_off
from drd_tools.evaluate.replayed import poses_of
from drd_tools.evaluate.trajectory import Reference
from drd_tools.explain.actual import actual_error
from drd_tools.explain.interval import Interval, Snapshot
from drd_tools.explain.results import Actual, Delay, Explanation, Line
from drd_tools.explain.source import Source
from drd_tools.limit.causes import CAUSES, GROUPS, by_group
from drd_tools.replay.result import Replayed

DRAWN: Final = 600
KEPT: Final = 8  # times on the way at which the actual error is evaluated
DIGITS: Final = 6


class Plan(NamedTuple):
    """Beginning and end of the interval in s (None: those of the recording), and times at which poses are kept."""

    from_s: float | None
    to_s: float | None
    keep_s: tuple[float, ...]
    notes: list[str]


def explain(
    source: Source, from_s: float | None, to_s: float | None, reference: Reference | None, lag_s: float = 0.0
) -> Explanation:
    """Replay and explain. `lag_s`: lag of the reference, NaN: estimate it from the headings, by a second replay.

    Raises ConfigError, also if the interval has no pose.
    """
    taken_s = lag_s
    left_s: float | None = 0.0
    if reference is not None and math.isnan(lag_s):
        reference, taken_s, left_s = taken_off(poses_of(source.replay(), ""), reference, lag_s)
    elif reference is not None:
        reference = shifted(reference, lag_s)
    plan = make_plan(source, from_s, to_s, reference)
    interval = Interval(source.zero_ns, plan.from_s, plan.to_s, plan.keep_s)
    replayed = source.run(interval)
    if len(interval.snapshots) < 2:
        table = interval.table()
        poses = f"steps from {table[0, 0]:.12g} to {table[-1, 0]:.12g} s" if len(table) else "no step of the filter"
        raise ConfigError(str(source.path), "--from, --to", "an interval with steps of the filter", poses)
    notes = [*plan.notes, *replayed.notes, *_rejections(replayed)]
    actual = None
    if reference is not None and plan.keep_s:
        if interval.set_at_s:
            notes.append("A pose was set on the way: the reference is not used.")
        else:
            actual = actual_error(interval, reference, plan.keep_s, plan.from_s or 0.0)
            if lag_s == 0.0:
                left_s = taken_off(poses_of(replayed, ""), reference, lag_s)[2]
            actual = replace(actual, lag_taken_s=taken_s, lag_left_s=left_s)
    if interval.set_at_s:
        at = ", ".join(f"{t_s:.1f}" for t_s in interval.set_at_s)
        notes.append(f"The pose was set from outside at {at} s.")
    return _explanation(source, replayed, interval, plan, actual, notes)


def _rejections(replayed: Replayed) -> list[str]:
    counters = replayed.counters.get("estimator", {})
    rejected, released = counters.get("rejected", 0), counters.get("released", 0)
    if not rejected + released:
        return []
    return [
        f"Of {rejected + counters['accepted']} comparisons of the headings in the whole recording {rejected} were "
        f"beyond the gate and not used; slip was assumed {released} times. The budget has no cause for what "
        "was wrong then."
    ]


def make_plan(source: Source, from_s: float | None, to_s: float | None, reference: Reference | None) -> Plan:
    """Plan the interval; with a reference it begins and ends at rows of it, where the error is known."""
    low, high = from_s if from_s is not None else source.first_s, to_s if to_s is not None else source.last_s
    for name, value_s in (("--from", from_s), ("--to", to_s)):
        if value_s is not None and not source.first_s <= value_s <= source.last_s:
            expected = f"a time within {source.first_s:.12g} to {source.last_s:.12g} s"
            raise ConfigError(str(source.path), name, expected, f"{value_s:.12g} s")
    if not low < high:
        raise ConfigError("--from, --to", "", "an interval of time", f"{low:.12g} to {high:.12g} s")
    if reference is None:
        return Plan(from_s, to_s, (), [])
    low, high = max(low, source.first_s), min(high, source.last_s)
    rows = reference.time_s[(reference.time_s >= low) & (reference.time_s <= high)]
    if len(rows) < 2:
        return Plan(
            from_s,
            to_s,
            (),
            [f"Of the reference {reference.name}, {len(rows)} rows lie in the interval: it is not used."],
        )
    near = np.searchsorted(rows, np.linspace(rows[0], rows[-1], KEPT + 1)[1:]).clip(1, len(rows) - 1)
    notes = []
    if rows[0] - low > 1.0 or high - rows[-1] > 1.0:
        notes.append(f"The interval is that of the reference's rows, {rows[0]:.2f} to {rows[-1]:.2f} s.")
    return Plan(float(rows[0]), float(rows[-1]), tuple(rows[np.unique(near)].tolist()), notes)


def _explanation(
    source: Source, replayed: Replayed, interval: Interval, plan: Plan, actual: Actual | None, notes: list[str]
) -> Explanation:
    snapshots = interval.snapshots
    rows = np.unique(np.linspace(0, len(snapshots) - 1, DRAWN).round().astype(int))
    drawn = [snapshots[row] for row in rows]
    last = snapshots[-1]
    causes = turned_covariance(last.covariance, -last.heading_rad)
    groups = by_group(causes)
    total = groups.sum(axis=0)
    variances = np.array([by_group(s.covariance)[:, range(3), range(3)] for s in drawn])
    return Explanation(
        recording=str(source.path),
        sha256=dict(replayed.inputs),
        digest=replayed.digest(),
        counts_from=_counts_from(interval, plan),
        from_s=round(snapshots[0].time_s, 6),
        to_s=round(last.time_s, 6),
        way_m=last.distance_m,
        groups=[_line(name, "", P, total) for name, P in zip(GROUPS, groups, strict=True)],
        causes=[_line(cause.group, cause.part, P, total) for cause, P in zip(CAUSES, causes, strict=True)],
        total=_line("all", "", total, total),
        delay=None if replayed.config.fog.protocol == "none" else _delay(snapshots, interval.delay_s),
        actual=actual,
        notes=notes,
        time_s=[round(s.time_s, 6) for s in drawn],
        way_series_m=rounded(np.array([s.distance_m for s in drawn])),
        position_m2=rounded(variances[:, :, 0] + variances[:, :, 1]),
        heading_deg2=rounded(variances[:, :, 2] * DEG_PER_RAD**2),
    )


def _counts_from(interval: Interval, plan: Plan) -> str:
    if interval.set_at_s:
        return f"the pose that was set at {interval.set_at_s[-1]:.1f} s"
    return "the filter's own start" if plan.from_s is None else "the pose at the beginning of the interval"


def _line(group: str, part: str, P: Array, total: Array) -> Line:
    along, across, heading = np.maximum(np.diag(P), 0.0).tolist()
    position_total, heading_total = float(total[0, 0] + total[1, 1]), float(total[2, 2])
    return Line(
        group,
        part,
        math.sqrt(along),
        math.sqrt(across),
        math.sqrt(along + across),
        math.sqrt(heading) * DEG_PER_RAD,
        (along + across) / position_total if position_total > 0.0 else 0.0,
        heading / heading_total if heading_total > 0.0 else 0.0,
    )


def _delay(snapshots: list[Snapshot], delay_s: float) -> Delay:
    errors = np.array([s.delay for s in snapshots])
    along_m, across_m = (rotation(-snapshots[-1].heading_rad) @ errors[-1, :2]).tolist()
    return Delay(
        delay_s,
        along_m,
        across_m,
        float(errors[-1, 2]) * DEG_PER_RAD,
        float(np.hypot(*errors[:, :2].T).max()),
        float(np.abs(errors[:, 2]).max()) * DEG_PER_RAD,
    )


def rounded(values: Array) -> Any:
    """Nested lists of DIGITS significant digits."""
    flat = [float(f"{v:.{DIGITS}g}") for v in values.ravel().tolist()]
    return np.reshape(flat, values.shape).tolist()
