"""Constants that the monitor has found, adopted by the filter between two samples, and restored; no pose jumps."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from msgspec import Struct

from drd.estimation.filter import Filter
from drd.estimation.state import GYRO_BIAS, GYRO_SCALE, SCALE_L, SCALE_R, TREAD, WHEEL_LAG, Matrix, N
from drd.estimation.track import Track
from drd.units import RAD_PER_DEG

RADII: Final = "radii"
TURN: Final = "turn"
LAG: Final = "wheel_lag_s"
BIAS: Final = "bias_rad_s"
# Largest difference from the configuration. Radii: a tyre that has lost more is flat. Turn: beyond, the wheels slip
# sideways and the tread changes with the ground. Lag: a later bus or drive needs repair. Bias: 0.1 deg/s, the worst
# of the supported gyros; beyond, the gyro is broken.
LARGEST: Final = {RADII: 0.03, TURN: 0.15, LAG: 0.1, BIAS: 0.1 * RAD_PER_DEG}
CONSTANTS: Final = (SCALE_R, SCALE_L, TREAD, GYRO_SCALE, GYRO_BIAS, WHEEL_LAG)  # states that adopting one may correct
BOTH: Final = 0.5  # the left wheel's share of a change of the radii, if it is unknown which has changed


class Constant(Struct, frozen=True):
    """A constant and its standard deviation, SI.

    `name`: RADII, the left radius over the right one, less 1; TURN, tread times the gyro's scale over the configured
    tread, less 1; LAG, the wheels' delay; BIAS, the gyro's. `left`: the left wheel's share of a change of radii.
    """

    name: str
    value: float
    sigma: float
    left: float = BOTH

    def refusal(self) -> str | None:
        """The reason why it cannot be adopted; None: it can."""
        if self.name not in LARGEST:
            return f"{self.name}: not a constant that can be adopted"
        if not abs(self.value) <= LARGEST[self.name]:
            return f"{self.name}: {self.value:.3g} exceeds {LARGEST[self.name]:g}"
        if not 0.0 < self.sigma <= LARGEST[self.name]:
            return f"{self.name}: its standard deviation {self.sigma:.3g} is not in (0, {LARGEST[self.name]:g}]"
        return None if 0.0 <= self.left <= 1.0 else f"{self.name}: left {self.left:.3g} is not in [0, 1]"


def of_filter(kf: Filter, name: str, tread_m: float, left: float = BOTH) -> Constant:
    """The filter's value of a constant. `tread_m`: the configured one."""
    h, n = _row(kf, name), kf.nominal
    value = {
        RADII: n.scale_right - n.scale_left,
        TURN: n.tread_m * n.gyro_scale / tread_m - 1.0,
        LAG: n.wheel_lag_s,
        BIAS: -n.gyro_bias_rad_s / n.gyro_scale,  # (28)
    }[name]
    return Constant(name, value, math.sqrt(max(float(h @ kf.P @ h), 0.0)), left)


def take(kf: Filter, constant: Constant, tread_m: float) -> None:
    """Adopt a constant as a measurement, after allowing for its change; pose and headings stay. (109)"""
    h = _row(kf, constant.name)
    off = of_filter(kf, constant.name, tread_m).value - constant.value
    g = _changed(kf, constant)
    kf.P += off * off * np.outer(g, g)
    gain = np.zeros(N)
    for i in CONSTANTS:
        gain[i] = kf.P[i] @ h
    gain /= float(h @ kf.P @ h) + constant.sigma**2
    _move(kf, gain * off)
    rest = np.eye(N) - np.outer(gain, h)
    P = rest @ kf.P @ rest.T + constant.sigma**2 * np.outer(gain, gain)  # Joseph form: holds for any gain
    np.copyto(kf.P, 0.5 * (P + P.T))
    kf.given += 1


def put_back(kf: Filter, constant: Constant, tread_m: float) -> None:
    """Restore the value that a constant had replaced, with at least its uncertainty at that time. (109)

    Not as a measurement: an uncertain one would hardly move the filter.
    """
    g = _changed(kf, constant)
    for _ in range(2):  # TURN is a product, and one step is only linear
        now = of_filter(kf, constant.name, tread_m)
        _move(kf, (now.value - constant.value) * g)
    kf.P += max(constant.sigma**2 - now.sigma**2, 0.0) * np.outer(g, g)
    kf.given += 1


def _move(kf: Filter, error: Matrix) -> None:
    """Subtract an error (N,) of CONSTANTS from the nominal state."""
    n, step = kf.nominal, error.tolist()
    n.scale_right -= step[SCALE_R]
    n.scale_left -= step[SCALE_L]
    n.gyro_scale -= step[GYRO_SCALE]
    n.gyro_bias_rad_s -= step[GYRO_BIAS]
    n.wheel_lag_s -= step[WHEEL_LAG]
    kf.set_tread(n.tread_m - step[TREAD])


def _row(kf: Filter, name: str) -> Matrix:
    """Jacobian of a constant with respect to the error state."""
    h, n = np.zeros(N), kf.nominal
    if name == RADII:
        h[SCALE_R], h[SCALE_L] = 1.0, -1.0
    elif name == TURN:
        h[TREAD], h[GYRO_SCALE] = 1.0 / n.tread_m, 1.0 / n.gyro_scale
    elif name == LAG:
        h[WHEEL_LAG] = 1.0
    else:
        h[GYRO_BIAS] = -1.0 / n.gyro_scale
    return h


def _changed(kf: Filter, constant: Constant) -> Matrix:
    """Change of the error state per unit of the constant: of one tyre or both, of the tread, of the lag."""
    g = np.zeros(N)
    if constant.name == RADII:
        g[SCALE_R], g[SCALE_L] = 1.0 - constant.left, -constant.left
    elif constant.name == TURN:
        g[TREAD] = kf.nominal.tread_m
    elif constant.name == LAG:
        g[WHEEL_LAG] = 1.0
    else:
        g[GYRO_BIAS] = -kf.nominal.gyro_scale
    return g


Pose = tuple[float, float, float]  # x and y in m, heading in rad


@dataclass
class Applied:
    """Adopted constants, and the filter's values that they replaced."""

    taken: dict[str, Constant] = field(default_factory=dict)
    before: dict[str, Constant] = field(default_factory=dict)

    def change(
        self, track: Track, pose: Callable[[], Pose], tread_m: float, name: str, constant: Constant | None
    ) -> str | None:
        """Adopt a constant, or, if None, restore the previous value; returns why not. The pose of `pose` stays."""
        wanted = self.before.get(name) if constant is None else constant
        if wanted is None or not track.t_ns:
            return f"{name}: {'nothing to restore' if wanted is None else 'no samples yet'}"
        if constant is not None and (refusal := constant.refusal()) is not None:
            return refusal
        here, before = pose(), of_filter(track.kf, name, tread_m, wanted.left)
        (put_back if constant is None else take)(track.kf, wanted, tread_m)
        if name == LAG:
            track.lag_changed(track.kf.nominal.wheel_lag_s - before.value)
        track.kf.move(pose(), here)
        if constant is None:
            del self.taken[name], self.before[name]
        else:
            self.taken[name] = constant
            self.before.setdefault(name, before)
        return None
