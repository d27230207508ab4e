"""A simulated fleet: the history of its robots, floors and gyros, and the true constants of each recording.

`draw` makes a `Fleet` from a seed: the robots, the maintenance log, all changes (`Happening`), and the true constants
of each recording. `summaries` adds the errors of a diagnosis, without simulating any drive.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Any, Final

import numpy as np

from drd.arrays import Array
from drd_tools.fleet.series import CONSTANTS

BEGIN: Final = datetime(2026, 3, 1, tzinfo=UTC)
PLACES: Final = ("hall", "yard", "lab", "dock")
BATCHES: Final = ("A", "B", "C")
RADII: Final = ("radius_left", "radius_right")
SMALLEST: Final = 0.005  # smallest change of a radius, for which the goals are stated
ABSENT: Final = 0.1  # share of the days on which a robot does not drive
# Sigma between robots of one kind, and sigma of the random walk per day: wear, load.
SPREAD: Final = {
    "radius_left": 0.003, "radius_right": 0.003, "tread": 0.01, "lag_s": 0.003, "gyro_scale": 0.001, "bias_per_c": 2e-6,
}  # fmt: skip
WALK: Final = {"radius_left": 2e-5, "radius_right": 2e-5, "tread": 1e-4, "gyro_scale": 5e-6}
SEASON: Final = 0.001  # of the radii, from the coldest to the warmest day
# Sigma after a drive of two minutes, its scatter (of the logarithm), and the true error over it. Measured on ten
# simulated drives of each of warehouse, field and eights with the wheels' calibrator: radii 3.4e-4 to 3.8e-4, tread
# 1.8e-3 to 3.3e-3, lag 1.3 to 9 ms, errors 0.5 to 0.85 sigma. Scale and bias: a heading of 0.15 deg after 1,500 deg of
# turns, and a rate of 0.45 deg/h over 2 degC. Diagnosing 27 such drives left 2.1e-4, 2.1e-4, 2.5e-3, 1.5e-3, 4.8e-5
# and 1.1e-5, with errors of 0.8 to 1.35 sigma: the values here are up to four times worse, except the last one.
SIGMA: Final = {
    "radius_left": 3.7e-4, "radius_right": 3.7e-4, "tread": 2.7e-3, "lag_s": 5e-3,
    "gyro_scale": 2e-4, "bias_per_c": 1e-6,
}  # fmt: skip
SIGMA_SCATTER: Final = 0.2
TAILS: Final = 5.0  # degrees of freedom of the errors, of unit sigma: slightly worse than measured
OUTLIERS, OUTLIER_SIGMAS = 0.01, (5.0, 15.0)  # share of faulty recordings, and their errors


@dataclass(frozen=True)
class Happening:
    """A change of a robot, place or batch. `size`: SI; a creep reaches it at `until`. `day`: day of the history."""

    kind: str
    who: str
    name: str
    form: str
    day: float
    size: float
    until: float | None = None

    def at(self, day: float) -> float:
        """Size that it adds on a day."""
        if day < self.day:
            return 0.0
        if self.form == "creep" and self.until is not None:
            return self.size * min(1.0, (day - self.day) / (self.until - self.day)) * (day < self.until)
        return self.size * (self.until is None or day < self.until)


@dataclass(frozen=True)
class Drive:
    """A recording to make, and its true constants."""

    recording: str
    robot: str
    place: str
    batch: str
    day: float
    constants: dict[str, float]

    @property
    def start_utc(self) -> datetime:
        """Start, to the second."""
        return BEGIN + timedelta(seconds=round(self.day * 86_400.0))


@dataclass(frozen=True)
class Fleet:
    """Robots with batch and places, maintenance, changes, and all drives by time."""

    batch: dict[str, str]
    places: dict[str, list[str]]
    maintenance: list[dict[str, Any]]
    happenings: list[Happening]
    drives: list[Drive] = field(default_factory=list)


def draw(robots: int, days: int, seed: int) -> Fleet:
    """Draw a fleet from a seed; about half of the robots change."""
    random = np.random.default_rng([seed, robots, days])
    names = [f"robot{i + 1}" for i in range(robots)]
    batch = {name: BATCHES[i % len(BATCHES)] for i, name in enumerate(names)}
    places = {name: [str(p) for p in random.choice(PLACES, 2, replace=False)] for name in names}
    fleet = Fleet(batch, places, [], list(_of_groups(random, days)))
    for name in names:
        _happen(fleet, name, days, random)
    fleet.maintenance.sort(key=lambda row: (row["date"], row["robot"]))
    fleet.drives.extend(_drives(fleet, names, days, random))
    return fleet


def _of_groups(random: np.random.Generator, days: int) -> Iterator[Happening]:
    """Draw a floor that always differs, one that changes, a gyro batch that always deviates and one that changes."""
    rough, laid = random.choice(PLACES, 2, replace=False)
    yield Happening("place", str(rough), "tread", "step", -1.0, float(random.uniform(0.02, 0.04)))
    yield Happening("place", str(laid), "tread", "step", float(random.uniform(0.3, 0.7) * days), 0.03)
    apart, aged = random.choice(BATCHES, 2, replace=False)
    yield Happening("batch", str(apart), "gyro_scale", "step", -1.0, float(random.uniform(0.003, 0.005)))
    yield Happening("batch", str(aged), "gyro_scale", "step", float(random.uniform(0.3, 0.7) * days), -0.003)


def _happen(fleet: Fleet, robot: str, days: int, random: np.random.Generator) -> None:
    """Draw a robot's history: nothing, a change, a leak and its repair, a swap, a new gyro, tread, or idle work."""
    kind = random.choice(["nothing", "change", "leak", "swap", "gyro", "tread", "idle"],
                         p=[0.35, 0.25, 0.12, 0.1, 0.06, 0.06, 0.06])  # fmt: skip
    day, sign = float(random.uniform(0.15, 0.85) * days), float(random.choice([-1.0, 1.0]))
    side = str(random.choice(["left", "right"]))
    size = sign * (SMALLEST if random.random() < 0.6 else float(random.uniform(SMALLEST, 3.0 * SMALLEST)))

    def did(what: str, on: float) -> None:
        date = BEGIN + timedelta(days=float(np.floor(on)))
        fleet.maintenance.append({"date": date.date().isoformat(), "robot": robot, "what": what})

    def happens(name: str, form: str, size: float, since: float = day, until: float | None = None) -> None:
        fleet.happenings.append(Happening("robot", robot, name, form, since, size, until))

    if kind == "change":
        back = float(day + random.uniform(0.15, 0.4) * days)
        is_repaired = back < 0.95 * days and random.random() < 0.5
        happens(f"radius_{side}", "step", size, until=float(np.floor(back)) if is_repaired else None)
        if is_repaired:
            did(f"{side} tyre changed", back)
    elif kind == "leak":
        begin = float(random.uniform(0.1, 0.5) * days)
        end = float(np.floor(min(begin + random.uniform(0.2, 0.4) * days, 0.9 * days)))
        happens(f"radius_{side}", "creep", -float(random.uniform(0.01, 0.02)), begin, end)
        did(f"{side} tyre pumped up", end)
    elif kind == "swap":
        day = float(np.floor(day))
        happens(f"radius_{side}", "step", size, day)
        did(f"{side} tyre changed", day)
    elif kind == "gyro":
        day = float(np.floor(day))
        happens("gyro_scale", "step", 0.4 * size, day)
        did("gyro exchanged", day)
    elif kind == "tread":
        happens("tread", "step", 4.0 * size)
    elif kind == "idle":
        did(str(random.choice(["inspection", "tyres looked at", "gyro cleaned"])), day)


