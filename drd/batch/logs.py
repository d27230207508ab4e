"""Logs of a gyro and of wheel encoders: arrays, made from named columns."""

import math
from dataclasses import dataclass
from typing import Any, Final, Protocol

import numpy as np
import numpy.typing as npt

from drd.arrays import Array
from drd.config.robot import Robot
from drd.config.schema import ConfigError
from drd.units import RAD_PER_DEG

COUNTS: Final = ("time_s", "left_counts", "right_counts")
SPEEDS: Final = ("time_s", "left_rad_s", "right_rad_s")
RATE: Final = ("time_s", "rate_deg_s")
RATE_AND_TEMPERATURE: Final = (*RATE, "temperature_c")


class Columns(Protocol):
    """Mapping of the recording format's column names to arrays: a dictionary, a data frame."""

    def __contains__(self, key: object, /) -> bool: ...
    def __getitem__(self, key: str, /) -> Any: ...


@dataclass(frozen=True)
class FogLog:
    """Rates, shape (n,) each: the mean over the interval that ends at the time. Counter-clockwise positive."""

    time_s: Array
    rate_rad_s: Array
    temperature_c: Array | None


@dataclass(frozen=True)
class EncoderLog:
    """Wheel motion, shape (n,) each, n >= 2: cumulative counts, or else speeds over the interval that ends there.

    `is_lost` (n,): nothing is known of the travel since the row before; None: all of it is known.
    """

    time_s: Array
    left_counts: Array | None
    right_counts: Array | None
    left_rad_s: Array | None
    right_rad_s: Array | None
    is_lost: npt.NDArray[np.bool_] | None = None


def gyro_log(gyro: Columns | None) -> FogLog | None:
    """The columns `RATE`, and the temperature where there is one, as a log. Raises ConfigError."""
    if gyro is None:
        return None
    names = RATE_AND_TEMPERATURE if RATE_AND_TEMPERATURE[-1] in gyro else RATE
    time_s, rate_deg_s, *rest = columns("gyro", gyro, names)
    return FogLog(time_s, RAD_PER_DEG * rate_deg_s, rest[0] if rest else None)


def wheel_log(wheels: Columns, nominal: Robot) -> EncoderLog:
    """The columns `COUNTS`, or else `SPEEDS`, as a log of a robot whose sizes are known. Raises ConfigError."""
    for name, size_m in (("wheel_radius_m", nominal.wheel_radius_m), ("tread_m", nominal.tread_m)):
        if math.isnan(size_m):
            raise ConfigError("robot", name, "a number, since there are wheels", "NaN")
    if COUNTS[1] not in wheels and SPEEDS[1] in wheels:
        time_s, left, right = columns("wheels", wheels, SPEEDS, rows=2)
        return EncoderLog(time_s, None, None, left, right)
    time_s, left, right = columns("wheels", wheels, COUNTS, rows=2)
    for name, counts in zip(COUNTS[1:], (left, right), strict=True):
        _refuse("wheels", name, counts, counts != np.round(counts), "a whole number of counts")
    if nominal.counts_per_revolution is None:
        raise ConfigError("robot", "counts_per_revolution", "a number, since wheels has counts", "None")
    return EncoderLog(time_s, left, right, None, None)


def columns(what: str, given: Columns, names: tuple[str, ...], rows: int = 1) -> list[Array]:
    """The columns `names` of `given`, shape (n,) each, n >= `rows`, the first a rising time.

    Raises ConfigError with `what` and the column that is missing, has another length, or is not of finite numbers.
    """
    arrays: list[Array] = []
    for name in names:
        if name not in given:
            raise ConfigError(what, name, "a column of numbers", "none")
        try:
            array = _numbers(given[name])
        except (TypeError, ValueError) as error:
            raise ConfigError(what, name, "a column of numbers", str(error)) from error
        n = len(arrays[0]) if arrays else max(rows, array.size)
        if array.shape != (n,):
            expected = f"{n} numbers, as many as {names[0]} has" if arrays else f"an array of {rows} numbers or more"
            raise ConfigError(what, name, expected, f"an array of shape {array.shape}")
        _refuse(what, name, array, ~np.isfinite(array), "finite numbers")
        arrays.append(array)
    time_s = arrays[0]
    _refuse(what, names[0], time_s, np.diff(time_s, prepend=-np.inf) <= 0.0, "rising times")
    return arrays


def _numbers(column: Any) -> Array:
    """A column as numbers, NaN where a mask hides them. Raises TypeError or ValueError."""
    dtype = np.asarray(column).dtype
    if dtype.kind in "mMc":  # numpy would drop the unit of times, and an imaginary part
        raise TypeError(str(dtype))
    return np.asarray(np.ma.filled(np.ma.asarray(column, np.float64), np.nan))


def _refuse(what: str, name: str, array: Array, wrong: npt.NDArray[np.bool_], expected: str) -> None:
    """Raise a ConfigError with the first value that is wrong, if any is."""
    if wrong.any():
        k = int(wrong.argmax())
        raise ConfigError(what, name, expected, f"{array[k]:.12g} at index {k}")
