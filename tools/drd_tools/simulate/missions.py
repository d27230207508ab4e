"""Missions by name: closed laps, from standstill to standstill."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from drd.config.schema import ConfigError
from drd_tools.recordings.folder import read_table
from drd_tools.simulate.route import ACCELERATION_M_S2, LATERAL_M_S2, RATE_HZ, SMOOTHING_S, Route, Steps, bend_shape

QUARTER: Final = 0.5 * math.pi
# Columns of a way-point file, and their limits.
POINT, SPEED = ("x_m", "y_m"), "speed_m_s"
PLACES_M, SPEEDS_M_S, APART_M = (-1e5, 1e5), (0.05, 10.0), 0.01
# First zero of the Bessel function J0: a path whose heading swings this far (sine over its length) is a closed
# figure of eight, because the mean of exp(i a sin u) over a period is J0(a).
EIGHT_SWING_RAD: Final = 2.404825557695773


class Mission(NamedTuple):
    """A mission, whose lap ends at its start pose, up to whole turns of the heading.

    `lap(route, number)` adds lap `number`, from 0, to the route; laps with a net turn are mirrored every other time.
    """

    text: str
    lap: Callable[[Route, int], object]


class Drive(NamedTuple):
    """A mission as driven. `laps`: number of whole laps; 0: it was cut before the first one ended."""

    steps: Steps
    laps: int
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)  # x_m, y_m, heading_rad


def make_drive(mission: str, seconds: float | None = None, stand_s: float = 10.0, laps: int = 1) -> Drive:
    """Make a standstill of `stand_s`, as many whole laps as fit into `seconds`, and a standstill for the rest.

    If not even one fits, it is cut at `seconds`. Without `seconds`: `laps`. `mission` is a name of MISSIONS, or a
    way-point file (see `read_waypoints`). Raises ConfigError.
    """
    if mission in MISSIONS:
        lap, start = MISSIONS[mission].lap, (0.0, 0.0, 0.0)
    elif mission.endswith(".csv"):
        lap, start = waypoint_lap(Path(mission))
    else:
        raise ConfigError("--mission", "", f"one of {', '.join(MISSIONS)}, or a .csv file", repr(mission))

    def laps_of(count: int) -> Steps:
        route = Route(*start).stand(stand_s)
        for number in range(count):
            lap(route, number)
        return route.stand(1.0).steps()

    if seconds is None:
        return Drive(laps_of(laps), laps, start)
    total, steps = round(seconds * RATE_HZ), laps_of(1)
    first = len(steps.forward_m)
    laps = int(first <= total)
    if first < total:
        laps += (total - first) // (len(laps_of(2).forward_m) - first)
    return Drive(_lasting(laps_of(laps) if laps > 1 else steps, total), laps, start)


def _lasting(steps: Steps, total: int) -> Steps:
    """Cut the steps to `total`, or extend them by a standstill."""
    return Steps(*(np.pad(a, (0, max(0, total - len(a))))[:total] for a in steps))


def demo_drive(seconds: float, stand_s: float = 10.0) -> Drive:
    """Make figures of eight that take `seconds`, with a standstill of `stand_s` first and a short one at the end.

    The path is as long as possible. If time is too short for a whole eight at a moderate yaw rate, it is an open, wavy
    path; if it is too short for that too, the robot stands.
    """
    lap_m, rate_limit_rad_s, shortest_m = 100.0, 0.8, 0.05
    end_stand_s = min(2.0, 0.1 * seconds)
    moving_s = max(0.0, seconds - stand_s - end_stand_s - SMOOTHING_S)
    speed = min(1.5, ACCELERATION_M_S2 * moving_s / 4.0)  # ramps take at most half of the time
    length_m = speed * (moving_s - speed / ACCELERATION_M_S2)
    route = Route().stand(stand_s)
    if length_m > shortest_m:
        _wave(route, length_m, max(1, round(length_m / lap_m)), speed, min(rate_limit_rad_s, LATERAL_M_S2 / speed))
    return Drive(_lasting(route.stand(end_stand_s).steps(), max(1, round(seconds * RATE_HZ))), 0)


def _wave(route: Route, length_m: float, waves: int, speed_m_s: float, limit_rad_s: float = math.inf) -> None:
    """Vary the heading as a sine over the path, so that each wave is a closed figure of eight, if the limit allows."""
    per_m, cells = 2.0 * math.pi * waves / length_m, max(2000, round(100.0 * length_m))
    along = (np.arange(cells) + 0.5) * length_m / cells
    swing = min(EIGHT_SWING_RAD, limit_rad_s / (speed_m_s * per_m))
    route.curve(length_m, swing * per_m * np.cos(per_m * along), speed_m_s)


def read_waypoints(file: Path) -> tuple[list[tuple[float, float]], list[float]]:
    """Read points, and speeds of the legs towards them (default 1 m/s), from a CSV file with x_m,y_m[,speed_m_s].

    Raises ConfigError with file, line and column.
    """
    table = read_table(file, (POINT, (*POINT, SPEED)), rows=2, rising=None)
    for name, values in zip(table.header, table.values.T, strict=True):
        low, high = SPEEDS_M_S if name == SPEED else PLACES_M
        wrong = np.flatnonzero((values < low) | (values > high))
        if wrong.size:
            raise table.refuse(int(wrong[0]), name, f"a number from {low:g} to {high:g}")
    near = np.flatnonzero(np.hypot(*np.diff(table.values[:, :2], axis=0).T) < APART_M)
    if near.size:
        got = f"points {near[0] + 1} and {near[0] + 2}"
        raise ConfigError(str(file), "", f"way-points at least {APART_M:g} m apart", got)
    rows = table.values.tolist()
    return [(row[0], row[1]) for row in rows], [row[2] if len(row) > 2 else 1.0 for row in rows[1:]]


def waypoint_lap(file: Path) -> tuple[Callable[[Route, int], object], tuple[float, float, float]]:
    """Lap from the first point along all others, and its start; further laps return to the first point."""
    points, speeds = read_waypoints(file)
    (x, y), (to_x, to_y) = points[:2]

    def lap(route: Route, number: int) -> None:
        if number and math.hypot(route.x_m - x, route.y_m - y) > 0.01:
            route.go(points[:1], 1.0)
        route.go(points[1:], 1.0, speeds_m_s=speeds)

    return lap, (x, y, math.atan2(to_y - y, to_x - x))


def _square(side: float) -> Callable[[Route, int], object]:
    """Path of Chung, Ojeda and Borenstein (2001), section 4: 210 m; slow near the corners' eight via-points."""

    def lap(route: Route, _: int) -> None:
        for _corner in range(4):
            route.straight(1.0, 0.8).straight(44.5, 1.5).straight(1.0, 0.8).bend(side * QUARTER, 6.0, 0.8)

    return lap


