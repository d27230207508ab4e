"""Analysis of a gyro's log at standstill: warm-up, noise terms with intervals, bias, and the filter's noise profile."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Final

import numpy as np

from drd.config.keys import Noise
from drd.config.schema import ConfigError
from drd.units import RAD_PER_DEG, RAD_PER_S_PER_SQRT_S_PER_DEG_PER_H_PER_SQRT_H
from drd_tools.calibrate.noise.allan import FLOOR, TERMS, B, Curve, Fit, K, N, Q, allan_curve, fit, shapes
from drd_tools.calibrate.noise.intervals import SIMULATIONS, Interval, Simulator, intervals, shows_ramp
from drd_tools.calibrate.noise.static_log import SHORTEST_S, StaticLog, rounding_rad_s
from drd_tools.calibrate.noise.warmup import Slope, WarmUp, fit_warm_up, left_out_s, temperature_slope

MODEL: Final = (Q, N, B, K)
# The filter has no state for flicker: its random walk of the bias represents all slow terms. (50)
FILTER: Final = (Q, N, K)
STEPS: Final = 7
# The model misses a point if it is outside the 90 % interval and off by more than this fraction.
MISFIT: Final = 0.10


class Origin(Enum):
    """Source of the filter's rate random walk."""

    MEASURED = "measured"
    BOUND = "upper bound"
    DEFAULT = "default"


@dataclass(frozen=True)
class FilterNoise:
    """Figures for the configuration's noise profile, SI; `random_walk` is the interval of the fit without flicker."""

    angle_random_walk: float
    rate_random_walk: float
    origin: Origin
    random_walk: Interval


@dataclass(frozen=True)
class GyroNoise:
    """All results, SI. `log` is the part of `whole` that was analysed."""

    whole: StaticLog
    log: StaticLog
    skipped_by_user: bool
    warm_up: WarmUp | None
    slope: Slope | None
    instability_rad_s: float  # the model's lowest Allan deviation / 0.664: B if visible, otherwise a bound on it
    curve: Curve
    fit: Fit
    has_ramp: bool
    intervals: dict[int, Interval]
    filter: FilterNoise
    bias_rad_s: float
    bias_sigma_rad_s: float
    start_sigma_rad_s: float

    @property
    def left_out_s(self) -> float:
        """Time left out at the log's start, s."""
        return self.log.begins_s - self.whole.begins_s

    @property
    def wait_s(self) -> float:
        """Time after power-on from which the bias drifts by less than the instability in 10 minutes."""
        return 0.0 if self.warm_up is None else self.warm_up.wait_s(self.instability_rad_s)

    def misfit(self) -> tuple[float, float] | None:
        """Averaging time (s) and ratio of measured to modelled deviation at the model's worst miss, or None."""
        model = np.sqrt(self.fit.variance)
        outside = (model < self.curve.low) | (model > self.curve.high)
        ratio = self.curve.deviation / model
        miss = np.where(outside, np.abs(np.log(np.maximum(ratio, 1e-9))), 0.0)
        worst = int(np.argmax(miss))
        return (float(self.curve.tau_s[worst]), float(ratio[worst])) if miss[worst] > MISFIT else None


def analyse(
    whole: StaticLog,
    skip_s: float | None = None,
    simulations: int = SIMULATIONS,
    on_step: Callable[[], object] = lambda: None,
) -> GyroNoise:
    """Analyse a log. `skip_s`: leave out these seconds instead of the fitted warm-up. `on_step` is called STEPS times.

    Raises ConfigError if less than 100 s are left.
    """
    warm_up = fit_warm_up(whole)
    left_s = skip_s if skip_s is not None else _warm_up_left_out_s(whole, warm_up)
    log = whole.after(left_s)
    if log.duration_s < SHORTEST_S:
        got = f"{log.duration_s:.4g} s after the first {left_s:.4g} s are left out"
        raise ConfigError(whole.file, "", f"at least {SHORTEST_S:g} s", got)
    curve = allan_curve(log.rate_rad_s, log.interval_s)
    simulator = Simulator(curve, simulations)
    on_step()
    shape, measured = shapes(curve.tau_s), curve.deviation**2
    plain = fit(shape, measured, curve.edf, MODEL)
    ramped = shows_ramp(curve, plain, simulator)
    found = ramped or plain
    made = intervals(curve, found, simulator, found.terms, on_step)
    if ramped is None:
        on_step()
    slow = fit(shape, measured, curve.edf, FILTER)
    random_walk = intervals(curve, slow, simulator, (K,), on_step)[K]
    # Mean against the bias at the log's end: N^2/T is (28), K^2 T/3 from a random walk, and flicker's floor. (49)
    sigma = math.hypot(math.sqrt(float(shapes(np.array([log.duration_s]))[0] @ found.squares)), rounding_rad_s(log))
    bias = float(log.rate_rad_s.mean())
    first = bias if warm_up is None else float(warm_up.at(np.zeros(1))[0])
    return GyroNoise(
        whole=whole,
        log=log,
        skipped_by_user=skip_s is not None,
        warm_up=warm_up,
        slope=temperature_slope(whole),
        instability_rad_s=_instability_rad_s(found),
        curve=curve,
        fit=found,
        has_ramp=ramped is not None,
        intervals=made,
        filter=filter_noise(made[N], random_walk),
        bias_rad_s=bias,
        bias_sigma_rad_s=sigma,
        start_sigma_rad_s=math.hypot(max(abs(bias), abs(first)), sigma),
    )


def _warm_up_left_out_s(log: StaticLog, warm_up: WarmUp | None) -> float:
    if warm_up is None:
        return 0.0
    curve = allan_curve(log.rate_rad_s - warm_up.at(log.time_s), log.interval_s)
    settled = fit(shapes(curve.tau_s), curve.deviation**2, curve.edf, MODEL)
    return left_out_s(warm_up, _instability_rad_s(settled), log.duration_s)


def _instability_rad_s(found: Fit) -> float:
    """Bias instability as datasheets give it: the lowest point of the curve over 0.664."""
    return math.sqrt(float(found.variance.min()) / FLOOR)


def filter_noise(angle: Interval, random_walk: Interval) -> FilterNoise:
    """Choose the configuration's noise profile. (50)

    A random walk that the log does not show is not zero: use its upper bound, unless the configuration's default
    is lower. Then the log is too short to improve on a datasheet.
    """
    default = Noise.gyro_bias_deg_h_per_sqrt_h * RAD_PER_S_PER_SQRT_S_PER_DEG_PER_H_PER_SQRT_H
    n = angle.value if angle.is_visible else angle.high
    if random_walk.is_visible:
        return FilterNoise(n, random_walk.value, Origin.MEASURED, random_walk)
    if random_walk.high < default:
        return FilterNoise(n, random_walk.high, Origin.BOUND, random_walk)
    return FilterNoise(n, default, Origin.DEFAULT, random_walk)


def unit_of(term: int) -> tuple[str, str, float, str]:
    """Name, datasheet unit, that unit in SI, and symbol of a term, for reports."""
    return (*_UNITS[term], TERMS[term])


_UNITS: Final = (
    ("angle quantisation", "deg", RAD_PER_DEG),
    ("angle random walk", "deg/sqrt(h)", RAD_PER_DEG / 60.0),
    ("bias instability", "deg/h", RAD_PER_DEG / 3600.0),
    ("rate random walk", "deg/h/sqrt(h)", RAD_PER_DEG / 3600.0 / 60.0),
    ("rate ramp", "deg/h/h", RAD_PER_DEG / 3600.0 / 3600.0),
)
