"""The true motion at 500 Hz."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from drd.arrays import Array, cumulative
from drd_tools.simulate.missions import Drive
from drd_tools.simulate.route import STEP_S
from drd_tools.simulate.temperature import temperature_c


class Place(NamedTuple):
    """Pose of the robot, heading not wrapped, and its travel: forward minus backward."""

    x_m: float
    y_m: float
    heading_rad: float
    distance_m: float


@dataclass(frozen=True)
class Truth:
    """True motion in n steps of STEP_S: means over each step, shape (n,), and states at their ends, shape (n + 1,).

    Forward and sideways (left positive) speed and yaw rate are the body's; the temperature is the gyro's, at the
    middle of each step.
    """

    speed_m_s: Array
    lateral_m_s: Array
    rate_rad_s: Array
    temperature_c: Array
    x_m: Array
    y_m: Array
    heading_rad: Array
    laps: int

    @property
    def time_s(self) -> Array:
        """Times of the states, from 0."""
        return np.asarray(STEP_S * np.arange(len(self.x_m)))

    @property
    def middle_s(self) -> Array:
        """Times of the steps' middles."""
        return np.asarray(STEP_S * (np.arange(len(self.speed_m_s)) + 0.5))

    @property
    def duration_s(self) -> float:
        """Duration of the whole run."""
        return STEP_S * len(self.speed_m_s)

    @property
    def length_m(self) -> float:
        """Length of the path, forward and backward."""
        return float(np.abs(self.speed_m_s).sum() * STEP_S)

    @cached_property
    def distance_m(self) -> Array:
        """Travel at the states: forward minus backward, from 0."""
        return cumulative(self.speed_m_s) * STEP_S

    @cached_property
    def _places(self) -> Array:
        return np.column_stack((self.x_m, self.y_m, self.heading_rad, self.distance_m))

    def at(self, t_s: float) -> Place:
        """Interpolate the place `t_s` after the start; before it and after the end the robot stands still."""
        position = min(max(t_s / STEP_S, 0.0), float(len(self.speed_m_s)))
        index = min(int(position), len(self.speed_m_s) - 1)
        before, after = self._places[index], self._places[index + 1]
        return Place(*(before + (position - index) * (after - before)).tolist())

    def sliding(self, lateral_m_s: Array) -> "Truth":
        """The same drive with the body sliding sideways, shape (n,)."""
        x, y = _path(self.speed_m_s, lateral_m_s, self.heading_rad, (float(self.x_m[0]), float(self.y_m[0])))
        return replace(self, lateral_m_s=lateral_m_s, x_m=x, y_m=y)


def make_truth(drive: Drive, temperature: str = "warmup") -> Truth:
    """Combine a drive with a temperature profile (see `temperature.temperature_c`). Raises ConfigError."""
    forward, turned = drive.steps
    x, y, heading = drive.start
    n = len(forward)
    speed, lateral = forward / STEP_S, np.zeros(n)
    headings = heading + cumulative(turned)
    middle_s = np.asarray(STEP_S * (np.arange(n) + 0.5))
    temperatures = temperature_c(temperature, middle_s, n * STEP_S)
    return Truth(
        speed, lateral, turned / STEP_S, temperatures, *_path(speed, lateral, headings, (x, y)), headings, drive.laps
    )


def _path(speed: Array, lateral: Array, heading: Array, start: tuple[float, float]) -> tuple[Array, Array]:
    middle = 0.5 * (heading[1:] + heading[:-1])
    c, s = np.cos(middle) * STEP_S, np.sin(middle) * STEP_S
    steps = (speed * c - lateral * s, speed * s + lateral * c)
    x, y = (at + cumulative(step) for at, step in zip(start, steps, strict=True))
    return x, y
