"""One live sample of a motion, smoothed where necessary, and clipped to the range in which an effect was seen."""

import math
from typing import Final

import numpy as np

from drd.arrays import Array
from drd.effects.model import COVARIATES, Term
from drd.effects.motion import Motion

# A sensor that has been silent for longer says nothing about the present.
STALE_S: Final = 0.5


class Trend:
    """The newest value of a sampled signal, and its slope."""

    def __init__(self) -> None:
        self._t_s, self._step_s = -math.inf, 0.0
        self._value = self._slope = 0.0

    def take(self, t_s: float, value: float) -> None:
        """Take a new value."""
        step_s = t_s - self._t_s
        self._step_s = step_s if 0.0 < step_s <= STALE_S else 0.0
        self._slope = (value - self._value) / step_s if self._step_s else 0.0
        self._t_s, self._value = t_s, value

    def at(self, t_s: float) -> float | None:
        """The value at a time up to one sample away; None where the last one is too old."""
        ahead_s = t_s - self._t_s
        if ahead_s > STALE_S:
            return None
        return self._value + self._slope * min(max(ahead_s, -self._step_s), self._step_s)


class LiveMotion(Motion):
    """A motion of one sample, overwritten each time; the temperature's lags have a memory."""

    __slots__ = ("_lags", "_lowest", "_t_s", "_warmest", "temperature_rate_outside")

    def __init__(self, tread_m: float, wheel_radius_m: float, end_s: float):
        time, rate, speed, acceleration, heading, left, right, left_wheel, right_wheel = np.zeros((9, 1))
        unknown = np.full(1, math.nan)
        super().__init__(
            time,
            rate,
            speed,
            acceleration,
            heading,
            left,
            right,
            left_wheel,
            right_wheel,
            unknown,
            math.nan,
            tread_m,
            wheel_radius_m,
            end_s,
        )
        self._lags: dict[float, float] = {}
        self._t_s = math.nan
        self.limit_temperature_rate(-math.inf, math.inf)

    def limit_temperature_rate(self, low: float, high: float) -> None:
        """Set the limits of `temperature_rate_c_s`; `temperature_rate_outside` then says whether it was clipped."""
        self._lowest, self._warmest, self.temperature_rate_outside = low, high, False

    def warm(self, t_s: float, temperature_c: float) -> None:
        """Take the gyro's temperature at a time; NaN changes nothing."""
        if math.isnan(temperature_c):
            return
        before_c, step_s = float(self.temperature_c[0]), t_s - self._t_s
        for lag_s, lagged_c in self._lags.items():
            if step_s > 0.0:  # as Motion.lagged
                kept = math.exp(-step_s / lag_s)
                share = lag_s * (1.0 - kept) / step_s
                driven = before_c * (share - kept) + temperature_c * (1.0 - share)
                self._lags[lag_s] = temperature_c if math.isnan(lagged_c) else lagged_c * kept + driven
            elif math.isnan(lagged_c):
                self._lags[lag_s] = temperature_c
        self.temperature_c[0], self._t_s = temperature_c, t_s

    def temperature_rate_c_s(self, lag_s: float) -> Array:
        """Temperature rate behind a lag, which is tracked from its first use on."""
        lagged_c = self._lags.setdefault(lag_s, float(self.temperature_c[0]))
        rate = float(np.nan_to_num((self.temperature_c[0] - lagged_c) / lag_s))
        clipped = min(max(rate, self._lowest), self._warmest)
        self.temperature_rate_outside |= clipped != rate
        return np.full(1, clipped)


def scalar(value: Array | float) -> float:
    """The value of one sample."""
    return value.item() if isinstance(value, np.ndarray) else float(value)


class Clip:
    """Clips the covariates of one effect to the range in which it was seen, and restores them."""

    def __init__(self, m: LiveMotion, term: Term):
        self._m = m
        self._ends = {
            name: (low * COVARIATES[name].si, high * COVARIATES[name].si) for name, (low, high) in term.seen.items()
        }
        self._arrays = (m.time_s, m.rate_rad_s, m.speed_m_s, m.acceleration_m_s2, m.left_m_s, m.right_m_s,
                        m.temperature_c)  # fmt: skip
        self._kept = [0.0] * len(self._arrays)
        self._is_kept = False
        self._rate_ends = self._ends.pop("temperature_rate", None)
        self.is_bounded = bool(term.seen)

    def apply(self) -> bool:
        """Clip; True where a covariate was outside. `undo` must follow."""
        if self._rate_ends is not None:
            self._m.limit_temperature_rate(*self._rate_ends)
        is_outside = False
        for name, (low, high) in self._ends.items():
            is_outside |= self._clip(name, low, high)
        return is_outside

    def undo(self) -> bool:
        """Restore the motion; True where the rate of temperature was outside."""
        if self._is_kept:
            for array, value in zip(self._arrays, self._kept, strict=True):
                array[0] = value
            self._is_kept = False
        if self._rate_ends is None:
            return False
        outside = self._m.temperature_rate_outside
        self._m.limit_temperature_rate(-math.inf, math.inf)
        return outside

    def _keep(self) -> None:
        """Save the motion before its first covariate is clipped, which rarely happens."""
        if not self._is_kept:
            for i, array in enumerate(self._arrays):
                self._kept[i] = array[0]
            self._is_kept = True

    def _clip(self, name: str, low: float, high: float) -> bool:
        m = self._m
        if name in ("time", "acceleration", "temperature"):
            array = {"time": m.time_s, "acceleration": m.acceleration_m_s2, "temperature": m.temperature_c}[name]
            value = array[0]
            if low <= value <= high:
                return False  # an unknown temperature is outside, too
            self._keep()
            array[0] = min(max(value, low), high)
            return True
        v, w = float(m.speed_m_s[0]), float(m.rate_rad_s[0])
        bend = abs(w) / max(abs(v), 1e-9)
        value = {"speed": v, "yaw_rate": w, "lateral_acceleration": v * w, "curvature": bend}[name]
        clipped = min(max(value, low), high)
        if clipped == value:
            return False
        self._keep()
        ahead, half_turn = 0.0, 0.0  # to be added to the wheels' speeds
        if name == "curvature":
            m.speed_m_s[0] = math.copysign(abs(w) / max(clipped, 1e-9), v)
        elif name == "speed":
            m.speed_m_s[0], ahead = clipped, clipped - v
        elif name == "yaw_rate" or abs(v) > 1e-6:
            turn = clipped if name == "yaw_rate" else clipped / v
            m.rate_rad_s[0], half_turn = turn, 0.5 * m.tread_m * (turn - w)
        m.left_m_s[0] += ahead - half_turn
        m.right_m_s[0] += ahead + half_turn
        return True