def _eights(route: Route, _: int) -> None:
    _wave(route, 50.0, 1, 1.2)


def _warehouse(route: Route, number: int) -> None:
    side = 1.0 if number % 2 == 0 else -1.0

    def go(speed_m_s: float, *points: tuple[float, float]) -> None:
        route.go([(x, side * y) for x, y in points], speed_m_s, corner_m=2.5)

    go(1.4, (14.0, 0.0))
    route.stand(6.0)
    go(1.4, (24.0, 0.0), (24.0, 4.0), (10.0, 4.0))
    route.stand(4.0)
    go(1.0, (3.0, 4.0), (3.0, 8.0), (9.0, 8.0))
    route.straight(-2.0, 0.4).stand(5.0)
    go(0.7, (16.0, 8.0), (16.0, 12.0), (20.0, 12.0))
    route.turn(side * math.pi, 0.7).stand(3.0)
    go(1.2, (-4.0, 12.0), (-4.0, 0.0), (0.0, 0.0))
    # The mirrored lap cancels the net turn.
    route.stand(4.0)


def _field(route: Route, _: int) -> None:
    lines, length_m, apart_m = 4, 30.0, 3.0
    # The sideways displacement of a half-turn bend is a fixed fraction of its length.
    bend_m = apart_m / bend_shape(math.pi)[1]
    for line in range(lines):
        route.straight(length_m, 1.0)
        if line + 1 < lines:
            route.bend(math.pi if line % 2 == 0 else -math.pi, bend_m, 0.6)
    y_m = route.y_m
    route.go([(-4.0, y_m), (-4.0, y_m - 3.0 * apart_m), (0.0, y_m - 3.0 * apart_m)], 1.4, corner_m=4.0)


def _umbmark(side: float) -> Callable[[Route, int], object]:
    """Borenstein and Feng (1996): a square of 4 m with stops, turns on the spot."""

    def lap(route: Route, _: int) -> None:
        for _corner in range(4):
            route.straight(4.0, 0.4).stand(0.5).turn(side * QUARTER, 0.7).stand(0.5)

    return lap


def _spins(route: Route, _: int) -> None:
    for rate_deg_s in (5.0, 15.0, 30.0, 50.0):
        for side in (1.0, -1.0):
            turns = 1.0 if rate_deg_s < 10.0 else 2.0
            route.turn(side * turns * 2.0 * math.pi, math.radians(rate_deg_s)).stand(3.0)


def _slalom(route: Route, _: int) -> None:
    gates, swing = 12, 0.7  # even, so that it ends in the initial direction
    for _direction in range(2):
        route.bend(swing, 2.5, 1.5)
        for gate in range(gates):
            route.bend(2.0 * swing * (-1.0 if gate % 2 == 0 else 1.0), 4.0, 1.5)
        route.bend(-swing, 2.5, 1.5).bend(math.pi, 10.0, 1.0)


def _stand(route: Route, _: int) -> None:
    route.stand(10.0)


MISSIONS: Final = {
    "square-cw": Mission("the paper's: 210 m with rounded corners, clockwise; 1.5 and 0.8 m/s", _square(-1.0)),
    "square-ccw": Mission("the same counter-clockwise", _square(1.0)),
    "eights": Mission("figures of eight of 50 m, 1.2 m/s", _eights),
    "warehouse": Mission("aisles, stops, reversing, turns on the spot; every other lap mirrored", _warehouse),
    "field": Mission("a survey: parallel lines of 30 m with turns left and right, then back", _field),
    "umbmark-cw": Mission("a square of 4 m with turns on the spot, clockwise", _umbmark(-1.0)),
    "umbmark-ccw": Mission("the same counter-clockwise", _umbmark(1.0)),
    "spins": Mission("turns on the spot, both ways, 5 to 50 deg/s, with standstills", _spins),
    "slalom": Mission("weaving at up to 1.5 m/s, there and back", _slalom),
    "stand": Mission("standing still", _stand),
}
