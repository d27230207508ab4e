"""The robot's own control: pure pursuit of a path, turns on the spot, wheel speeds."""

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from drd_tools.mujoco_world.missions import CELL_M, Follow, Leg, Stand
from drd_tools.mujoco_world.vehicle import Vehicle

CONTROL_HZ: Final = 50
CONTROL_S: Final = 1.0 / CONTROL_HZ
LOOK_AHEAD_M: Final = 0.5
SEARCH_CELLS: Final = 50
ACCELERATION_M_S2: Final = 0.5
TURN_ACCELERATION_RAD_S2: Final = 1.2
RATE_LIMIT_RAD_S: Final = 0.9
CREEP_M_S: Final = 0.05
SPIN_GAIN_PER_S: Final = 2.0
SPIN_DONE_RAD: Final = 0.003
# Factor on the track in the drive's own software, as makers of such robots have (Husky A200: 1.875).
STEERING_RATIO: Final = 1.8


class Pilot:
    """Controller that knows the true pose, but not the robot's own sensors. Pure pursuit: Coulter (1992)."""

    def __init__(self, legs: Iterator[Leg], vehicle: Vehicle):
        self._legs = legs
        self._half_m = 0.5 * vehicle.track_m * STEERING_RATIO
        self._radius_m = vehicle.wheel_radius_m
        self._speed_m_s = self._rate_rad_s = self._turned_rad = 0.0
        self._yaw_rad: float | None = None
        self._next()

    def wheels_rad_s(self, x_m: float, y_m: float, yaw_rad: float) -> tuple[float, float] | None:
        """Speeds of the left and right wheels for the next CONTROL_S; None after all legs."""
        if self._yaw_rad is not None:
            self._turned_rad += math.remainder(yaw_rad - self._yaw_rad, 2.0 * math.pi)
        self._yaw_rad = yaw_rad
        if self._leg is None:
            return None
        speed, rate = self._wanted(self._leg, x_m, y_m, yaw_rad)
        self._speed_m_s = _towards(self._speed_m_s, speed, ACCELERATION_M_S2 * CONTROL_S)
        self._rate_rad_s = _towards(self._rate_rad_s, rate, TURN_ACCELERATION_RAD_S2 * CONTROL_S)
        turn = self._rate_rad_s * self._half_m
        return (self._speed_m_s - turn) / self._radius_m, (self._speed_m_s + turn) / self._radius_m

    def _next(self) -> None:
        self._leg = next(self._legs, None)
        self._cell, self._stood_s, self._turned_rad = 0, 0.0, 0.0

    def _wanted(self, leg: Leg, x_m: float, y_m: float, yaw_rad: float) -> tuple[float, float]:
        if isinstance(leg, Follow):
            return self._pursue(leg, x_m, y_m, yaw_rad)
        if self._speed_m_s > 0.0:
            self._turned_rad = 0.0
            return 0.0, 0.0
        if isinstance(leg, Stand):
            self._stood_s += CONTROL_S
            if self._stood_s >= leg.seconds:
                self._next()
            return 0.0, 0.0
        remaining = leg.angle_rad - self._turned_rad
        if abs(remaining) < SPIN_DONE_RAD:
            self._next()
            return 0.0, 0.0
        return 0.0, max(-leg.rate_rad_s, min(leg.rate_rad_s, SPIN_GAIN_PER_S * remaining))

    def _pursue(self, leg: Follow, x_m: float, y_m: float, yaw_rad: float) -> tuple[float, float]:
        path_m, last = leg.path_m, len(leg.path_m) - 1
        near = path_m[self._cell : self._cell + SEARCH_CELLS]
        self._cell += int(np.argmin(np.square(near - (x_m, y_m)).sum(axis=1)))
        if self._cell == last:
            self._next()
            return 0.0, 0.0
        ahead = self._cell + round(LOOK_AHEAD_M / CELL_M)
        goal = path_m[min(ahead, last)] + max(0, ahead - last) * (path_m[-1] - path_m[-2])
        dx, dy = (goal - (x_m, y_m)).tolist()
        aside = math.cos(yaw_rad) * dy - math.sin(yaw_rad) * dx
        curvature = 2.0 * aside / (dx * dx + dy * dy)
        remaining_m = CELL_M * (last - self._cell)
        speed = min(leg.speed_m_s, CREEP_M_S + math.sqrt(ACCELERATION_M_S2 * remaining_m))
        speed = min(speed, RATE_LIMIT_RAD_S / max(abs(curvature), 1e-9))
        rate = self._speed_m_s * curvature
        return speed, max(-RATE_LIMIT_RAD_S, min(RATE_LIMIT_RAD_S, rate))


def _towards(value: float, wanted: float, most: float) -> float:
    return value + max(-most, min(most, wanted - value))
