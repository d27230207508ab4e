"""A robot's motion and temperature, as physical effects see them."""

from dataclasses import dataclass, replace

import numpy as np

from drd.arrays import Array


@dataclass(slots=True)
class Motion:
    """Time series of shape (n,), SI and radians, REP-103; live they have shape (1,) and are overwritten.

    `time_s` counts from the gyro's power-on (else: the recording's start). `rate_rad_s`, `left_m_s` and `right_m_s` are
    what the gyro and the wheels' counters should report, including effects that come earlier in the chain.
    Speed, heading and acceleration are the body's. The wheels' angles count from the start. `temperature_c` is the
    gyro's (NaN: unknown), `still_c` its mean during the standstill in which the bias is measured. `end_s`: when the
    run ends.
    """

    time_s: Array
    rate_rad_s: Array
    speed_m_s: Array
    acceleration_m_s2: Array
    heading_rad: Array
    left_m_s: Array
    right_m_s: Array
    left_wheel_rad: Array
    right_wheel_rad: Array
    temperature_c: Array
    still_c: float
    tread_m: float
    wheel_radius_m: float
    end_s: float

    def turning(self, left_m_s: Array, right_m_s: Array) -> "Motion":
        """The motion with the wheels' angles for other wheel speeds (n,)."""
        left, right = (np.cumsum(more * np.gradient(self.time_s)) / self.wheel_radius_m
                       for more in (left_m_s - self.left_m_s, right_m_s - self.right_m_s))  # fmt: skip
        return replace(self, left_wheel_rad=self.left_wheel_rad + left, right_wheel_rad=self.right_wheel_rad + right)

    def temperature_change_c(self) -> Array:
        """Temperature change since the standstill; 0 where it is not known."""
        return np.nan_to_num(self.temperature_c - self.still_c)

    def temperature_rate_c_s(self, lag_s: float) -> Array:
        """Rate of the temperature behind a first-order lag of `lag_s`; 0 where it is not known."""
        temperature_c = self.temperature_change_c()
        if len(temperature_c) < 2:
            return np.zeros_like(temperature_c)
        return (temperature_c - self.lagged(temperature_c, lag_s)) / lag_s

    def lagged(self, values: Array, lag_s: float) -> Array:
        """`values` behind a first-order lag, exact for straight lines between samples."""
        step_s = np.diff(self.time_s)
        kept = np.exp(-step_s / lag_s)
        # A ramp from a to b over h takes output y to y k + a (r - k) + b (1 - r), k = exp(-h/lag), r = lag (1 - k)/h.
        share = lag_s * (1.0 - kept) / step_s
        driven = values[:-1] * (share - kept) + values[1:] * (1.0 - share)
        # Blocks side by side, then from block to block: about 2 sqrt(n) calls instead of n.
        n = len(step_s)
        length = max(1, round(n**0.5))
        count = -(-n // length)
        k, u = np.ones(count * length), np.zeros(count * length)
        k[:n], u[:n] = kept, driven
        k = np.multiply.accumulate(factors := k.reshape(count, length), axis=1)
        y = u.reshape(count, length)
        for j in range(1, length):
            y[:, j] += factors[:, j] * y[:, j - 1]
        begin = float(values[0])
        for b in range(count):
            y[b] += k[b] * begin
            begin = float(y[b, -1])
        return np.concatenate([values[:1], y.ravel()[:n]])

    def delayed(self, values: Array, delay_s: Array | float) -> Array:
        """`values` as of `delay_s` ago (one delay for each sample, or for all); the ends are held."""
        return self.delay(delay_s)(values)

    def delay(self, delay_s: Array | float) -> "Delay":
        """A delay, to be applied to several series."""
        index = np.arange(len(self.time_s), dtype=float)
        return Delay(np.interp(self.time_s - delay_s, self.time_s, index))

    def wheels_change(self, delay_s: Array | float) -> tuple[Array, Array]:
        """Changes (n,) of the left and the right wheel's speed if their samples are late, m/s."""
        late = self.delay(delay_s)
        return late(self.left_m_s) - self.left_m_s, late(self.right_m_s) - self.right_m_s


class Delay:
    """Interpolation of a series at fractional indices (n,), by cubics (Catmull and Rom 1974).

    The derivative with respect to the index is continuous; that of a linear interpolation jumps at each sample.
    """

    def __init__(self, at: Array):
        self._before = at.astype(np.intp)
        self._share = at - self._before

    def __call__(self, values: Array) -> Array:
        held, f = np.concatenate([values[:1], values, values[-1:], values[-1:]]), self._share
        a, b, c, d = (held[i:].take(self._before) for i in range(4))
        result: Array = b + 0.5 * f * (c - a + f * (2.0 * a - 5.0 * b + 4.0 * c - d + f * (3.0 * (b - c) + d - a)))
        return result
