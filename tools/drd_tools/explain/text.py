"""Explanation as sentences and table rows, for the terminal and the page."""

import math
from collections.abc import Iterator
from typing import Final

from drd_tools.evaluate.lag import in_words
from drd_tools.explain.results import Actual, Explanation, Line
from drd_tools.limit import text as limit_text
from drd_tools.limit.causes import HELP, HELP_WITHOUT_GYRO
from drd_tools.report.terminal import metres

HEADER: Final = (
    "cause", "along / m", "across / m", "position / m", "% of var.", "heading / deg", "% of var.",
)  # fmt: skip
PARTS_HEADER: Final = ("cause", "position / m", "1 sigma", "heading / deg", "1 sigma")
UNLIKELY: Final = 0.01
ROUGH_DEG: Final = 10.0


def lead(e: Explanation) -> Iterator[str]:
    """Sentences that summarise the explanation."""
    yield (
        f"From {e.from_s:.2f} to {e.to_s:.2f} s, over {e.way_m:.4g} m, the position error grows to "
        f"{metres(e.total.position_m)} and the heading error to {e.total.heading_deg:.3g} deg (1 sigma), according to "
        f"the filter, relative to {e.counts_from}."
    )
    if max(map(sum, e.heading_deg2)) > ROUGH_DEG**2:
        yield (
            f"The heading is uncertain by more than {ROUGH_DEG:g} deg on the way, which is too much for a linear "
            "analysis: the metres are approximate."
        )
    yield _largest(e)
    yield from _help(e)
    if e.actual is not None:
        yield from _verdict(e.actual)
    if e.limit is not None:
        yield from limit_text.sentences(e.limit)


def _largest(e: Explanation) -> str:
    if e.way_m == 0.0 and e.total.heading_deg == 0.0:
        return "The robot has not moved."
    place = max(e.groups, key=lambda line: line.position_share)
    heading = max(e.groups, key=lambda line: line.heading_share)
    position = (
        f"Largest cause of the position error: {_named(e, place, 'position')}, {metres(place.position_m)}, "
        f"{100.0 * place.position_share:.3g} % of its variance"
    )
    if e.total.heading_deg == 0.0:
        return f"{position}."
    same = " as well" if heading is place else ""
    return (
        f"{position}. Largest cause of the heading error: {_named(e, heading, 'heading')}{same}, "
        f"{heading.heading_deg:.3g} deg, {100.0 * heading.heading_share:.3g} %."
    )


def _named(e: Explanation, group: Line, what: str) -> str:
    """Name of a group, with its largest part."""
    share = "position_share" if what == "position" else "heading_share"
    parts = [line for line in e.causes if line.group == group.group]
    most = max(parts, key=lambda line: float(getattr(line, share)))
    return group.group if len(parts) == 1 else f"{group.group} ({most.part})"


def _help(e: Explanation) -> Iterator[str]:
    names = [max(e.groups, key=lambda line: line.position_share), max(e.groups, key=lambda line: line.heading_share)]
    has_gyro = e.delay is not None
    known = HELP if has_gyro else HELP | HELP_WITHOUT_GYRO
    for name in dict.fromkeys(line.group for line in names if line.position_share + line.heading_share > 0.0):
        yield f"To reduce {name}: {known[name]}."


def _verdict(a: Actual) -> Iterator[str]:
    yield from in_words(a.lag_taken_s, a.lag_left_s)
    off_m = math.hypot(a.along_m, a.across_m)
    yield (
        f"The actual error is {metres(off_m)} (along {metres(a.along_m, '+')}, to the left "
        f"{metres(a.across_m, '+')}) and {a.heading_deg:+.3g} deg against {a.reference}; expected: "
        f"{metres(a.sigma_m)} and {a.sigma_deg:.3g} deg (1 sigma, with the reference's own noise)."
    )
    if a.p < UNLIKELY:
        yield (
            f"That is {_times(a)}: by the budget, the chance of an error this large is {_chance(a.p)}. The budget "
            f"expects {_share(off_m, a.sigma_m)} of the squared position error and "
            f"{_share(a.heading_deg, a.sigma_deg)} of the squared heading error. Something is missing from the "
            "filter's model, or its sigmas are too small."
        )
    else:
        yield f"That is within the budget (chance of an error at least as large: {_chance(a.p)})."
    if a.poses > 1 and a.course_p < UNLIKELY:
        yield (
            f"But the time history of the error, at {a.poses} times and together with the heading innovations, is not "
            f"one that the known causes can produce (chance {_chance(a.course_p)}): something is missing from the "
            "filter's model."
            if a.p >= UNLIKELY
            else f"Nor is the time history of the error, at {a.poses} times, one that the known causes can produce "
            f"(chance {_chance(a.course_p)})."
        )
    if not fits(a):
        yield "`drd diagnose` looks for it. Splitting the error among the known causes would explain nothing."
        return
    yield _most_likely(a)


