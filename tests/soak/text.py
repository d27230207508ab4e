"""The run's table and verdict, as text and as JSON."""

import dataclasses
import json
import math
from collections.abc import Iterator, Sequence
from statistics import median
from typing import Any, Final

from bench.cpu import BYTES_PER_MIB

from drd_tools.report.terminal import columns
from soak.monitor import HOUR_S, Cost
from soak.run import Found, Soak
from soak.world import LAP_S

# A share of 1 % of all poses may lie beyond a bound that holds 99 %; neighbours go wrong together, so it scatters.
BEYOND_LIMIT: Final = 0.02
# Python's caches and the results themselves.
BLOCKS_LIMIT: Final = 3000
RESIDENT_LIMIT_MIB: Final = 3.0
MONITOR_LIMIT_MIB: Final = 150.0
MONITOR_LIMIT_SHARE: Final = 0.03  # of a core
HEADINGS: Final = (
    "fault", "times", "for s", "detected after s", "(limit)", "named", "recovered after s", "error/bound",
)  # fmt: skip


def failures(soak: Soak) -> list[str]:
    """What the run was to show and did not; empty: all was shown."""
    found = [f"the counter {row.name} says {row.counted}, {row.expected} were sent" for row in soak.drifted]
    for f in soak.found:
        if f.fault.unseen:
            continue
        late = [s for s in f.detected_s if s > f.fault.within_s]
        if f.fault.named and late:
            found.append(f"{f.fault.name}: {len(late)} of {len(f.detected_s)} not named within {f.fault.within_s:g} s")
        if f.beyond > BEYOND_LIMIT * f.valid:
            found.append(f"{f.fault.name}: {f.beyond} of {f.valid} valid poses beyond their bound")
    if soak.early:
        found.append(f"named while nothing was wrong: {', '.join(sorted(soak.early))}")
    if (grown := blocks_grown(soak)) is not None and grown > BLOCKS_LIMIT:
        found.append(f"{grown} more blocks of memory live at the end than after the first round")
    if (more_mib := resident_grown_mib(soak)) is not None and more_mib > RESIDENT_LIMIT_MIB:
        found.append(f"{more_mib:.1f} MiB more resident at the end than after the first round")
    if soak.monitor is not None:
        found += _monitor_failures(soak.monitor)
    return found


def _monitor_failures(cost: Cost) -> Iterator[str]:
    if cost.gaps:
        yield f"the monitor was told of {cost.gaps} gaps, and none was sent"
    if not cost.resident_mb:
        return
    first_mib, last_mib, most_mib = _levels_mib(cost)
    if most_mib > MONITOR_LIMIT_MIB:
        yield f"the monitor took {most_mib:.1f} MiB"
    if last_mib - first_mib > RESIDENT_LIMIT_MIB:
        yield f"the monitor has {last_mib - first_mib:.1f} MiB more in the last quarter than in the first"
    if (share := _share(cost)) > MONITOR_LIMIT_SHARE:
        yield f"the monitor took {100.0 * share:.1f} % of a core"


