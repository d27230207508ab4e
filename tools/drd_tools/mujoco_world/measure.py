"""Measurement of effective tread, slip, sideways motion and centres of rotation, as they emerge from contacts."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import brentq

from drd.arrays import Array
from drd_tools.mujoco_world.vehicle import Vehicle
from drd_tools.mujoco_world.world import ROW_HZ, ROW_S, Motion

BLOCK_S: Final = 0.2
STANDING_M_S: Final = 0.02
TURNING_RAD_S: Final = 0.03
TIGHT_M: Final = 0.3  # turns of smaller radius are on the spot
SHORTEST_S: Final = 1.0
LEAST_TURN_RAD: Final = 0.5
LEAST_DISTANCE_M: Final = 1.0
KINDS: Final = ("straight", "bend left", "bend right", "spin left", "spin right")


@dataclass(frozen=True)
class Blocks:
    """Means over BLOCK_S, shape (n,) each. Wheel speeds are the wheels' angular rates times the nominal radius."""

    time_s: Array
    speed_m_s: Array
    lateral_m_s: Array
    rate_rad_s: Array
    left_m_s: Array
    right_m_s: Array
    friction: Array


@dataclass(frozen=True)
class Manoeuvre:
    """One interval of a kind of motion. Values that it does not determine are NaN.

    `tread_m`: wheel difference over true yaw. `slip`: 1 - (true / mean wheel distance), of the nominal radius, so the
    tyre's deflection is in it. `lateral_s`: v_y over v w. Centres of rotation, from the body frame's origin: of the
    body `ahead_m`; of the left and right wheels `left_m` and `right_m`, left positive; their difference is the tread.
    All by least squares.
    """

    kind: str
    begin_s: float
    end_s: float
    turned_rad: float
    curvature_per_m: float
    tread_m: float
    slip: float
    lateral_s: float
    ahead_m: float
    left_m: float
    right_m: float
    friction: float


def make_blocks(motion: Motion, vehicle: Vehicle) -> Blocks:
    """Average over blocks, dropping an incomplete one at the end."""
    size = round(BLOCK_S * ROW_HZ)
    n = (len(motion.time_s) - 1) // size
    ends = np.arange(n + 1) * size

    def mean(values: Array) -> Array:
        trapezoid = 0.5 * (values[1:] + values[:-1])
        return np.asarray(trapezoid[: n * size].reshape(n, size).mean(axis=1))

    def rate(values: Array) -> Array:
        return np.asarray(np.diff(values[ends]) / (size * ROW_S))

    radius_m = vehicle.wheel_radius_m
    return Blocks(
        mean(motion.time_s),
        mean(motion.speed_m_s),
        mean(motion.lateral_m_s),
        rate(motion.heading_rad),
        radius_m * rate(motion.left_rad),
        radius_m * rate(motion.right_rad),
        mean(motion.friction),
    )


def manoeuvres(blocks: Blocks) -> list[Manoeuvre]:
    """Find the intervals, in order, that are long enough to determine anything."""
    v, w = blocks.speed_m_s, blocks.rate_rad_s
    turning, tight = np.abs(w) > TURNING_RAD_S, np.abs(v) < TIGHT_M * np.abs(w)
    kind = np.where(turning, np.where(tight, 3, 1) + (w < 0.0), np.where(np.abs(v) < STANDING_M_S, -1, 0))
    edges = np.flatnonzero(np.diff(kind)) + 1
    found = []
    for begin, end in zip((0, *edges), (*edges, len(kind)), strict=True):
        turned, distance = float(np.abs(w[begin:end]).sum()) * BLOCK_S, float(np.abs(v[begin:end]).sum()) * BLOCK_S
        enough = distance > LEAST_DISTANCE_M if kind[begin] == 0 else turned > LEAST_TURN_RAD
        if kind[begin] >= 0 and enough and (end - begin) * BLOCK_S >= SHORTEST_S:
            found.append(_measure(KINDS[kind[begin]], blocks, slice(begin, end)))
    return found


def _measure(kind: str, blocks: Blocks, at: slice) -> Manoeuvre:
    v, y, w = blocks.speed_m_s[at], blocks.lateral_m_s[at], blocks.rate_rad_s[at]
    left, right = blocks.left_m_s[at], blocks.right_m_s[at]
    turns, drives = kind != "straight", not kind.startswith("spin")
    nan = float("nan")
    return Manoeuvre(
        kind,
        float(blocks.time_s[at.start]) - 0.5 * BLOCK_S,
        float(blocks.time_s[at.stop - 1]) + 0.5 * BLOCK_S,
        float(w.sum()) * BLOCK_S,
        float(w.sum() / v.sum()) if drives else nan,
        slope(w, right - left) if turns else nan,
        1.0 - slope(0.5 * (left + right), v) if drives else nan,
        slope(v * w, y) if turns and drives else nan,
        -slope(w, y) if turns else nan,
        slope(w, v - left) if turns else nan,
        slope(w, v - right) if turns else nan,
        float(blocks.friction[at].mean()),
    )


def coulomb_tread_ratio(vehicle: Vehicle) -> float:
    """Ratio of effective tread to track in spot turns, with equal loads on all wheels at both edges of their tyres.

    Coulomb friction F is opposite to the sliding velocity: at a point y aside and x along, with wheel speed w Y, that
    is (w (Y - y), w x). The result is the Y for which moments about the middle balance, for any F and w.
    """
    x_m, half_m = 0.5 * vehicle.wheelbase_m, 0.5 * vehicle.track_m
    y_m = half_m + 0.5 * vehicle.tyre_width_m * np.array([-1.0, 1.0])

    def moment(centre_m: float) -> float:
        return float((((centre_m - y_m) * y_m - x_m**2) / np.hypot(centre_m - y_m, x_m)).sum())

    return float(brentq(moment, half_m, half_m + 10.0 * x_m**2 / half_m) / half_m)


def slope(x: Array, y: Array) -> float:
    """Slope of y = slope x, by least squares."""
    return float(x @ y / (x @ x))
