"""Both sensors' motion in common time windows, and the delay between the sensors."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from drd.arrays import Array
from drd.samples import GyroSample, WheelSample
from drd.units import RAD_PER_DEG, S_PER_NS

WINDOW_S: Final = 2.0
# Missing time between two samples, in intervals, above which it is a hole: stamps jitter.
HOLE: Final = 0.5
# Over shorter holes the motion is interpolated, since the robot's speed hardly changes in them.
BRIDGED_S: Final = 0.25
# The largest bias that a standstill may show; more is not a gyro's bias, but a robot that turns.
MAX_BIAS_RAD_S: Final = 1.0 * RAD_PER_DEG
# Rates for finding the lag are means over RATE_S, every GRID_S.
GRID_S: Final = 0.1
RATE_S: Final = 0.2
LARGEST_LAG_S: Final = 1.0
# The lag is observable only if starts and ends of turns show in the rates.
LAG_CORRELATION: Final = 0.7
LAG_WINDOWS: Final = 5
LAG_SIGMA_S: Final = 0.05
# Shifts more than this many grid steps away must fit worse by this likelihood ratio.
ELSEWHERE: Final = 2
ELSEWHERE_SIGMAS: Final = 3.0


@dataclass(frozen=True)
class Curve:
    """Cumulative motion: knots, shape (n,), sums of m quantities, (n, m), and holes before each knot, (n,).

    `unseen_s`: time before each knot, (n,), in holes of more than BRIDGED_S, which the sums do not include.
    """

    time_s: Array
    sums: Array
    holes: Array
    unseen_s: Array

    def between(self, edges_s: Array) -> tuple[Array, npt.NDArray[np.bool_]]:
        """Motion from each edge to the next, shape (k - 1, m), and whether all of it was seen, shape (k - 1,)."""
        at = np.column_stack([np.interp(edges_s, self.time_s, column) for column in self.sums.T])
        unseen_s = np.interp(edges_s, self.time_s, self.unseen_s)
        return np.diff(at, axis=0), np.diff(unseen_s) == 0.0


@dataclass(frozen=True)
class Windows:
    """Motion in windows in which all was seen, shape (n,) each; `gyro_rad` is free of the bias seen at standstill."""

    gyro_rad: Array
    left_m: Array
    right_m: Array


@dataclass(frozen=True)
class Lag:
    """Delay of the gyro behind the wheels (negative: ahead), s."""

    lag_s: float
    sigma_s: float


def gyro_curve(samples: Sequence[GyroSample], zero_ns: int) -> Curve:
    """Turned angle over time since `zero_ns`; there must be a sample."""
    t_ns, interval_s, rate_rad_s, _ = zip(*samples, strict=True)
    span_s = np.array(interval_s)
    return _curve(t_ns, zero_ns, span_s, np.array(rate_rad_s)[:, None] * span_s[:, None])


def wheel_curve(samples: Sequence[WheelSample], zero_ns: int) -> Curve:
    """Travel of the left and of the right wheel over time since `zero_ns`; there must be a sample."""
    t_ns, interval_s, left_m, right_m, *_ = zip(*samples, strict=True)
    return _curve(t_ns, zero_ns, np.array(interval_s), np.column_stack([left_m, right_m]))


def _curve(t_ns: Any, zero_ns: int, span_s: Array, steps: Array) -> Curve:
    end_s = (np.array(t_ns, dtype=np.int64) - zero_ns) * S_PER_NS
    begin_s = end_s - span_s
    apart_s = np.append(0.0, begin_s[1:] - end_s[:-1])
    # Samples that follow a hole; the first sample counts, but nothing is missing before it.
    first = np.append(0, np.flatnonzero(apart_s > HOLE * span_s))
    hole_s = apart_s[first]
    short_s = np.where(hole_s <= BRIDGED_S, hole_s, 0.0)
    # Frames delivered in a bunch each contain a whole period's travel, in no time.
    around_s = np.maximum(span_s[first - 1] + span_s[first], 2.0 * np.median(span_s))
    bridged = (steps[first - 1] + steps[first]) * (short_s / around_s)[:, None]
    none = np.zeros(len(end_s))
    return Curve(
        np.insert(end_s, first, begin_s[first]),
        np.cumsum(np.insert(steps, first, bridged, axis=0), axis=0),
        np.cumsum(np.insert(none, first, 1.0)),
        np.cumsum(np.insert(none, first, hole_s - short_s)),
    )


def travels(wheels: Curve) -> Array:
    """Travel of both wheels, (k, 2), in windows of WINDOW_S or a little more, excluding holes."""
    begin_s, end_s = wheels.time_s[[0, -1]]
    count = max(1, int((end_s - begin_s) / WINDOW_S))
    return wheels.between(np.linspace(begin_s, end_s, count + 1))[0]


def unseen_m(wheels: Curve) -> float:
    """The most that the robot may have driven unseen: at its highest speed for all that time."""
    grid_s = np.arange(wheels.time_s[0], wheels.time_s[-1], RATE_S)
    moved_m, _ = wheels.between(grid_s)
    return float(wheels.unseen_s[-1] * np.abs(moved_m.mean(axis=1)).max(initial=0.0) / RATE_S)


def common_windows(gyro: Curve | None, wheels: Curve, still_m: float, lag_s: float = 0.0) -> Windows:
    """Divide the common time into equal windows of WINDOW_S or a little more, so that nothing is left over; the gyro's
    times are taken `lag_s` earlier.  # (42)

    The bias is the median rate where neither wheel moved by more than `still_m`. Without a gyro its angles are 0.
    """
    begin_s, end_s = wheels.time_s[0], wheels.time_s[-1]
    if gyro is not None:
        begin_s, end_s = max(begin_s, gyro.time_s[0] - lag_s), min(end_s, gyro.time_s[-1] - lag_s)
    count = int((end_s - begin_s + 1e-9) / WINDOW_S)
    if count < 1:
        return Windows(*np.zeros((3, 0)))
    edges_s = np.linspace(begin_s, end_s, count + 1)
    travel_m, seen = wheels.between(edges_s)
    if gyro is None:
        return Windows(np.zeros(int(seen.sum())), *travel_m[seen].T)
    turned, gyro_seen = gyro.between(edges_s + lag_s)
    seen &= gyro_seen
    gyro_rad, travel_m = turned[seen, 0], travel_m[seen]
    still = np.abs(travel_m).max(axis=1) <= still_m if len(travel_m) else np.zeros(0, dtype=bool)
    if still.any():
        bias_rad = float(np.median(gyro_rad[still]))
        if abs(bias_rad) <= MAX_BIAS_RAD_S * WINDOW_S:
            gyro_rad = gyro_rad - bias_rad
    return Windows(gyro_rad, *travel_m.T)


def lag(gyro: Curve, wheels: Curve, left: float, right: float) -> Lag | None:
    """The gyro's lag behind `left` times left plus `right` times right travel; None if it is not observable.  # (45)

    The shift with the largest correlation of the two rates, refined by a parabola.
    """
    begin_s = max(gyro.time_s[0], wheels.time_s[0]) + LARGEST_LAG_S
    end_s = min(gyro.time_s[-1], wheels.time_s[-1]) - LARGEST_LAG_S - RATE_S
    grid_s = np.arange(begin_s, end_s, GRID_S)
    if len(grid_s) < LAG_WINDOWS * WINDOW_S / GRID_S:
        return None
    seen = np.ones(len(grid_s), dtype=bool)

    def rate(curve: Curve, sums: Array, shift_s: float) -> Array:
        nonlocal seen
        ends = [np.interp(grid_s + shift_s + d, curve.time_s, sums) for d in (0.0, RATE_S)]
        holes = [np.interp(grid_s + shift_s + d, curve.time_s, curve.holes) for d in (0.0, RATE_S)]
        seen = seen & (holes[0] == holes[1])
        return np.asarray((ends[1] - ends[0]) / RATE_S, dtype=np.float64)

    shifts_s = np.arange(-LARGEST_LAG_S, LARGEST_LAG_S + GRID_S / 2.0, GRID_S)
    wheel_rate = rate(wheels, wheels.sums @ np.array([left, right]), 0.0)
    rates = np.array([rate(gyro, gyro.sums[:, 0], float(shift_s)) for shift_s in shifts_s])
    # Computed before holes are removed: a turn that begins in one must not count as slope.
    slope = np.gradient(wheel_rate, GRID_S)[seen]
    wheel_rate, rates = wheel_rate[seen], rates[:, seen]
    if wheel_rate.size < 2 or min(np.ptp(wheel_rate), np.ptp(rates, axis=1).min()) == 0.0:
        return None
    correlation = np.abs([np.corrcoef(wheel_rate, shifted)[0, 1] for shifted in rates])
    k = int(correlation.argmax())
    if k in (0, len(correlation) - 1) or correlation[k] < LAG_CORRELATION:
        return None
    # Errors from unequal wheels and slip last for seconds: only windows count as independent.
    count = wheel_rate.size * GRID_S / WINDOW_S
    # If a turn begins in a hole, many shifts fit equally well.
    unfit = count * np.log((1.0 - correlation**2 + 1e-12) / (1.0 - correlation[k] ** 2 + 1e-12))
    if (unfit[np.abs(np.arange(len(unfit)) - k) > ELSEWHERE] < ELSEWHERE_SIGMAS**2).any():
        return None
    bend = correlation[k - 1] - 2.0 * correlation[k] + correlation[k + 1]
    part = 0.5 * (correlation[k - 1] - correlation[k + 1]) / bend if bend < 0.0 else 0.0
    residual = wheel_rate.std() * np.sqrt(1.0 - correlation[k] ** 2)
    sigma_s = float(residual / (slope.std() * np.sqrt(count))) + 1e-3
    return Lag(float(shifts_s[k] + part * GRID_S), sigma_s) if sigma_s <= LAG_SIGMA_S else None