def _levels_mib(cost: Cost) -> tuple[float, float, float]:
    """Resident memory: the least of the first quarter's hours and of the last one's, and the most of all.

    The least, for some MiB come and go with what is told.
    """
    mib = [1e6 * mb / BYTES_PER_MIB for mb in cost.resident_mb]
    quarter = max(1, len(mib) // 4)
    return min(mib[:quarter]), min(mib[-quarter:]), max(mib)


def _share(cost: Cost) -> float:
    """Share of a core over all whole hours."""
    return cost.cpu_s[-1] / (HOUR_S * len(cost.cpu_s))


def blocks_grown(soak: Soak) -> int | None:
    """Live blocks at the end more than after the first round; None: there was only one."""
    return soak.blocks[-1] - soak.blocks[0] if len(soak.blocks) > 1 else None


def resident_grown_mib(soak: Soak) -> float | None:
    """The same of resident memory."""
    return soak.resident_mib[-1] - soak.resident_mib[0] if len(soak.resident_mib) > 1 else None


def table(soak: Soak) -> str:
    """All of it."""
    return "\n".join([*columns([HEADINGS, *map(_row, soak.found)], text=(0, 5), indent=""), "", *_sentences(soak)])


def _row(f: Found) -> Sequence[str]:
    fault = f.fault
    limit = f"({fault.within_s:g})" if fault.named else ""
    named = ", ".join(name for name in fault.named if name in f.also) or ("nothing" if fault.named else "-")
    worst = "-" if not f.worst else f"{f.worst:.2f}" + ("*" if fault.unseen else "")
    detected = _times(f.detected_s) if fault.named else "-"
    times, seconds, recovered = str(len(f.detected_s)), f"{fault.seconds:g}", _times(f.recovered_s)
    return fault.name, times, seconds, detected, limit, named, recovered, worst


def _times(seconds: Sequence[float]) -> str:
    """Median and worst."""
    return "-" if not seconds else f"{_s(median(seconds))} / {_s(max(seconds))}"


def _s(seconds: float) -> str:
    return "never" if math.isinf(seconds) else f"{seconds:.2f}"


def _sentences(soak: Soak) -> Iterator[str]:
    yield "detected, recovered: median / worst; never: not before the lap's end, where a pose is set from outside"
    yield f"error/bound: largest of the valid poses from the fault's onset to the end of its lap of {LAP_S:g} s"
    for reason in dict.fromkeys(f.fault.unseen for f in soak.found if f.fault.unseen):
        names = ", ".join(f.fault.name for f in soak.found if f.fault.unseen == reason)
        yield f"* {names}: not judged, a known limit: {reason}"
    for what, rows in (("judged", [f for f in soak.found if not f.fault.unseen]), ("all", soak.found)):
        valid, beyond = sum(f.valid for f in rows), sum(f.beyond for f in rows)
        share = 100.0 * beyond / max(1, valid)
        yield f"valid poses from the onset on, {what} faults: {valid}; {beyond} ({share:.3f} %) beyond the 99 % bound"
    same = len(soak.rows) - len(soak.drifted)
    yield f"counters: {same} of {len(soak.rows)} say what was sent, over {soak.seconds / 3600.0:.2f} h"
    if len(soak.blocks) > 1:
        yield (
            f"memory: {soak.resident_mib[0]:.1f} MiB after the first round, {soak.resident_mib[-1]:.1f} at the end; "
            f"live blocks {soak.blocks[0]} and {soak.blocks[-1]}"
        )
    if soak.monitor is not None and soak.monitor.resident_mb:
        cost, (first_mib, last_mib, most_mib) = soak.monitor, _levels_mib(soak.monitor)
        yield (
            f"monitor: {first_mib:.1f} MiB at least in the first quarter, {last_mib:.1f} in the last, {most_mib:.1f} "
            f"at most; {100.0 * _share(cost):.2f} % of a core"
        )
        yield f"monitor: judging in {100.0 * cost.judging / cost.reports:.0f} % of {cost.reports} reports"
    yield f"took {soak.took_s:.0f} s: {soak.seconds / soak.took_s:.0f} times real time, truth and sensors included"
    wrong = failures(soak)
    yield "all was shown" if not wrong else "NOT SHOWN:"
    yield from (f"  {text}" for text in wrong)


def as_json(soak: Soak) -> str:
    """The figures, with null for what was never seen."""
    content: dict[str, Any] = {f.name: getattr(soak, f.name) for f in dataclasses.fields(soak)}
    content["rows"] = [row._asdict() for row in soak.rows]
    content["early"] = sorted(soak.early)
    content["monitor"] = None if soak.monitor is None else dataclasses.asdict(soak.monitor)
    content["failures"] = failures(soak)
    content["found"] = [
        {
            "fault": f.fault.name,
            "seconds": f.fault.seconds,
            "named": list(f.fault.named),
            "within_s": f.fault.within_s,
            "detected_s": _plain(f.detected_s),
            "recovered_s": _plain(f.recovered_s),
            "also": sorted(f.also),
            "valid": f.valid,
            "beyond": f.beyond,
            "worst": f.worst,
            "worst_all": f.worst_all,
        }
        for f in soak.found
    ]
    return json.dumps(content, indent=1, allow_nan=False) + "\n"


def _plain(seconds: Sequence[float]) -> list[float | None]:
    return [None if math.isinf(s) else round(s, 3) for s in seconds]
