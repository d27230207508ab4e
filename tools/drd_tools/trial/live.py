"""`drd trial --live`: how often the monitor is right while a robot drives.

`judged` simulates a case and monitors it, blind; `run` does all; `live_cases` draws them, `live_figures` counts.
"""

import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Final

import msgspec
from msgspec import Struct

from drd.batch.monitored import monitor_logs
from drd.config.schema import ConfigError
from drd.effects.catalogue import catalogue
from drd.effects.effect import Effect, Values
from drd.monitor.constants import KNOWN_SIGMAS, Constants
from drd.monitor.findings import Size
from drd.monitor.library import UNKNOWN
from drd.monitor.monitor import Monitor
from drd.monitor.telling import Known
from drd.units import NS_PER_S
from drd_tools.build import fingerprint
from drd_tools.replay.nominal import configuration
from drd_tools.trial.live_cases import TURN_S, Case, drawn
from drd_tools.trial.workers import completed

RESULTS: Final = "live.jsonl"
OLD: Final = "live.old.jsonl"
REMEMBERED: Final = Constants(dict.fromkeys(KNOWN_SIGMAS, 0.0), KNOWN_SIGMAS)  # of a robot that has not changed
# Indistinguishable without a reference: all change scale times tread, whenever and wherever it begins.
ALIKE: Final = frozenset({"tread_error", "gyro_scale_error", "terrain_tread"})


class Said(Struct, frozen=True):
    """A finding: when it was named, its onset, its look-alikes, and the final probability of its first name.

    `is_wrong`: for some time neither its name nor one of its look-alikes was right, or nothing had begun.
    """

    effect: str
    alike: tuple[str, ...]
    probability: float
    named_s: float
    since_s: float
    is_wrong: bool


class LiveRow(Struct, frozen=True, kw_only=True):
    """The monitor's answer to a case. `begin_s`: the effect's onset, or None if there is none. `limit_s`: deadline.

    `seen_d`: detectability of the effect by then. `suspected_s`: when each suspicion began. `sigmas`: errors of the
    parameters over their own standard deviations, in the finding with the right name. `build`: the monitor's.
    """

    case: Case
    build: str = ""
    begin_s: float | None = None
    limit_s: float = 0.0
    seen_d: float = 0.0
    hours: float = 0.0
    parameters: dict[str, float | str] = {}
    said: list[Said] = []
    suspected_s: list[float] = []
    sigmas: list[float] = []
    cost_ms_per_s: float = 0.0
    is_made: bool = True

    @property
    def right(self) -> Said | None:
        """The first finding whose class contains the right name."""
        return next((s for s in self.said if not s.is_wrong and s.effect != UNKNOWN), None)

    @property
    def is_timely(self) -> bool:
        """Whether the right finding came in time."""
        return self.right is not None and self.right.named_s <= self.limit_s + TURN_S

    @property
    def is_told(self) -> bool:
        """Whether a right finding or a suspicion came in time."""
        begin_s = self.begin_s or 0.0
        told_s = [s.named_s for s in self.said if not s.is_wrong] + self.suspected_s
        return any(begin_s <= s <= self.limit_s + TURN_S for s in told_s)


class Watch:
    """Record of the monitor's findings and suspicions, as they come."""

    def __init__(self, right: frozenset[str], begin_s: float):
        self._right, self._begin_s = right, begin_s
        self.said: dict[int, Said] = {}
        self.suspected_s: list[float] = []
        self._suspects = False
        self._known: dict[int, Known] = {}  # kept, so that no identity is used twice
        self._now_s = -1.0

    def __call__(self, monitor: Monitor) -> None:
        """Look at the monitor after a sample."""
        if monitor.now_s == self._now_s:
            return
        self._now_s = monitor.now_s
        suspects = monitor.suspected() is not None
        if suspects and not self._suspects:
            self.suspected_s.append(monitor.now_s)
        self._suspects = suspects
        for known in monitor.known:
            name, near = monitor.hypotheses[known.hypothesis].id, monitor.alike(known)
            self._known[id(known)], before = known, self.said.get(id(known))
            is_wrong = name != UNKNOWN and (self._right.isdisjoint({name, *near}) or known.named_s < self._begin_s)
            is_wrong |= before is not None and before.is_wrong
            p = known.probabilities.get(name, 0.0)
            self.said[id(known)] = Said(name, tuple(near), p, known.named_s, known.begin_s, is_wrong)


