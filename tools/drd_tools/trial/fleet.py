"""`drd trial --fleet`: how often the statistics of a fleet are right, evening by evening.

`judged` draws a fleet and analyses the data available on each evening, as a nightly job would; `tables` counts.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

import msgspec
import numpy as np
from msgspec import Struct

from drd.monitor.findings import Z_90
from drd_tools.fleet.events import Event
from drd_tools.fleet.histories import BEGIN, RADII, Drive, Fleet, Happening, draw, maintenance_rows, summaries, table
from drd_tools.fleet.population import Population
from drd_tools.fleet.series import S_PER_DAY, day_of, logs, maintained
from drd_tools.fleet.statistics import Statistics, analyse_logs
from drd_tools.trial.figures import Table
from drd_tools.trial.score import wilson
from drd_tools.trial.workers import completed

ROBOTS, DAYS = 40, 90
FIRST: Final = 5  # evening; before it there is no population
REFITTED: Final = 7  # days between estimates of the population
IN_TIME: Final = 3  # recordings
DATED: Final = 1  # recordings
NEAR: Final = 3  # recordings by which a change may be misdated and still be that change
GROUP_NEAR: Final = 7.0  # days; the same for a floor or a batch
BEGIN_DAY: Final = BEGIN.timestamp() / S_PER_DAY


class Change(Struct, frozen=True, kw_only=True):
    """A true change of a robot's constant, and how it was reported. `after`: recordings until it was found."""

    who: str
    name: str
    kind: str
    form: str
    size: float
    day: float
    has_maintenance: bool
    after: int | None = None
    off: int | None = None
    is_own: bool | None = None
    sigmas: float | None = None
    is_inside: bool | None = None


class FleetRow(Struct, frozen=True, kw_only=True):
    """Result of one fleet. `false`: reports of changes that do not exist; `misled`: a robot blamed for its group's."""

    seed: int
    robot_days: float
    recordings: int
    changes: list[Change]
    false: list[str]
    misled: list[str]
    groups: list[tuple[str, str, float, float | None]]
    last: list[str]


@dataclass
class Said:
    """An event as reported: first on the evening `since`, most recently as `event`."""

    since: int
    event: Event


def run(seeds: Sequence[int], jobs: int, robots: int = ROBOTS, days: int = DAYS) -> Iterator[FleetRow]:
    """Yield rows as they become ready."""
    return completed([partial(judged, seed, robots, days) for seed in seeds], jobs)


def judged(seed: int, robots: int = ROBOTS, days: int = DAYS) -> FleetRow:
    """Draw a fleet and analyse it evening by evening, blind."""
    fleet = draw(robots, days, seed)
    every, done = logs(table(summaries(fleet, seed))), maintained(maintenance_rows(fleet))
    known: dict[str, Population] = {}
    said: list[Said] = []
    blamed: dict[tuple[str, str, str], float] = {}
    final: Statistics | None = None
    for evening in range(FIRST, days + 1):
        until = BEGIN_DAY + evening
        now = {name: log.until(until) for name, log in every.items()}
        is_fresh = (evening - FIRST) % REFITTED == 0 or evening == days
        final = analyse_logs(now, [d for d in done if d.day <= until], None if is_fresh else known)
        known = {name: f.population for name, f in final.fitted.items()}
        _note(said, final.found, evening)
        for name, f in final.fitted.items():
            for step in f.population.steps:
                who = (f.log.places if step.kind == "place" else f.log.batches)[step.which]
                blamed[step.kind, who, name] = step.day - BEGIN_DAY
    return _scored(seed, fleet, said, blamed, final)


def _note(said: list[Said], found: Sequence[Event], evening: int) -> None:
    """Record events; one that is reported again is the same if its dates overlap."""
    for event in found:
        for old in said:
            o = old.event
            if (o.robot, o.name, o.size > 0) == (event.robot, event.name, event.size > 0) and (
                event.low <= o.high + 1.0 and o.low <= event.high + 1.0
            ):
                old.event = event
                break
        else:
            said.append(Said(evening, event))


def _truths(fleet: Fleet, days: list[Drive]) -> Iterator[tuple[Happening, float, float]]:
    """Changes of single robots, with size and day; the end of one counts as another, in reverse."""
    end = max(d.day for d in days)
    for h in fleet.happenings:
        if h.kind == "robot":
            yield h, h.size, h.day
            if h.until is not None and h.until < end:
                yield h, -h.size, h.until


