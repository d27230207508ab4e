"""The figures of `drd trial --live`, and their page."""

import math
from collections.abc import Sequence
from statistics import NormalDist
from typing import Final

import numpy as np
from scipy.stats import chi2

from drd.monitor.findings import Z_90
from drd.monitor.library import UNKNOWN
from drd_tools.trial.figures import Table
from drd_tools.trial.live import LiveRow
from drd_tools.trial.live_cases import DISTANCES, NULLS, WAY_M, seen_live
from drd_tools.trial.score import calibration_error, exact_error, wilson

GOAL_S: Final = 1000.0 * 3600.0  # between false names
HEADER: Final = [
    "", "n", "in time", "95 %", "ceiling", "told", "ever", "unknown", "wrong too", "onset off, s",
    "named after, s",
]  # fmt: skip


def tables(rows: Sequence[LiveRow]) -> list[Table]:
    """Tables by d, by effect, of false names, and of the calibration of probabilities and intervals."""
    made = [r for r in rows if r.is_made]
    effects = [r for r in made if r.case.kind not in NULLS]
    by_d = [_line(f"d={d:g}" if d else "events", [r for r in effects if r.case.d == d]) for d in (*DISTANCES, 0.0)]
    by_effect = [_line(e.id, [r for r in effects if r.case.kind == e.id]) for e in seen_live()]
    return [
        Table(f"By whitened distance (of {WAY_M:g} m)", HEADER, [x for x in by_d if x]),
        Table("By effect", HEADER, [x for x in by_effect if x]),
        _nulls(made),
        _honesty(rows, made, effects),
    ]


def ceiling(d: float, seconds: float) -> float:
    """Highest probability that a detector names an effect of detectability d, `seconds` after its onset. (98)

    The detector knows form and size, watches as many effects as are drawn, and gives one false name in GOAL_S.
    """
    if d <= 0.0:
        return 0.0
    alike_s = 4.0 * seconds / d**2
    return NormalDist().cdf(0.5 * d - math.log(GOAL_S * len(seen_live()) / alike_s) / d)


def most_by_chance(count: int) -> float:
    """Mean of the Poisson distribution that gives at most `count` with a probability of 5 %."""
    return float(0.5 * chi2.ppf(0.95, 2 * count + 2))


def _line(name: str, rows: Sequence[LiveRow]) -> list[str]:
    if not rows:
        return []
    rights = [(r, s) for r in rows if (s := r.right) is not None]
    timely = sum(r.is_timely for r in rows)
    low, high = wilson(timely, len(rows))
    ceilings = [ceiling(r.seen_d, r.limit_s - (r.begin_s or 0.0)) for r in rows if r.case.d]
    off = [abs(s.since_s - (r.begin_s or 0.0)) for r, s in rights]
    late = [s.named_s - (r.begin_s or 0.0) for r, s in rights]
    return [
        name,
        str(len(rows)),
        f"{timely / len(rows):.2f}",
        f"{low:.2f}..{high:.2f}",
        f"{np.mean(ceilings):.2f}" if ceilings else "",
        f"{sum(r.is_told for r in rows) / len(rows):.2f}",
        f"{len(rights) / len(rows):.2f}",
        str(sum(any(s.effect == UNKNOWN for s in r.said) for r in rows)),
        str(sum(s.is_wrong for r in rows for s in r.said)),
        f"{np.median(off):.1f}" if off else "",
        f"{np.median(late):.0f}" if late else "",
    ]


def _nulls(made: Sequence[LiveRow]) -> Table:
    lines = []
    for kind in NULLS:
        own = [r for r in made if r.case.kind == kind]
        hours, wrong = sum(r.hours for r in own), sum(s.is_wrong for r in own for s in r.said)
        unknown = sum(s.effect == UNKNOWN for r in own for s in r.said)
        suspected = sum(len(r.suspected_s) for r in own)
        timely = sum(r.is_timely for r in own) if any(r.begin_s is not None for r in own) else ""
        if own:
            counts = (f"{1e3 * wrong / hours:.0f}", f"{1e3 * most_by_chance(wrong) / hours:.0f}")
            lines.append(
                [kind, f"{len(own)}", f"{hours:.1f}", f"{wrong}", *counts, f"{unknown}", f"{suspected}", f"{timely}"]
            )
    header = ["kind", "n", "hours", "false names", "in 1,000 hours", "at most (95 %)", "unknown", "suspected"]
    header += ["in time"]
    return Table("Nothing to be named (or, on floors, other ground only)", header, lines)


def _honesty(rows: Sequence[LiveRow], made: Sequence[LiveRow], effects: Sequence[LiveRow]) -> Table:
    sigmas = [x for r in effects for x in r.sigmas]
    # The final name and its probability.
    pairs = [(s.probability, s.effect == r.case.kind) for r in effects if (s := r.right) is not None]
    pairs += [(s.probability, s.effect == r.case.kind and s.named_s >= (r.begin_s or 0.0))
              for r in made for s in r.said if s.is_wrong]  # fmt: skip
    inside = sum(abs(x) <= Z_90 for x in sigmas) / max(len(sigmas), 1)
    cost = float(np.mean([r.cost_ms_per_s for r in made])) if made else 0.0
    lines = [
        ["truth within the 90 % intervals", f"{inside:.2f} of {len(sigmas)}"],
        ["expected calibration error of the names' probabilities", f"{calibration_error(pairs):.3f} of {len(pairs)}"],
        ["the same if each probability were exact, mean", f"{exact_error([p for p, _ in pairs]):.3f}"],
        ["cost, ms of a core per second of data", f"{cost:.1f}"],
        ["not made: at no plausible size it shows so well", str(len(rows) - len(made))],
    ]
    return Table("Honesty, and cost", ["figure", ""], lines)


def lines(rows: Sequence[LiveRow]) -> list[str]:
    """Lines on each case with a wrong name, or not named in time."""
    found = []
    for r in rows:
        is_late = r.case.kind not in NULLS and not r.is_timely
        if r.is_made and (is_late or any(s.is_wrong for s in r.said)):
            said = "; ".join(
                f"{s.named_s:.0f} s {s.effect} {s.probability:.2f}{' (' + ', '.join(s.alike) + ')' if s.alike else ''}"
                f"{' WRONG' if s.is_wrong else ''}"
                for s in r.said
            )
            found.append(
                f"{r.case.name}: from {r.begin_s or 0.0:.0f} s, in time until {r.limit_s:.0f} s: {said or '-'}"
            )
    return found
