"""Checks of imported data for the usual pitfalls; each finding states its evidence in numbers.

Wheels, reference and gyro are compared as yaw rates. If two disagree, one of them is wrong; only a third can show
which: the reference, or gravity as measured by the accelerometer, which shows the gyro's true axis.
"""

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from drd.arrays import Array
from drd.units import DEG_PER_RAD
from drd_tools.importing.matching import Match

OK: Final = "ok"
WRONG: Final = "wrong"
UNKNOWN: Final = "cannot be determined"
# Largest ratio of a gain to a known factor: a skid-steer robot's tread alone accounts for up to 1.9.
SPREAD: Final = 2.5
FACTORS: Final = {
    1.0: "",
    DEG_PER_RAD: "degrees were taken for radians",
    1.0 / DEG_PER_RAD: "radians were taken for degrees",
}
STANDARD_GRAVITY_M_S2: Final = 9.80665
# Full scale of the fastest gyro that drd reads (DSP-1750); no wheeled robot turns so fast.
FASTEST_DEG_S: Final = 1000.0
# Shorter delays are within the accuracy of the sensors' time stamps.
LEAST_OFFSET_S: Final = 0.01
# Smallest mean specific force along the vertical axis, as a fraction of gravity (cos 25 deg).
UPRIGHT: Final = 0.9


@dataclass(frozen=True)
class Finding:
    """Result of one check. `proposal`: the options that would correct the fault, with their values."""

    check: str
    verdict: str
    text: str
    numbers: dict[str, float] = field(default_factory=dict)
    proposal: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Gravity:
    """The vertical according to the accelerometer: axis, its sign (+1: the axis points up), tilt and force."""

    axis: int
    sign: int
    tilt_rad: float
    force_m_s2: float


def gravity(acceleration_m_s2: Array | None) -> Gravity | None:
    """Find the vertical from the mean specific force, shape (n, 3); None if it is missing or not gravity."""
    if acceleration_m_s2 is None or not len(acceleration_m_s2):
        return None
    mean = acceleration_m_s2.mean(axis=0)
    force = float(np.linalg.norm(mean))
    if not 0.8 < force / STANDARD_GRAVITY_M_S2 < 1.2:
        return None
    axis = int(np.argmax(np.abs(mean)))
    upright = abs(float(mean[axis])) / force
    if upright < UPRIGHT:
        return None
    return Gravity(axis, 1 if mean[axis] > 0.0 else -1, math.acos(min(1.0, upright)), force)


def find_axis(matches: list[Match | None], names: tuple[str, ...], other: str, felt: Gravity | None) -> Finding:
    """Find the gyro's vertical axis, by its correlation with `other`'s turning and by gravity.

    `matches`: of each axis with `other`; all None if there is nothing to compare with.
    """
    numbers = {f"correlation_{n}": m.correlation for n, m in zip(names, matches, strict=True) if m is not None}
    strength = np.array([abs(m.correlation) if m is not None else 0.0 for m in matches])
    best = int(np.argmax(strength))
    chosen, told = matches[best], _list(names, [m.correlation if m is not None else math.nan for m in matches])
    rest = np.delete(strength, best)
    if chosen is not None and chosen.is_clear and (not len(rest) or strength[best] - rest.max() > 0.2):
        text = f"the vertical axis is {names[best]}: correlation with the {other} {told}"
        if felt is not None:
            numbers |= {"gravity_axis": float(felt.axis), "tilt_deg": felt.tilt_rad * DEG_PER_RAD}
            if felt.axis != best:
                text = (
                    f"the {other} say the vertical axis is {names[best]} (correlation {told}), gravity says "
                    f"{names[felt.axis]}: check both by hand"
                )
                return Finding("axis", UNKNOWN, text, numbers)
            text += f"; gravity agrees ({_felt(felt, names)})"
        return Finding("axis", OK, text, numbers, {"axis": names[best]})
    if felt is not None:
        numbers |= {"gravity_axis": float(felt.axis), "tilt_deg": felt.tilt_rad * DEG_PER_RAD}
        text = f"the vertical axis is {names[felt.axis]}, by gravity alone: {_felt(felt, names)}"
        return Finding("axis", OK, text, numbers, {"axis": names[felt.axis]})
    why = f"no axis correlates clearly with the {other} (correlation {told})" if numbers else "nothing to compare with"
    return Finding("axis", UNKNOWN, why, numbers)


def most_turning(rates_rad_s: Array, names: tuple[str, ...]) -> Finding:
    """Find the axis that turned by far the most, shape (n, 3): a hint without wheels and reference."""
    spread = rates_rad_s.std(axis=0)
    best = int(np.argmax(spread))
    numbers = {f"rms_deg_s_{n}": float(s) * DEG_PER_RAD for n, s in zip(names, spread, strict=True)}
    told = _list(names, [s * DEG_PER_RAD for s in spread])
    if spread[best] > 3.0 * float(np.delete(spread, best).max()):
        text = f"{names[best]} turned by far the most (rms deg/s {told}); nothing shows that it is the vertical one"
        return Finding("axis", UNKNOWN, text, numbers, {"axis": names[best]})
    return Finding("axis", UNKNOWN, f"no axis turned much more than the others (rms deg/s {told})", numbers)