def fits(a: Actual) -> bool:
    """Whether the budget can explain such an error, so that attributing it is meaningful."""
    return a.p >= UNLIKELY and a.course_p >= UNLIKELY


def _times(a: Actual) -> str:
    ratios = []
    if a.sigma_m > 0.0:
        ratios.append(f"{math.hypot(a.along_m, a.across_m) / a.sigma_m:.2g} times in position")
    if a.sigma_deg > 0.0:
        ratios.append(f"{abs(a.heading_deg) / a.sigma_deg:.2g} times in heading")
    return " and ".join(ratios)


def _share(error: float, sigma: float) -> str:
    return _percent(min(1.0, (sigma / error) ** 2)) if error else "all"


def _chance(p: float) -> str:
    return _percent(p) if p >= 1e-6 else "less than 1e-6"


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %" if share < 0.1 else f"{100.0 * share:.0f} %"


def _most_likely(a: Actual) -> str:
    off_m = math.hypot(a.along_m, a.across_m)
    part = max(a.parts, key=lambda p: p.position_m)
    clear = part.position_m > 2.0 * part.position_sigma_m
    text = (
        f"Most likely, {part.group} caused {metres(part.position_m)} of the {metres(off_m)}, "
        f"± {metres(part.position_sigma_m)} (1 sigma)"
    )
    if not clear:
        text += ", which is not significant: less than two sigma from zero"
    pairs = [" and ".join(pair) for pair in a.inseparable if part.group in pair]
    return text + (f"; this error does not distinguish {', nor '.join(pairs)}." if pairs else ".")


def budget_rows(e: Explanation, detailed: bool = False) -> list[list[str]]:
    """Rows of HEADER, largest first, then the total; `detailed`: each cause."""
    lines = [line for line in (e.causes if detailed else e.groups) if line.position_m or line.heading_deg]
    lines.sort(key=lambda line: -(line.position_share + line.heading_share))
    return [_row(line, detailed) for line in (*lines, e.total)]


def _row(line: Line, detailed: bool) -> list[str]:
    name = f"{line.group}: {line.part}" if detailed and line.part else line.group
    return [
        name,
        f"{line.along_m:.4f}",
        f"{line.across_m:.4f}",
        f"{line.position_m:.4f}",
        f"{100.0 * line.position_share:.1f}",
        f"{line.heading_deg:.4f}",
        f"{100.0 * line.heading_share:.1f}",
    ]


def silent_groups(e: Explanation) -> str:
    """Sentence on the groups without a contribution."""
    names = [line.group for line in e.groups if not line.position_m and not line.heading_deg]
    return f"No contribution: {', '.join(names)}." if names else ""


def parts_rows(a: Actual) -> list[list[str]]:
    """Rows of PARTS_HEADER, then the total, which is the actual error."""
    parts = [p for p in a.parts if p.position_sigma_m or p.heading_sigma_deg]
    rows = [
        [
            p.group,
            f"{p.position_m:+.4f}",
            f"{p.position_sigma_m:.4f}",
            f"{p.heading_deg:+.4f}",
            f"{p.heading_sigma_deg:.4f}",
        ]
        for p in sorted(parts, key=lambda p: -abs(p.position_m))
    ]
    total_m, total_deg = sum(p.position_m for p in a.parts), sum(p.heading_deg for p in a.parts)
    return [*rows, ["all", f"{total_m:+.4f}", "", f"{total_deg:+.4f}", ""]]


def parts_caption(a: Actual) -> str:
    """Caption of the table of the parts."""
    text = (
        "Most likely part of each cause in the actual error, given the error "
        + (f"at {a.poses} times " if a.poses > 1 else "at the end ")
        + "and the heading innovations. Position parts are components along the position error."
    )
    if a.poses == 1:
        text += " The path before is not used, since the accuracy of the reference is not stated (--reference-sigma)."
    return text


def delay_sentence(e: Explanation) -> str:
    """Sentence on the effect of a late gyro; empty without a gyro."""
    if e.delay is None:
        return ""
    d = e.delay
    return (
        f"If the gyro were {1000.0 * d.delay_s:.0f} ms late (not in the budget): {metres(d.along_m, '+')} along, "
        f"{metres(d.across_m, '+')} to the left and {d.heading_deg:+.2g} deg at the end, at most "
        f"{metres(d.largest_m)} and {d.largest_deg:.2g} deg on the way; other delays proportionally."
    )
