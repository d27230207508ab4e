"""Path of a robot: poses, the steps between them, and corrections for motion within a step."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.interpolate import CubicSpline

from drd.arrays import Array, cumulative
from drd_tools.diagnose.observe.evidence import Evidence

PARTS: Final = 8  # of a step, for the heading within it


@dataclass(frozen=True)
class Path:
    """Poses x_m, y_m, heading_rad at the edges of the steps, shape (n + 1, 3).

    `jump` (n, 3), or 0: jump of the reference's frame in the middle of each step, which the robot did not drive.
    """

    pose: Array
    jump: Array | float = 0.0

    @property
    def moved(self) -> Array:
        """Change of the pose that the robot drove in each step, (n, 3)."""
        result: Array = np.diff(self.pose, axis=0) - self.jump
        return result

    @property
    def middle_rad(self) -> Array:
        """Heading in the middle of each step, (n,)."""
        result: Array = 0.5 * (self.pose[1:, 2] + self.pose[:-1, 2])
        return result

    def steps(self, with_jumps: bool = False) -> tuple[Array, Array, Array]:
        """Each step's travel forward and to the left (m) and turn (rad), (n,) each; with the jumps, if wanted."""
        d = np.diff(self.pose, axis=0) if with_jumps else self.moved
        c, s = np.cos(self.middle_rad), np.sin(self.middle_rad)
        return d[:, 0] * c + d[:, 1] * s, d[:, 1] * c - d[:, 0] * s, d[:, 2]


def dead_reckon(turn_rad: Array, forward_m: Array, start: Array) -> Path:
    """Integrate turns and travel, (n,) each, from the pose `start` (3,). (7)"""
    heading = start[2] + cumulative(turn_rad)
    middle = 0.5 * (heading[1:] + heading[:-1])
    x = start[0] + cumulative(forward_m * np.cos(middle))
    y = start[1] + cumulative(forward_m * np.sin(middle))
    return Path(np.column_stack([x, y, heading]))


def with_jumps(e: Evidence, pose: Array) -> Path:
    """The path of these poses, (n + 1, 3); where the reference jumps, the driven motion is that of the sensors.

    Jumps are ignored if the gyro's lag is not measured: a late sensor makes every turn look like a jump.
    """
    is_sure = e.is_far or e.gyro_rad is None
    at = np.flatnonzero(is_sure & ((e.jump_m2 > 0.0) | (e.jump_rad2 > 0.0)))
    wheels = (e.right_m - e.left_m) / e.tread_m
    turn = (wheels if e.gyro_rad is None else np.where(e.gyroless, wheels, e.gyro_rad))[at]
    middle, travel = 0.5 * (pose[at + 1, 2] + pose[at, 2]), 0.5 * (e.left_m + e.right_m)[at]
    jump = np.zeros((len(e.step_s), 3))
    jump[at] = np.diff(pose, axis=0)[at] - np.column_stack([travel * np.cos(middle), travel * np.sin(middle), turn])
    return Path(pose, jump)


def within_steps(e: Evidence, turn_rad: Array) -> tuple[Array, Array]:
    """Correction of a step's travel for the curvature within it: less along, more across the mean heading, m.

    Chords instead of arcs would be mistaken for a wheel's radius when the robot weaves. `turn_rad` (n,) is used without
    a gyro.
    """
    edges = e.edges_s
    turn = turn_rad if e.gyro_rad is None else np.where(e.gyroless, turn_rad, e.gyro_rad)
    heading = CubicSpline(edges, cumulative(turn))
    inside = edges[:-1, None] + (np.arange(PARTS) + 0.5) / PARTS * np.diff(edges)[:, None]
    off = heading(inside) - 0.5 * (heading(edges[1:]) + heading(edges[:-1]))[:, None]
    travel = 0.5 * (e.left_m + e.right_m)
    return travel * (np.cos(off).mean(axis=1) - 1.0), travel * np.sin(off).mean(axis=1)
