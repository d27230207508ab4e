"""A commanded path, leg by leg, and the motion of a robot with limited acceleration along it."""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple, Self

import numpy as np

from drd.arrays import Array, cumulative

RATE_HZ: Final = 500
STEP_S: Final = 1.0 / RATE_HZ
# Approximate length of the path's cells; curvature and speed limit are constant in each.
CELL_M: Final = 0.004
# Speed is averaged over this time, so that acceleration is continuous.
SMOOTHING_S: Final = 0.8
ACCELERATION_M_S2: Final = 0.5
LATERAL_M_S2: Final = 0.8
RATE_LIMIT_RAD_S: Final = 0.9
TURN_ACCELERATION_RAD_S2: Final = 1.2
# At sharper corners, or without room for a bend, the robot stops and turns on the spot.
SHARPEST_BEND_RAD: Final = math.radians(150.0)
SHORTEST_BEND_M: Final = 0.2


class Steps(NamedTuple):
    """The body's motion in each step of STEP_S: forward travel and left turn, shape (n,) each."""

    forward_m: Array
    turned_rad: Array


class Route:
    """Builder of a route from consecutive legs. It starts at the origin, heading 0 (along x), or as given."""

    def __init__(self, x_m: float = 0.0, y_m: float = 0.0, heading_rad: float = 0.0):
        self.x_m, self.y_m, self.heading_rad = x_m, y_m, heading_rad
        self._done: list[Steps] = []
        self._cells: list[tuple[Array, Array, Array]] = []

    def curve(self, length_m: float, curvature_per_m: Array, speed_m_s: float) -> Self:
        """Drive cells of equal length, shape (n,), slower where yaw rate or lateral acceleration require it."""
        cells, bend = len(curvature_per_m), np.abs(curvature_per_m) + 1e-9
        limit = np.minimum(speed_m_s, np.minimum(RATE_LIMIT_RAD_S / bend, np.sqrt(LATERAL_M_S2 / bend)))
        cell_m = np.full(cells, length_m / cells)
        self._cells.append((cell_m, curvature_per_m, limit))
        heading = self.heading_rad + cumulative(cell_m * curvature_per_m)
        middle = 0.5 * (heading[1:] + heading[:-1])
        self.x_m += float(cell_m @ np.cos(middle))
        self.y_m += float(cell_m @ np.sin(middle))
        self.heading_rad = float(heading[-1])
        return self

    def straight(self, length_m: float, speed_m_s: float) -> Self:
        """Drive straight ahead; negative: backwards, from standstill to standstill."""
        if length_m < 0.0:
            self._stop()
        self.curve(abs(length_m), np.zeros(_cells(length_m)), speed_m_s)
        if length_m < 0.0:
            self._stop(-1.0)
            self.x_m += 2.0 * length_m * math.cos(self.heading_rad)
            self.y_m += 2.0 * length_m * math.sin(self.heading_rad)
        return self

    def bend(self, angle_rad: float, length_m: float, speed_m_s: float) -> Self:
        """Drive a bend whose curvature is a raised cosine, left positive."""
        u = (np.arange(_cells(length_m)) + 0.5) / _cells(length_m)
        return self.curve(length_m, angle_rad / length_m * (1.0 - np.cos(2.0 * math.pi * u)), speed_m_s)

    def turn(self, angle_rad: float, rate_rad_s: float = 0.6) -> Self:
        """Stop and turn on the spot, left positive."""
        self._stop()
        if angle_rad:
            self._done.append(_turning(angle_rad, rate_rad_s))
        self.heading_rad += angle_rad
        return self

    def stand(self, seconds: float) -> Self:
        """Stop and stand."""
        self._stop()
        still = np.zeros(round(seconds * RATE_HZ))
        self._done.append(Steps(still, still))
        return self

    def go(
        self,
        points_m: Sequence[tuple[float, float]],
        speed_m_s: float,
        corner_m: float = 2.0,
        speeds_m_s: Sequence[float] = (),
    ) -> Self:
        """Drive from point to point, rounding corners over `corner_m` of path; `speeds_m_s`: speed of each leg."""
        corners = np.array([(self.x_m, self.y_m), *points_m])
        legs = np.diff(corners, axis=0)
        lengths, headings = np.hypot(*legs.T), np.arctan2(legs[:, 1], legs[:, 0])
        if abs(angle := math.remainder(headings[0] - self.heading_rad, 2.0 * math.pi)) > 1e-6:
            self.turn(angle)
        cut_m = 0.0
        for i, length_m in enumerate(lengths.tolist()):
            speed = speeds_m_s[i] if speeds_m_s else speed_m_s
            angle, bend_m, tangent_m = 0.0, 0.0, 0.0
            if i + 1 < len(lengths):
                angle = math.remainder(headings[i + 1] - headings[i], 2.0 * math.pi)
                bend_m, tangent_m = _corner(angle, corner_m, 0.5 * min(length_m, lengths[i + 1]))
            if length_m - cut_m - tangent_m > 1e-6:
                self.straight(length_m - cut_m - tangent_m, speed)
            if bend_m:
                self.bend(angle, bend_m, speed)
            elif abs(angle) > 1e-9:
                self.turn(angle)
            cut_m = tangent_m
        return self

    def steps(self) -> Steps:
        """Motion over the whole route, from standstill to standstill."""
        self._stop()
        forward, turned = zip(*self._done, strict=True)
        return Steps(np.concatenate(forward), np.concatenate(turned))

    def _stop(self, sign: float = 1.0) -> None:
        if self._cells:
            length, curvature, limit = map(np.concatenate, zip(*self._cells, strict=True))
            self._done.append(_riding(length, curvature, limit, sign))
            self._cells = []


