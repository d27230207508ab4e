"""The gyro's temperature through a run."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from drd.arrays import Array
from drd.config.schema import ConfigError
from drd_tools.recordings.folder import read_table

WARM_UP_S: Final = 900.0  # FOGs: 3 to 15 min
DOOR_S: Final = 150.0
DOOR_LAG_S: Final = 120.0


def warming_c(time_s: Array, cold_c: float, by_c: float, constant_s: float = WARM_UP_S) -> Array:
    """Temperature of a gyro during warm-up, at times since it was switched on."""
    return np.asarray(cold_c + by_c * (1.0 - np.exp(-time_s / constant_s)))


class Profile(NamedTuple):
    """A profile: `curve(time_s, duration_s, a, b)` gives degC; `a_c` and `b_c` are the defaults of a and b."""

    text: str
    a_c: float
    b_c: float
    curve: Callable[[Array, float, float, float], Array]


def _doors(time_s: Array, _: float, a: float, b: float) -> Array:
    # After each door the temperature approaches the other one; responses to all doors so far add up.
    change = np.zeros_like(time_s)
    for number in range(1, math.ceil(float(time_s[-1]) / DOOR_S)):
        since_s = np.maximum(time_s - number * DOOR_S, 0.0)
        change += (1.0 if number % 2 else -1.0) * (1.0 - np.exp(-since_s / DOOR_LAG_S))
    return a + (b - a) * change


PROFILES: Final = {
    "constant": Profile("always A", 20.0, 20.0, lambda t, _, a, _b: np.full_like(t, a)),
    "warmup": Profile(
        "from A up by B, with a time constant of 15 min", 20.0, 10.0,
        lambda t, _, a, b: warming_c(t, a, b),
    ),
    "rise": Profile("from A to B in a straight line", 15.0, 30.0, lambda t, end, a, b: a + (b - a) * t / end),
    "cycle": Profile(
        "from A to B and back, three times in two runs", 15.0, 30.0,
        lambda t, end, a, b: 0.5 * (a + b) + 0.5 * (a - b) * np.cos(3.0 * math.pi * t / end),
    ),
    "doors": Profile("in and out of a cold store, every 150 s: A outside, B inside", 20.0, 5.0, _doors),
}  # fmt: skip


def temperature_c(profile: str, time_s: Array, duration_s: float) -> Array:
    """Temperature at times since the start, shape (n,), n >= 1.

    `profile`: a name of PROFILES, also as NAME:A or NAME:A:B; or a CSV file with time_s,temperature_c, held constant
    beyond its ends. Raises ConfigError.
    """
    if profile.endswith(".csv"):
        at_s, value_c = read_table(Path(profile), (("time_s", "temperature_c"),)).values.T
        return np.asarray(np.interp(time_s, at_s, value_c))
    name, *numbers = profile.split(":")
    try:
        chosen = PROFILES[name]
        values = [float(text) for text in numbers]
        a, b = (*values, *(chosen.a_c, chosen.b_c)[len(values) :])
        if not all(-100.0 <= value <= 200.0 for value in (a, b)):
            raise ValueError
    except (KeyError, ValueError):
        expected = f"{', '.join(PROFILES)} (each also with degC as NAME:A:B), or a .csv file"
        raise ConfigError("--temperature", "", expected, repr(profile)) from None
    return chosen.curve(time_s, duration_s, a, b)
