"""Robots' constants over time: `CONSTANTS`, `Log` (a constant of all robots as arrays), `logs` from a table."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from drd.arrays import Array
from drd.units import DEG_PER_RAD

Integers = npt.NDArray[np.int64]
S_PER_DAY: Final = 86_400.0
NOWHERE: Final = ""  # place or batch of a recording without one
# Longest series of a robot: the search for changes is quadratic in it. Beyond this, recordings are averaged.
MOST: Final = 512


class Constant(NamedTuple):
    """A constant of a robot. `factor`: from SI to the `unit` of texts.

    `jump`, `spread`, `slope`: prior sigmas of a change, between robots, and of creep per day (0: none), SI. `words`:
    those of the maintenance log that refer to it; `side`: the side that must be named there, if any is.
    """

    label: str
    unit: str
    factor: float
    jump: float
    spread: float
    slope: float = 0.0
    words: tuple[str, ...] = ()
    side: str = ""


TYRE: Final = ("tyre", "tire", "wheel", "tube", "inflat", "pump")
GYRO: Final = ("gyro", "fog", "imu")
# Jumps: a tyre that is worn, swapped or loses air changes by a per cent, a gyro that is replaced by tenths of one. A
# leak takes weeks for a per cent.
CONSTANTS: Final = {
    "radius_left": Constant("left tyre", "%", 100.0, 0.01, 0.005, 0.0005, TYRE, "left"),
    "radius_right": Constant("right tyre", "%", 100.0, 0.01, 0.005, 0.0005, TYRE, "right"),
    "tread": Constant("effective tread", "%", 100.0, 0.03, 0.03, 0.0, (*TYRE, "axle", "track")),
    "lag_s": Constant("lag", "ms", 1e3, 0.02, 0.02, 0.0, (*GYRO, "encoder", "cable", "bus", "computer", "firmware")),
    "gyro_scale": Constant("gyro scale", "%", 100.0, 0.005, 0.003, 0.0, GYRO),
    "bias_per_c": Constant("bias by temperature", "deg/h/degC", DEG_PER_RAD * 3600.0, 1e-5, 1e-5, 0.0, GYRO),
}


class Maintained(NamedTuple):
    """Work done on a robot, on a day since 1970."""

    day: float
    robot: str
    what: str

    @property
    def until(self) -> float:
        """Latest possible time: a date without a time means any time of that UTC day."""
        return self.day + float(float(self.day).is_integer())

    def means(self, name: str) -> bool | None:
        """Whether the work concerns the part that the constant describes; None if it does not say."""
        text = self.what.lower()
        if not any(word in text for c in CONSTANTS.values() for word in c.words):
            return None
        constant = CONSTANTS[name]
        sides = [side for side in ("left", "right") if side in text]
        return any(w in text for w in constant.words) and (not constant.side or not sides or constant.side in sides)


@dataclass(frozen=True)
class Log:
    """A constant in n recordings, sorted by robot, then by time.

    `robot`, `place`: indices into the names, shape (n,); `batch_of`: that of each robot. `day`: since 1970; `value`,
    `sigma`: SI.
    """

    name: str
    robots: list[str]
    places: list[str]
    batches: list[str]
    robot: Integers
    place: Integers
    batch_of: Integers
    day: Array
    value: Array
    sigma: Array
    recordings: list[str]

    @property
    def constant(self) -> Constant:
        """Constant of this log."""
        return CONSTANTS[self.name]

    @cached_property
    def _borders(self) -> list[int]:
        return [int(k) for k in np.searchsorted(self.robot, np.arange(len(self.robots) + 1))]

    def rows(self, robot: int) -> slice:
        """Rows of a robot."""
        return slice(*self._borders[robot : robot + 2])

    def until(self, day: float) -> "Log":
        """Log as it was at the end of that day."""
        keep = self.day <= day
        return Log(self.name, self.robots, self.places, self.batches, self.robot[keep], self.place[keep], self.batch_of,
                   self.day[keep], self.value[keep], self.sigma[keep],
                   [r for r, k in zip(self.recordings, keep, strict=True) if k])  # fmt: skip


def logs(table: Mapping[str, Sequence[Any]]) -> dict[str, Log]:
    """Logs from a table with the columns recording, robot, place, batch, start_utc, name, value, sigma.

    Omitted are rows without a time, or without a finite value and a sigma above 0, and names not in CONSTANTS.
    """
    names = np.asarray(table["name"], object)
    found = {}
    for name in CONSTANTS:
        at = [int(i) for i in np.flatnonzero(names == name)]
        at = [i for i in at if table["start_utc"][i] is not None and _is_number(table["value"][i], table["sigma"][i])]
        if at:
            found[name] = _averaged(_log(name, table, at))
    return found


def _is_number(value: float | None, sigma: float | None) -> bool:
    return value is not None and sigma is not None and math.isfinite(value) and math.isfinite(sigma) and sigma > 0.0


def _log(name: str, table: Mapping[str, Sequence[Any]], at: Sequence[int]) -> Log:
    def coded(column: str) -> tuple[list[str], Integers]:
        texts = [str(table[column][i] or NOWHERE) for i in at]
        known = sorted(set(texts), key=natural)
        number = {text: k for k, text in enumerate(known)}
        return known, np.array([number[text] for text in texts], np.int64)

    robots, robot = coded("robot")
    places, place = coded("place")
    batches, batch = coded("batch")
    day = np.array([day_of(table["start_utc"][i]) for i in at])
    order = np.lexsort((day, robot))
    robot = robot[order]
    last = np.append(np.flatnonzero(np.diff(robot)), len(robot) - 1)  # the robot's present gyro
    value = np.array([float(table["value"][i]) for i in at])[order]
    sigma = np.array([float(table["sigma"][i]) for i in at])[order]
    recordings = [str(table["recording"][at[k]]) for k in order]
    return Log(name, robots, places, batches, robot, place[order], batch[order][last], day[order], value, sigma,
               recordings)  # fmt: skip


def _averaged(log: Log) -> Log:
    """Average neighbours in one place if a robot has more than MOST recordings; each mean has the last one's name."""
    counts = np.bincount(log.robot, minlength=len(log.robots))
    if counts.max() <= MOST:
        return log
    of_robot = np.arange(len(log.robot)) - np.concatenate([[0], np.cumsum(counts)])[log.robot]
    seen = np.unique(np.column_stack([log.robot, log.place]), axis=0)
    places = np.bincount(seen[:, 0], minlength=len(log.robots))
    each = np.where(counts > MOST, -(-counts // np.maximum(MOST // np.maximum(places, 1), 1)), 1)[log.robot]
    key = np.column_stack([log.robot, of_robot // each, log.place])
    _, first, group = np.unique(key, axis=0, return_index=True, return_inverse=True)
    group = group.ravel()
    weight = 1.0 / log.sigma**2
    total = np.bincount(group, weight)

    def mean(values: Array) -> Array:
        return np.bincount(group, weight * values) / total

    last = np.full(len(first), -1)
    np.maximum.at(last, group, np.arange(len(group)))
    order = np.lexsort((mean(log.day), log.robot[first]))
    return Log(log.name, log.robots, log.places, log.batches, log.robot[first][order], log.place[first][order],
               log.batch_of, mean(log.day)[order], mean(log.value)[order], np.sqrt(1.0 / total)[order],
               [log.recordings[i] for i in last[order]])  # fmt: skip


def natural(text: str) -> tuple[Any, ...]:
    """Sort key that puts robot 10 after robot 9."""
    digits = "".join(c if c.isdigit() else " " for c in text).split()
    return "".join(c for c in text if not c.isdigit()), tuple(map(int, digits)), text


def day_of(when: Any) -> float:
    """Days since 1970 of a time with a zone (without one: UTC), or of seconds since 1970."""
    if isinstance(when, datetime):
        return (when if when.tzinfo else when.replace(tzinfo=UTC)).timestamp() / S_PER_DAY
    if isinstance(when, np.datetime64):
        return float(when.astype("datetime64[us]").astype(np.int64)) / 1e6 / S_PER_DAY
    return float(when) / S_PER_DAY


def maintained(rows: Sequence[Mapping[str, Any]]) -> list[Maintained]:
    """Maintenance log from rows with date, robot and what, sorted by date."""
    return sorted(Maintained(day_of(row["date"]), str(row["robot"]), str(row["what"])) for row in rows)