def _drives(fleet: Fleet, names: list[str], days: int, random: np.random.Generator) -> Iterator[Drive]:
    base = {r: {c: float(SPREAD[c] * random.standard_normal()) for c in CONSTANTS} for r in names}
    phase = float(random.uniform(0.0, 2.0 * np.pi))
    walked: dict[str, Array] = {}
    for robot in names:
        for c in WALK:
            walked[robot + c] = WALK[c] * np.cumsum(random.standard_normal(days))
    for k in range(days):
        for robot in names:
            hour, absent, where = random.uniform(7.0, 18.0), random.random() < ABSENT, int(random.random() < 0.4)
            if absent:
                continue
            day, place = k + float(hour) / 24.0, fleet.places[robot][where]
            constants = dict(base[robot])
            for c in WALK:
                constants[c] += float(walked[robot + c][k])
            for c in RADII:
                constants[c] += 0.5 * SEASON * float(np.sin(2.0 * np.pi * day / 365.0 + phase))
            for h in fleet.happenings:
                if h.who == {"robot": robot, "place": place, "batch": fleet.batch[robot]}[h.kind]:
                    constants[h.name] += h.at(day)
            yield Drive(f"{robot}_{k:03d}", robot, place, fleet.batch[robot], day, constants)


def summaries(fleet: Fleet, seed: int) -> list[dict[str, Any]]:
    """Rows of the table of constants, with the errors of a diagnosis; no drive is simulated."""
    random = np.random.default_rng([seed, 1])
    rows = []
    for drive in fleet.drives:
        went_wrong = random.random() < OUTLIERS
        for name, true in drive.constants.items():
            sigma = SIGMA[name] * float(np.exp(SIGMA_SCATTER * random.standard_normal()))
            off = float(random.standard_t(TAILS)) * np.sqrt((TAILS - 2.0) / TAILS)
            if went_wrong:
                off += float(random.choice([-1.0, 1.0]) * random.uniform(*OUTLIER_SIGMAS))
            rows.append({
                "recording": drive.recording, "robot": drive.robot, "place": drive.place, "batch": drive.batch,
                "start_utc": drive.start_utc, "duration_s": 120.0, "name": name, "value": true + sigma * off,
                "sigma": sigma, "unit": "1",
            })  # fmt: skip
    return rows


def table(rows: list[dict[str, Any]]) -> dict[str, list[Any]]:
    """Turn rows into columns."""
    return {key: [row[key] for row in rows] for key in (rows[0] if rows else ())}


def maintenance_rows(fleet: Fleet) -> list[dict[str, Any]]:
    """Maintenance log with dates as times."""
    return [{**row, "date": datetime.fromisoformat(row["date"]).replace(tzinfo=UTC)} for row in fleet.maintenance]