def _scored(
    seed: int, fleet: Fleet, said: list[Said], blamed: dict[tuple[str, str, str], float], final: Statistics | None
) -> FleetRow:
    begins = {robot: [d.start_utc for d in fleet.drives if d.robot == robot] for robot in fleet.batch}
    by_robot = {robot: np.array([day_of(start) - BEGIN_DAY for start in own]) for robot, own in begins.items()}
    used: set[int] = set()
    changes = []
    for h, size, day in _truths(fleet, fleet.drives):
        times = by_robot[h.who]
        true_k = int(np.searchsorted(times, day))
        if true_k < 1 or true_k >= len(times):
            continue
        is_creep = h.form == "creep" and day == h.day
        mine = []
        for i, s in enumerate(said):
            e = s.event
            if (e.robot, e.name) != (h.who, h.name) or (e.size > 0) != (size > 0):
                continue
            k = int(np.searchsorted(times, e.day - BEGIN_DAY - 1e-6))
            low_k, high_k = true_k - NEAR, true_k + NEAR
            if is_creep:  # it may be noticed at any time while it grows
                low_k, high_k = low_k - NEAR, int(np.searchsorted(times, h.until or np.inf))
            if low_k <= k <= high_k:
                mine.append((i, k))
        used |= {i for i, _ in mine}
        changes.append(_change(h, size, day, times, true_k, is_creep, [(said[i], k) for i, k in mine], fleet))
    groups = [(h.kind, h.who, h.day, _blame(blamed, h)) for h in fleet.happenings if h.kind != "robot" and h.day > 0]
    false, misled = list[str](), list[str]()
    for i, s in enumerate(said):
        if i in used or (s.event.cause != "robot" and _is_group(s.event, fleet)):
            continue
        (misled if _is_group(s.event, fleet) else false).append(_line(s))
    for (kind, who, name), day in blamed.items():
        if not any((h.kind, h.who, h.name) == (kind, who, name) and abs(h.day - day) <= GROUP_NEAR
                   for h in fleet.happenings):  # fmt: skip
            false.append(f"{kind} {who} {name} from day {day:.0f}")
    days = float(np.ceil(max(d.day for d in fleet.drives)))
    return FleetRow(
        seed=seed, robot_days=len(fleet.batch) * days, recordings=len(fleet.drives), changes=changes, false=false,
        misled=misled, groups=groups, last=[] if final is None else [f"{e.robot} {e.name}" for e in final.found],
    )  # fmt: skip


def _change(
    h: Happening, size: float, day: float, times: np.ndarray, true_k: int, is_creep: bool,
    mine: list[tuple[Said, int]], fleet: Fleet,
) -> Change:  # fmt: skip
    date = int(np.floor(day))
    log = any(row["robot"] == h.who and (row["date"] - BEGIN).days == date for row in maintenance_rows(fleet))
    base = Change(who=h.who, name=h.name, kind="back" if day != h.day else "begin",
                  form="creep" if is_creep else "step", size=size, day=day, has_maintenance=log)  # fmt: skip
    if not mine:
        return base
    s, k = min(mine, key=lambda one: one[0].since)
    begin_k = true_k
    if is_creep and h.until is not None:  # counted from the loss for which the goals are stated
        full = day + (h.until - day) * min(1.0, 0.005 / abs(h.size))
        begin_k = int(np.searchsorted(times, full))
    after = int(np.searchsorted(times, s.since)) - begin_k
    e = s.event
    return msgspec.structs.replace(
        base, after=after, off=k - true_k, is_own=e.cause == "robot",
        sigmas=None if is_creep else float((e.size - size) / e.sigma),
        is_inside=bool(e.low - BEGIN_DAY <= times[true_k] + 1e-6 and times[true_k - 1] - 1e-6 <= e.high - BEGIN_DAY),
    )  # fmt: skip


def _blame(blamed: dict[tuple[str, str, str], float], h: Happening) -> float | None:
    day = blamed.get((h.kind, h.who, h.name))
    return None if day is None else day - h.day


