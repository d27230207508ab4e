"""Commanded paths with smooth speed and yaw rate, and the true motion they are, as functions of time."""

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

STEP_S: Final = 0.001
STEP_M: Final = 0.01
# A shorter way has too few steps for its ramps.
SHORTEST_M: Final = 5 * STEP_M
# The speed profile is averaged over this long, so that acceleration has no steps.
SMOOTHING_S: Final = 0.8
# First zero of the Bessel function J0: a path whose heading swings this far (sine over its length) is a closed
# figure of eight, because the mean of exp(i a sin u) over a period is J0(a).
EIGHT_SWING_RAD: Final = 2.404825557695773


class Motion(NamedTuple):
    """The true state of the robot, which starts at the origin with heading 0 (x forward, y left)."""

    x_m: float
    y_m: float
    heading_rad: float  # not wrapped
    v_m_s: float
    w_rad_s: float


class Drive:
    """The true motion, integrated once and then looked up."""

    def __init__(self, speed_m_s: Array, rate_rad_s: Array):
        """Speed and yaw rate (ccw positive) at every millisecond; both arrays of shape (n,), n >= 2.

        Before the first and after the last the robot stands at the ends of the path.
        """
        mid_speed, mid_rate = (speed_m_s[1:] + speed_m_s[:-1]) / 2, (rate_rad_s[1:] + rate_rad_s[:-1]) / 2
        heading = _running_sum(mid_rate * STEP_S)
        mid_heading = (heading[1:] + heading[:-1]) / 2
        x = _running_sum(mid_speed * np.cos(mid_heading) * STEP_S)
        y = _running_sum(mid_speed * np.sin(mid_heading) * STEP_S)
        travel = _running_sum(mid_speed * STEP_S)
        self.table = np.column_stack((x, y, heading, speed_m_s, rate_rad_s, travel))
        self.duration_s = STEP_S * (len(heading) - 1)
        self.length_m = float(travel[-1])

    def at(self, t_s: float) -> Motion:
        """Where the robot is and how it moves, `t_s` seconds after the start."""
        motion = Motion(*self._row(t_s)[:5])
        return motion if 0.0 <= t_s <= self.duration_s else motion._replace(v_m_s=0.0, w_rad_s=0.0)

    def travel_m(self, t_s: float) -> float:
        """Length of the way driven until then."""
        return self._row(t_s)[5]

    def _row(self, t_s: float) -> list[float]:
        position = min(max(t_s, 0.0), self.duration_s) / STEP_S
        index = min(int(position), len(self.table) - 2)
        before, after = self.table[index], self.table[index + 1]
        return [float(value) for value in before + (position - index) * (after - before)]


def square_drive(
    side_m: float = 52.5,
    speed_m_s: float = 1.5,
    corner_speed_m_s: float = 0.8,
    *,
    corner_m: float = 6.0,
    stand_s: float = 10.0,
    clockwise: bool = False,
    laps: int = 1,
) -> Drive:
    """The approximately square path of Chung, Ojeda and Borenstein (2001), section 4: 210 m in about three minutes.

    A quarter of the way, `side_m` long, is a straight and a rounded corner of `corner_m`. The corners' beginnings and
    ends are the eight via-points near which the robot slows down. It ends where it started.
    """
    along = np.arange(0.0, 4 * laps * side_m + STEP_M / 2, STEP_M)
    into_corner = along % side_m - (side_m - corner_m)
    bend = np.where(into_corner > 0, 1 - np.cos(2 * np.pi * into_corner / corner_m), 0.0)
    curvature = np.pi / 2 / corner_m * bend * (-1 if clockwise else 1)
    near_corner = (into_corner > -1.0) | (along % side_m < 1.0)
    limit = np.where(near_corner, corner_speed_m_s, speed_m_s)
    return _drive_along(curvature, limit, acceleration_m_s2=0.5, stand_s=stand_s, end_stand_s=2.0)


def demo_drive(seconds: float, stand_s: float = 10.0, speed_m_s: float = 1.5) -> Drive:
    """Figures of eight that take `seconds`, with a standstill of `stand_s` first and a short one at the end.

    As many metres as fit. Where time is too short for a whole eight at a bearable yaw rate, an open, wavy path;
    where it is too short for that as well, the robot stands.
    """
    acceleration_m_s2, lap_m, rate_limit_rad_s = 0.5, 100.0, 0.8
    end_stand_s = min(2.0, 0.1 * seconds)
    moving_s = seconds - stand_s - end_stand_s - SMOOTHING_S
    speed = min(speed_m_s, acceleration_m_s2 * moving_s / 4)  # at most half of the time is for ramps
    length = speed * (moving_s - speed / acceleration_m_s2)
    if moving_s <= 0 or length < SHORTEST_M:
        still = np.zeros(max(2, round(seconds / STEP_S) + 1))
        return Drive(still, still)
    along = np.linspace(0.0, length, max(2, round(length / STEP_M) + 1))
    waves_per_m = 2 * np.pi * max(1, round(length / lap_m)) / length
    swing = min(EIGHT_SWING_RAD, rate_limit_rad_s / (speed * waves_per_m))
    curvature = swing * waves_per_m * np.cos(waves_per_m * along)
    limit = np.full_like(along, speed)
    return _drive_along(
        curvature,
        limit,
        acceleration_m_s2,
        stand_s=stand_s,
        end_stand_s=end_stand_s,
        step_m=along[1] - along[0],
    )


def _drive_along(
    curvature_per_m: Array,
    limit_m_s: Array,
    acceleration_m_s2: float,
    *,
    stand_s: float,
    end_stand_s: float,
    step_m: float = STEP_M,
) -> Drive:
    """Drive a path given by its curvature and speed limit at every `step_m`, from standstill to standstill."""
    along = step_m * np.arange(len(curvature_per_m))
    squared = limit_m_s**2
    squared[0] = squared[-1] = 0.0
    gained = 2 * acceleration_m_s2 * along  # v^2 = v0^2 + 2 a s, forward and backward
    squared = np.minimum.accumulate(squared - gained) + gained
    squared = (np.minimum.accumulate((squared + gained)[::-1]) - gained[::-1])[::-1]
    speed = np.sqrt(np.maximum(squared, 0.0))
    reached_s = _running_sum(2 * step_m / (speed[1:] + speed[:-1]))

    time_s = np.arange(0.0, reached_s[-1] + STEP_S, STEP_S)
    stepped_speed = np.diff(np.interp(time_s, reached_s, along)) / STEP_S
    kernel = np.hanning(round(SMOOTHING_S / STEP_S))
    smooth_speed = np.convolve(stepped_speed, kernel / kernel.sum())  # the way driven stays the same
    smooth_speed = np.concatenate(
        (
            np.zeros(max(1, round(stand_s / STEP_S))),
            smooth_speed,
            np.zeros(max(1, round(end_stand_s / STEP_S))),
        )
    )
    travel = _running_sum((smooth_speed[1:] + smooth_speed[:-1]) / 2 * STEP_S)
    return Drive(smooth_speed, smooth_speed * np.interp(travel, along, curvature_per_m))


def _running_sum(steps: Array) -> Array:
    return np.concatenate(([0.0], np.cumsum(steps)))