def check_unit(found: Match | None, what: str, other: str) -> Finding:
    """Check whether a gain indicates degrees mistaken for radians, or vice versa."""
    check = f"unit, {what} against {other}"
    if found is None or not found.is_clear:
        return Finding(check, UNKNOWN, f"{what} and {other} do not go together clearly{_weak(found)}")
    # Regression of either on the other: the regressor's noise biases each result, and the truth lies between.
    low, high = abs(found.gain), abs(found.gain) / found.correlation**2
    numbers = {"gain": found.gain, "gain_sigma": found.gain_sigma, "gain_at_most": math.copysign(high, found.gain)}
    told = f"turning of {what} over {other}: {low:.4g} to {high:.4g}, by whose noise is larger"
    meaning = mistaken_unit(low, high)
    if meaning is not None:
        text = f"{meaning} in one of the two: {told}"
        return Finding(check, WRONG, text, numbers) if meaning else Finding(check, OK, told, numbers)
    text = f"{told}: neither 1 nor degrees for radians; look at wheel radius, counts per revolution, tread and units"
    return Finding(check, WRONG, text, numbers)


def mistaken_unit(low: float, high: float) -> str | None:
    """Mistake that explains a gain from low to high, "" for none; None if no unit explains it."""
    return next((m for factor, m in FACTORS.items() if low < factor * SPREAD and high > factor / SPREAD), None)


def check_peak(rate_rad_s: Array) -> Finding | None:
    """Check whether the gyro's rates, shape (n,), are too fast for a robot; None if they are not."""
    peak_deg_s = float(np.abs(rate_rad_s).max()) * DEG_PER_RAD
    if peak_deg_s <= FASTEST_DEG_S:
        return None
    text = f"the gyro reaches {peak_deg_s:.4g} deg/s, no robot does: degrees taken for radians, or a fault"
    return Finding("unit, gyro", WRONG, text, {"peak_deg_s": peak_deg_s})


def check_speed(time_s: Array, left_m: Array, right_m: Array, limit_m_s: float) -> Finding | None:
    """Check whether a wheel is too fast for a replay; None if not. Travels are since the start, shape (n,)."""
    step_s = np.diff(time_s)
    # As in a replay: rows written in bursts may contain a whole period's travel each.
    step_s = np.maximum(step_s, np.median(step_s))
    speed_m_s = np.maximum(np.abs(np.diff(left_m)), np.abs(np.diff(right_m))) / step_s
    fast = int((speed_m_s > limit_m_s).sum())
    if not fast:
        return None
    text = (
        f"in {fast} of {len(speed_m_s)} rows a wheel is faster than {limit_m_s:g} m/s (fastest {speed_m_s.max():.4g}): "
        "counters that start again (--modulus) or jumped, a wrong unit, wheel radius or counts per revolution; a "
        "replay leaves them out, unless its --config says a higher robot.max_speed_m_s"
    )
    return Finding("speed", WRONG, text, {"rows": float(fast), "fastest_m_s": float(speed_m_s.max())})


def check_offset(found: Match | None, what: str, other: str, option: str) -> Finding:
    """Check how much `what` lags behind `other`; `option` shifts the stamps of `what`."""
    check = f"clock, {what} against {other}"
    if found is None or not found.is_clear:
        return Finding(check, UNKNOWN, f"{what} and {other} do not go together clearly{_weak(found)}")
    numbers = {"lag_s": found.lag_s, "lag_sigma_s": found.lag_sigma_s}
    told = f"{abs(found.lag_s):.3f} +- {found.lag_sigma_s:.3f} s"
    if abs(found.lag_s) <= max(3.0 * found.lag_sigma_s, LEAST_OFFSET_S):
        return Finding(check, OK, f"no delay beyond its uncertainty ({found.lag_s:+.3f} +- {found.lag_sigma_s:.3f} s)",
                       numbers)  # fmt: skip
    later = "later" if found.lag_s > 0.0 else "earlier"
    text = f"the motion is {told} {later} in {what} than in {other} (a clock offset, or a delay of one of them)"
    return Finding(check, WRONG, text, numbers, {option: f"{-found.lag_s:.4f}"})


def _felt(felt: Gravity, names: tuple[str, ...]) -> str:
    up = "up" if felt.sign > 0 else "down"
    return (
        f"{felt.force_m_s2:.2f} m/s2, +{names[felt.axis]} points {up}, "
        f"{felt.tilt_rad * DEG_PER_RAD:.1f} deg off the mean force"
    )


def _list(names: tuple[str, ...], values: list[float]) -> str:
    return ", ".join(f"{name} {value:.3g}" for name, value in zip(names, values, strict=True))


def _weak(found: Match | None) -> str:
    if found is None:
        return ": too short a common time, or one of them does not turn at a changing rate"
    if found.at_edge:
        return f": the best delay ({found.lag_s:.2f} s) is at the limit of those tried (--max-lag)"
    return f" (correlation {found.correlation:.2f} +- {found.correlation_sigma:.2f})"