def bend_shape(angle_rad: float) -> tuple[float, float]:
    """End point x, y of a bend of unit length that starts along x."""
    u = (np.arange(2000) + 0.5) / 2000
    heading = angle_rad * (u - np.sin(2.0 * math.pi * u) / (2.0 * math.pi))
    return float(np.cos(heading).mean()), float(np.sin(heading).mean())


def _corner(angle_rad: float, length_m: float, room_m: float) -> tuple[float, float]:
    """Length of a bend, and distance of its ends from the corner; zeros: turn on the spot."""
    if not 1e-9 < abs(angle_rad) < SHARPEST_BEND_RAD:
        return 0.0, 0.0
    tangent = math.hypot(*bend_shape(angle_rad)) / (2.0 * math.cos(0.5 * angle_rad))
    length_m = min(length_m, room_m / tangent)
    return (length_m, length_m * tangent) if length_m >= SHORTEST_BEND_M else (0.0, 0.0)


def _cells(length_m: float) -> int:
    return max(5, math.ceil(abs(length_m) / CELL_M))


def _riding(length_m: Array, curvature_per_m: Array, limit_m_s: Array, sign: float) -> Steps:
    """Move through cells, shape (n,) each, from standstill to standstill; `sign` -1 is backwards."""
    travel_m = _ride(length_m, limit_m_s, ACCELERATION_M_S2)
    heading = np.interp(travel_m, cumulative(length_m), cumulative(length_m * curvature_per_m))
    return Steps(sign * np.diff(travel_m), sign * np.diff(heading))


def _turning(angle_rad: float, rate_rad_s: float) -> Steps:
    """Turn on the spot, left positive."""
    cells = max(1, math.ceil(abs(angle_rad) / 0.01))
    cell, limit = np.full(cells, abs(angle_rad) / cells), np.full(cells, rate_rad_s)
    turned = np.diff(_ride(cell, limit, TURN_ACCELERATION_RAD_S2))
    return Steps(np.zeros_like(turned), math.copysign(1.0, angle_rad) * turned)


def _ride(cell: Array, limit: Array, acceleration: float) -> Array:
    """Compute the travel at every STEP_S, from standstill to standstill, through cells with speed limits."""
    along = cumulative(cell)
    squared = np.concatenate(([0.0], np.minimum(limit[1:], limit[:-1]) ** 2, [0.0]))
    gained = 2.0 * acceleration * along  # v^2 = v0^2 + 2 a s, forward and backward
    squared = np.minimum.accumulate(squared - gained) + gained
    squared = (np.minimum.accumulate((squared + gained)[::-1]) - gained[::-1])[::-1]
    speed = np.sqrt(np.maximum(squared, 0.0))
    reached_s = cumulative(2.0 * cell / np.maximum(speed[1:] + speed[:-1], 1e-6))
    ticks = np.arange(math.ceil(reached_s[-1] * RATE_HZ) + 1) * STEP_S
    kernel = np.hanning(round(SMOOTHING_S * RATE_HZ))
    path = cumulative(np.convolve(np.diff(np.interp(ticks, reached_s, along)), kernel / kernel.sum()))
    path[-1] = along[-1]
    return np.asarray(np.minimum(path, along[-1]))