class Kept:
    """Rows in a folder, a line of JSON each, added as they become ready, so that a stopped trial can resume."""

    def __init__(self, folder: Path):
        self._file = folder / RESULTS
        self._build = fingerprint("drd.effects", "drd.monitor", "drd_tools.simulate", "drd_tools.trial.live_cases")

    def begin(self) -> set[Case]:
        """Return the cases already done; results of another build are moved aside. Raises ConfigError, OSError."""
        self._file.parent.mkdir(parents=True, exist_ok=True)
        rows = self.read() if self._file.exists() else []
        if any(row.build != self._build for row in rows):
            self._file.replace(self._file.with_name(OLD))
            rows = []
        self._file.write_bytes(b"".join(map(_line, rows)))  # drops a truncated last line
        return {row.case for row in rows}

    def add(self, row: LiveRow) -> None:
        """Keep a row. Raises OSError."""
        with self._file.open("ab") as out:
            out.write(_line(msgspec.structs.replace(row, build=self._build)))

    def read(self) -> list[LiveRow]:
        """Read the rows; a truncated last line does not count. Raises ConfigError."""
        try:
            lines = self._file.read_bytes().split(b"\n")[:-1]
            return [msgspec.json.decode(line, type=LiveRow) for line in lines]
        except (OSError, ValueError) as error:
            raise ConfigError(str(self._file), "", "results of drd trial --live", str(error)) from error


def _line(row: LiveRow) -> bytes:
    return msgspec.json.encode(row) + b"\n"


def run(cases: Sequence[Case], jobs: int) -> Iterator[LiveRow]:
    """Yield rows as they become ready."""
    return completed([partial(judged, case) for case in cases], jobs)


def judged(case: Case) -> LiveRow:
    """Simulate a case and monitor it."""
    one = drawn(case)
    if one is None:
        return LiveRow(case=case, is_made=False)
    recording, right = one.recording, _names(one.effect)
    watch = Watch(right, one.begin_s or 0.0)
    began_s = time.process_time()
    made = monitor_logs(
        recording.fog, recording.encoders, configuration(recording), watch, REMEMBERED if case.remembers else None
    )
    took_s = time.process_time() - began_s
    zero_s, first_s = made.zero_ns / NS_PER_S, (made.monitor.zero_ns or made.zero_ns) / NS_PER_S
    later_s = first_s - zero_s
    said = [
        msgspec.structs.replace(s, named_s=s.named_s + later_s, since_s=s.since_s + later_s)
        for s in watch.said.values()
    ]
    said += [
        Said(f.effect, (), f.probability, f.named_ns / NS_PER_S - zero_s, f.since_ns / NS_PER_S - zero_s,
             f.effect not in right)
        for f in made.findings if f.effect in catalogue() and catalogue()[f.effect].symptom is not None
    ]  # fmt: skip
    told = next((f for f in made.findings if one.effect is not None and f.effect == one.effect.id), None)
    seconds = float(recording.encoders.time_s[-1])
    return LiveRow(
        case=case,
        begin_s=one.begin_s,
        limit_s=one.limit_s,
        seen_d=one.seen_d,
        hours=seconds / 3600.0,
        parameters=dict(one.values or {}),
        said=sorted(said, key=lambda s: s.named_s),
        suspected_s=[s + later_s for s in watch.suspected_s],
        sigmas=[] if told is None or one.effect is None else _sigmas(one.effect, one.values or {}, told.parameters),
        cost_ms_per_s=1e3 * took_s / seconds,
    )


def _names(effect: Effect | None) -> frozenset[str]:
    if effect is None:
        return frozenset()
    return ALIKE if effect.id in ALIKE else frozenset({effect.id})


def _sigmas(effect: Effect, values: Values, told: dict[str, Size | str]) -> list[float]:
    found: list[float] = []
    if any(q.fixed for q in effect.parameters):  # it counts from another origin
        return found
    for q in effect.parameters:
        size = told.get(q.name)
        # An angle counts from the monitor's start.
        if isinstance(size, Size) and size.std > 0.0 and q.name in values and not (q.moment or q.is_angle):
            found.append((size.value - float(values[q.name]) / q.si) / size.std)
    return found
