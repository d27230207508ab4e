"""Missions: laps of legs, each lap from the origin back to it."""

import itertools
import math
from collections.abc import Callable, Iterator
from typing import Final, NamedTuple

import numpy as np

from drd.arrays import Array

CELL_M: Final = 0.02
QUARTER: Final = 0.5 * math.pi


class Follow(NamedTuple):
    """A path along points CELL_M apart, shape (n, 2), from standstill to standstill."""

    path_m: Array
    speed_m_s: float


class Spin(NamedTuple):
    """A turn on the spot, left positive."""

    angle_rad: float
    rate_rad_s: float


class Stand(NamedTuple):
    """No motion."""

    seconds: float


Leg = Follow | Spin | Stand


class Mission(NamedTuple):
    """A mission; `lap()` makes the legs of one lap."""

    text: str
    lap: Callable[[], list[Leg]]


def legs_of(mission: str, stand_s: float, *, endless: bool) -> Iterator[Leg]:
    """Make a standstill, then one lap and 1 s of standstill, or endless laps. `mission` is a name of MISSIONS."""
    lap = MISSIONS[mission].lap()
    return itertools.chain([Stand(stand_s)], itertools.cycle(lap) if endless else [*lap, Stand(1.0)])


def way_of(mission: str) -> Array:
    """All points of a lap's paths, shape (n, 2), n >= 2."""
    paths = [leg.path_m for leg in MISSIONS[mission].lap() if isinstance(leg, Follow)]
    return np.concatenate(paths) if paths else np.zeros((2, 2))


def _way(*pieces: tuple[float, Callable[[Array], Array] | float]) -> Array:
    """Points of pieces (length in m, curvature in 1/m: constant, or a function of the fraction of the length)."""
    cells = []
    for length_m, curvature in pieces:
        n = max(1, round(length_m / CELL_M))
        u = (np.arange(n) + 0.5) / n
        bend = curvature(u) if callable(curvature) else np.full(n, curvature)
        cells.append(np.column_stack((np.full(n, length_m / n), bend)))
    step, bend = np.concatenate(cells).T
    heading = np.cumsum(step * bend) - 0.5 * step * bend
    steps = np.column_stack((step * np.cos(heading), step * np.sin(heading)))
    return np.concatenate((np.zeros((1, 2)), np.cumsum(steps, axis=0)))


def _straight() -> list[Leg]:
    far = _way((20.0, 0.0))
    return [Follow(far, 1.0), Spin(math.pi, 0.6), Follow(far[::-1], 1.0), Spin(-math.pi, 0.6)]


def _square(side: float) -> Callable[[], list[Leg]]:
    corner = (10.0, 0.0), (QUARTER * 1.5, side / 1.5)
    return lambda: [Follow(_way(*corner * 4), 1.0), Stand(1.0)]


def _umbmark(side: float) -> Callable[[], list[Leg]]:
    def lap() -> list[Leg]:
        legs: list[Leg] = []
        for number in range(4):
            turn = np.array([[math.cos(a := side * number * QUARTER), math.sin(a)], [-math.sin(a), math.cos(a)]])
            begin = (np.array([[0, 0], [4, 0], [4, 4 * side], [0, 4 * side]]))[number]
            legs += [Follow(begin + _way((4.0, 0.0)) @ turn, 0.8), Spin(side * QUARTER, 0.6)]
        return legs

    return lap


def _eights() -> list[Leg]:
    radius_m = 2.0
    circle_m = 2.0 * math.pi * radius_m
    return [Follow(_way((circle_m, 1.0 / radius_m), (circle_m, -1.0 / radius_m)), 1.0), Stand(1.0)]


def _circles() -> list[Leg]:
    legs: list[Leg] = []
    for radius_m in (0.5, 0.75, 1.0, 1.5, 2.5, 4.0, 8.0):
        circle_m = 2.0 * math.pi * radius_m
        legs += [Follow(_way((circle_m, side / radius_m)), 1.0) for side in (1.0, -1.0)]
    return [*legs, Spin(2.0 * math.pi, 0.6), Spin(-2.0 * math.pi, 0.6)]


def _slalom() -> list[Leg]:
    period_m, swings, bend_per_m = 8.0, 3, 0.7

    def weave(u: Array) -> Array:
        return np.asarray(bend_per_m * np.cos(2.0 * math.pi * swings * u))

    # A straight at each end makes the way there and back the same line.
    there = _way((1.0, 0.0), (swings * period_m, weave), (1.0, 0.0))
    return [Follow(there, 1.2), Spin(math.pi, 0.8), Follow(there[::-1], 1.2), Spin(-math.pi, 0.8)]


def _spins() -> list[Leg]:
    legs: list[Leg] = []
    for rate_rad_s in (0.1, 0.2, 0.4, 0.6, 0.9):
        for side in (1.0, -1.0):
            legs += [Spin(side * 2.0 * math.pi * min(1.0, 2.0 * rate_rad_s), rate_rad_s), Stand(2.0)]
    return legs


MISSIONS: Final = {
    "square-cw": Mission("10 m straights and corners of 1.5 m radius, clockwise, 1 m/s", _square(-1.0)),
    "square-ccw": Mission("the same counter-clockwise", _square(1.0)),
    "umbmark-cw": Mission("a square of 4 m with turns on the spot, clockwise", _umbmark(-1.0)),
    "umbmark-ccw": Mission("the same counter-clockwise", _umbmark(1.0)),
    "eights": Mission("figures of eight, circles of 2 m radius, 1 m/s", _eights),
    "circles": Mission("circles of 0.5 to 8 m radius and turns on the spot, left and right", _circles),
    "slalom": Mission("weaving at up to 1.2 m/s, there and back", _slalom),
    "spins": Mission("turns on the spot, both ways, 0.1 to 0.9 rad/s, with standstills", _spins),
    "straight": Mission("20 m straight, turn on the spot, and back", _straight),
}
