"""Findings of the memory: a tyre that loses air over weeks, and one that was changed or pumped up. (100)"""

import math
from datetime import UTC, datetime
from typing import Final

from drd.effects.effect import SIDES
from drd.monitor.findings import Finding, Size, size
from drd.monitor.library import TRAVEL
from drd.monitor.memory import DAY_NS, FEWEST_DAYS, NAMED_ODDS, Day, Latest, Memory, latest
from drd.units import NS_PER_S

CHANGED: Final = "tyre_changed"
LEAK: Final = "tyre_deflation"
WEEK_DAYS: Final = 7.0
TOLD_DAYS: Final = 30.0  # a change of tyres is reported for this long
MOST_NATS: Final = 300.0  # prevents overflow
LEAST_SHARE: Final = 0.05  # of the likelier one's probability, above which the other is reported
SETTLE: Final = "measure both tyres' pressure"


def is_wear(finding: Finding) -> bool:
    """Whether a finding is from earlier days, not from this drive."""
    return finding.settle == SETTLE


def wear(memory: Memory, wall_zero_ns: int, now_ns: int) -> list[Finding]:
    """Findings over days. `wall_zero_ns`: the wall clock where the findings' clock, now `now_ns`, is 0."""
    days = memory.days
    # The newest day alone names nothing: the load may have been on one side.
    if len(days) < FEWEST_DAYS or not latest(days[:-1], TRAVEL).nats:
        return []
    last, clock = latest(days, TRAVEL), (wall_zero_ns, now_ns)
    if last.slope:
        return [_leak(days, last, clock)]
    age_days = (wall_zero_ns + now_ns - days[last.begin].wall_ns) / DAY_NS
    return [_change(days, last, clock)] if last.jump and age_days < TOLD_DAYS else []


def _leak(days: list[Day], last: Latest, clock: tuple[int, int]) -> Finding:
    begin_ns = days[last.begin].wall_ns
    weeks = (days[-1].wall_ns - begin_ns) / DAY_NS / WEEK_DAYS
    # If the left radius less the right one falls, it is the left tyre.
    side = SIDES[0] if last.slope < 0.0 else SIDES[1]
    week, std = WEEK_DAYS * abs(last.slope), WEEK_DAYS * math.sqrt(last.covariance[1, 1])
    text = f"The {side} tyre has been losing {100.0 * week:.2g} % of its radius a week since {_date(begin_ns)}."
    parameters: dict[str, Size | str] = {
        "side": side,
        "total": size(week * weeks, std * weeks, 1.0, "1"),
        "weekly": size(week, std, 1.0, "1"),
    }
    return _finding(LEAK, text, parameters, last, (begin_ns, None), clock)


def _change(days: list[Day], last: Latest, clock: tuple[int, int]) -> Finding:
    begin_ns = days[last.begin].wall_ns
    text = (
        f"A tyre was changed or pumped up between {_date(days[last.begin - 1].wall_ns)} and {_date(begin_ns)}: the "
        f"left radius less the right one went by {100.0 * last.jump:+.2g} %; what was known before is forgotten."
    )
    parameters: dict[str, Size | str] = {"left_less_right": size(last.jump, last.jump_std, 1.0, "1")}
    return _finding(CHANGED, text, parameters, last, (begin_ns, begin_ns), clock)


def _finding(
    effect: str,
    text: str,
    parameters: dict[str, Size | str],
    last: Latest,
    span_ns: tuple[int, int | None],
    clock: tuple[int, int],
) -> Finding:
    zero_ns, now_ns = clock
    begin_ns, end_ns = span_ns
    mine, other = (NAMED_ODDS * math.exp(min(nats, MOST_NATS)) for nats in (last.nats, last.other_nats))
    total = 1.0 + mine + other
    return Finding(
        effect=effect, text=text, parameters=parameters, probability=mine / total,
        also_fits=((LEAK if effect == CHANGED else CHANGED, other / total),) if other > LEAST_SHARE * mine else (),
        since_ns=begin_ns - zero_ns, since_std_s=max(last.begin_std_days, 0.5) * DAY_NS / NS_PER_S, since_m=0.0,
        until_ns=None if end_ns is None else end_ns - zero_ns, named_ns=now_ns, ruled_out=(), settle=SETTLE,
    )  # fmt: skip


def _date(wall_ns: int) -> str:
    return datetime.fromtimestamp(wall_ns / NS_PER_S, UTC).strftime("%Y-%m-%d")