def _is_group(e: Event, fleet: Fleet) -> bool:
    """Whether an event is a change of the robot's place or batch."""
    mine, day = {*fleet.places[e.robot], fleet.batch[e.robot]}, e.day - BEGIN_DAY
    groups = [h for h in fleet.happenings if h.kind != "robot" and h.name == e.name and h.who in mine]
    return any(abs(day - h.day) <= GROUP_NEAR for h in groups)


def _line(s: Said) -> str:
    e = s.event
    return (
        f"evening {s.since}: {e.robot} {e.name} {e.form} {e.size:+.4g} +- {e.sigma:.2g} since day "
        f"{e.day - BEGIN_DAY:.1f}, {e.probability:.3f}, {e.cause} {e.causes[e.cause]:.2f}"
    )


def tables(rows: Sequence[FleetRow]) -> list[Table]:
    """Tables of the changes found, with their delay, and of false ones."""
    every = [c for r in rows for c in r.changes]
    radii = [c for c in every if c.name in RADII and c.form == "step"]
    kinds = {
        "a radius by 0.5 %": [c for c in radii if abs(c.size) < 0.0051],
        "a radius by more": [c for c in radii if abs(c.size) >= 0.0051],
        "of these, with a line in the log": [c for c in radii if c.has_maintenance],
        "a leak (counted from a loss of 0.5 %)": [c for c in every if c.form == "creep"],
        "tread": [c for c in every if c.name == "tread"],
        "gyro scale": [c for c in every if c.name == "gyro_scale"],
    }
    header = ["change of", "n", f"found in {IN_TIME}", "95 %", "ever", "dated to 1", "right cause", "interval holds"]
    return [
        Table("Changes of single robots", header, [_counted(name, c) for name, c in kinds.items() if c]),
        _false(rows, every),
    ]


def _counted(name: str, changes: Sequence[Change]) -> list[str]:
    n, found = len(changes), [c for c in changes if c.after is not None]
    timely = sum(c.after is not None and c.after <= IN_TIME for c in changes)
    low, high = wilson(timely, n)

    def share(values: Sequence[bool | None]) -> str:
        return f"{sum(map(bool, values)) / len(values):.3f}" if values else ""

    return [
        name, str(n), f"{timely / n:.3f}", f"{low:.2f}..{high:.2f}", f"{len(found) / n:.3f}",
        share([c.off is not None and abs(c.off) <= DATED for c in found]), share([c.is_own for c in found]),
        share([c.is_inside for c in found]),
    ]  # fmt: skip


def _false(rows: Sequence[FleetRow], every: Sequence[Change]) -> Table:
    days = sum(r.robot_days for r in rows)
    false, misled = sum(len(r.false) for r in rows), sum(len(r.misled) for r in rows)
    sigmas = np.array([c.sigmas for c in every if c.sigmas is not None])
    groups = [g for r in rows for g in r.groups]
    lines = [
        ["robot-days; recordings", f"{days:.0f}; {sum(r.recordings for r in rows)}"],
        ["false alarms", f"{false}: {1e3 * false / days:.2f} in 1,000 robot-days"],
        ["a robot blamed for its floor or batch", f"{misled}: {1e3 * misled / days:.2f} in 1,000 robot-days"],
        ["floors and batches that change: found", f"{sum(g[3] is not None for g in groups)} of {len(groups)}"],
        ["sizes within 1.645 sigma (0.90)", f"{(np.abs(sigmas) < Z_90).sum()} of {len(sigmas)}"],
    ]
    return Table("What is not there, and honesty", ["figure", ""], lines)


def lines(rows: Sequence[FleetRow]) -> list[str]:
    """Each miss, late find, wrong date or cause, and false alarm."""
    found = []
    for r in sorted(rows, key=lambda r: r.seed):
        found += [f"seed {r.seed}: FALSE {text}" for text in r.false]
        found += [f"seed {r.seed}: MISLED {text}" for text in r.misled]
        found += [f"seed {r.seed}: group {g[0]} {g[1]} day {g[2]:.1f} not found" for g in r.groups if g[3] is None]
        for c in r.changes:
            if c.after is None or c.after > IN_TIME or not c.is_own or abs(c.off or 0) > DATED:
                what = "MISSED" if c.after is None else f"after {c.after}, date off {c.off}, own {c.is_own}"
                found.append(f"seed {r.seed}: {c.who} {c.name} {c.form} {c.kind} {c.size:+.4f} day {c.day:.1f}: {what}")
    return found
