"""Streams of a source: time series of gyro, wheels and reference in its own units, and their provenance."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final, TypeVar

import numpy as np
import numpy.typing as npt

from drd.arrays import Array
from drd.batch.samples import LONGEST_GAP_S
from drd.config.schema import ConfigError
from drd.units import NS_PER_S
from drd_tools.recordings.folder import at_rows

Times = npt.NDArray[np.int64]

# Units of the wheels' two columns. `twist` is forward speed in m/s and yaw rate in rad/s of the whole robot.
CUMULATIVE: Final = ("counts", "rad", "m")
WHEEL_UNITS: Final = (*CUMULATIVE, "rad_s", "m_s", "rpm", "twist")
# `rad` and `deg` are angles since the row before.
GYRO_ANGLES: Final = ("rad", "deg")
GYRO_UNITS: Final = ("rad_s", "deg_s", *GYRO_ANGLES)


@dataclass(frozen=True)
class Gyro:
    """Angular rate about one or three axes, `value` of shape (n, k), in the source's unit and sign.

    `acceleration_m_s2`: shape (n, 3) in the same frame, None if the source has none.
    """

    time_ns: Times
    value: Array
    axes: tuple[str, ...]
    acceleration_m_s2: Array | None = None
    temperature_c: Array | None = None


@dataclass(frozen=True)
class Wheels:
    """Both sides, shape (n,) each, in `unit` (WHEEL_UNITS); for twist, `left` is the speed and `right` the yaw rate.

    `modulus_counts`: count at which the counters wrap, None if they do not. `count_m`: travel per count, if the source
    itself states it.
    """

    time_ns: Times
    left: Array
    right: Array
    unit: str
    modulus_counts: int | None = None
    count_m: float | None = None


@dataclass(frozen=True)
class Reference:
    """Poses, shape (n,) each; the heading is counter-clockwise from +x, in any turn."""

    time_ns: Times
    x_m: Array
    y_m: Array
    heading_rad: Array


Values = TypeVar("Values", Gyro, Wheels, Reference)


@dataclass
class Origin:
    """Provenance of a stream, for people and for import.yaml. `notes`: sentences on changes made to it."""

    source: str
    kind: str
    stamps: str
    rows: int = 0
    rate_hz: float | None = None
    notes: list[str] = field(default_factory=list)


class Source:
    """An opened file; rows are in its own order. Methods raise ConfigError if it lacks what is requested."""

    path: Path

    def listing(self) -> list[str]:
        """List the file's contents as lines of text, ending with a proposed command."""
        raise NotImplementedError

    def gyro(self, name: str) -> tuple[Gyro, Origin]:
        """The rate stream of this name."""
        raise self._none("gyro", name)

    def wheels(self, name: str) -> tuple[Wheels, Origin]:
        """The wheels' stream of this name."""
        raise self._none("wheels", name)

    def reference(self, name: str) -> tuple[Reference, Origin]:
        """The poses of this name."""
        raise self._none("reference", name)

    def _none(self, stream: str, name: str) -> ConfigError:
        expected = f"another file for the {stream} (--{stream}-file)"
        return ConfigError(str(self.path), f"--{stream}", expected, repr(name))


def in_order(values: Values, origin: Origin, *, are_angles: bool = False) -> tuple[Values, Origin]:
    """Sort rows by time, keeping the first of equal times; note the changes, count and rate in `origin`.

    `are_angles`: a gyro's values are angles since the row before, so those of equal times are added.
    """
    values = _with_times(values, origin)
    time_ns = values.time_ns
    order = np.argsort(time_ns, kind="stable")
    backwards = int((np.diff(time_ns) < 0).sum())
    first = np.concatenate([[True], np.diff(time_ns[order]) > 0]) if len(order) else np.zeros(0, bool)
    kept = order[first]
    if backwards:
        origin.notes.append(f"{backwards} steps of time were negative; the rows were sorted")
    if len(kept) < len(order):
        done = "added to it" if are_angles else "dropped"
        origin.notes.append(f"{len(order) - len(kept)} rows had the time of another one and were {done}")
    changes = at_rows(values, kept)
    if are_angles:
        changes["value"] = np.add.reduceat(vars(values)["value"][order], np.flatnonzero(first))
    origin.rows = len(kept)
    if len(kept) > 1:
        origin.rate_hz = 1e9 / float(np.median(np.diff(time_ns[kept])))
    return replace(values, **changes), origin


def _with_times(values: Values, origin: Origin) -> Values:
    """Drop rows without a time: drivers send 0 before their clock is set."""
    unset = values.time_ns == 0
    if not unset.any() or values.time_ns.max() < LONGEST_GAP_S * NS_PER_S:
        return values
    origin.notes.append(f"{int(unset.sum())} rows had the time 0, none, and were left out")
    return replace(values, **at_rows(values, ~unset))
