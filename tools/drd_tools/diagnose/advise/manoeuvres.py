"""Manoeuvres that distinguish effects, as advised and simulated, and drives composed of them."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from typing import Final, NamedTuple

import numpy as np

from drd.arrays import Array
from drd.units import RAD_PER_DEG
from drd_tools.simulate.missions import MISSIONS, Drive
from drd_tools.simulate.route import Route
from drd_tools.simulate.truth import Truth, make_truth

# The gyro warms up from power-on; in some drives it is cooled for two minutes.
WARM_UP_C, WARM_UP_S = 10.0, 900.0
COLDER_C, COLD_LAG_S, COLD_FROM_S, COLD_TO_S = 12.0, 60.0, 60.0, 180.0
ROOM_C: Final = 20.0  # degC, at the start of an indoor drive
STOP_S: Final = 1.0  # between two parts


class Manoeuvre(NamedTuple):
    """A lap, by its number from 0: every other one is mirrored. `cold`: the gyro is cooled and warms up again."""

    lap: Callable[[Route, int], object]
    cold: bool = False


class Part(NamedTuple):
    """A manoeuvre of MANOEUVRES, driven for some laps."""

    manoeuvre: str
    laps: int


def _side(number: int) -> float:
    return -1.0 if number % 2 else 1.0


def _spins(route: Route, number: int) -> None:
    for rate_deg_s, side in ((50.0, 1.0), (25.0, -1.0), (10.0, 1.0)):
        route.turn(_side(number) * side * 2.0 * math.pi, rate_deg_s * RAD_PER_DEG).stand(1.0)


def _circles(route: Route, number: int) -> None:
    for radius_m, side in ((0.3, _side(number)), (3.0, -_side(number))):
        route.curve(2.0 * math.pi * radius_m, np.full(200, side / radius_m), 1.0).turn(side * 2.0 * math.pi)


def _squares(route: Route, number: int) -> None:
    MISSIONS["umbmark-ccw" if number % 2 else "umbmark-cw"].lap(route, number)


def _straights(route: Route, number: int) -> None:
    for speed_m_s in (1.5, 0.4, 0.8):
        route.straight(10.0, speed_m_s).turn(_side(number) * math.pi)


def _stand(route: Route, _: int) -> None:
    route.stand(60.0)


COLD: Final = "with the gyro cooled by about 12 degC from the end of minute 1 to the end of minute 3"
MANOEUVRES: Final = {
    "turns on the spot, both ways, at 50, 25 and 10 deg/s": Manoeuvre(_spins),
    "circles of 0.3 and 3 m radius and turns on the spot, both ways": Manoeuvre(_circles),
    "squares of 4 m with turns on the spot, both ways": Manoeuvre(_squares),
    "straight lines of 10 m, there and back, at 1.5, 0.4 and 0.8 m/s": Manoeuvre(_straights),
    "figures of eight of 50 m at 1.2 m/s": Manoeuvre(MISSIONS["eights"].lap),
    "a slalom at up to 1.5 m/s": Manoeuvre(MISSIONS["slalom"].lap),
    f"standing still {COLD}": Manoeuvre(_stand, cold=True),
    f"squares of 4 m with turns on the spot, both ways, {COLD}": Manoeuvre(_squares, cold=True),
}


def drive(parts: Sequence[Part], stand_s: float) -> Truth:
    """The true motion: a standstill of `stand_s`, then one part after the other, with a stop between them."""
    route, laps = Route().stand(stand_s), sum(part.laps for part in parts)
    for k, part in enumerate(parts):
        if k:
            route.stand(STOP_S)
        for number in range(part.laps):
            MANOEUVRES[part.manoeuvre].lap(route, number)
    truth = make_truth(Drive(route.steps(), laps))
    is_cold = any(MANOEUVRES[part.manoeuvre].cold for part in parts)
    return replace(truth, temperature_c=_temperature_c(truth.middle_s, is_cold))


@cache
def lap_s(name: str) -> float:
    """Mean duration of a lap over a pair of mirrored ones."""
    return drive([Part(name, 2)], 0.0).duration_s / 2.0


def _temperature_c(time_s: Array, cold: bool) -> Array:
    def after(begin_s: float) -> Array:
        return np.asarray(1.0 - np.exp(-np.maximum(time_s - begin_s, 0.0) / COLD_LAG_S))

    warm = ROOM_C + WARM_UP_C * (1.0 - np.exp(-time_s / WARM_UP_S))
    return warm - COLDER_C * (after(COLD_FROM_S) - after(COLD_TO_S)) if cold else warm
