"""Text on the gyro's noise: table and sentences for terminal and page, and the configuration's snippet."""

import math
from datetime import UTC, datetime
from typing import Final

import numpy as np

from drd import __version__
from drd.units import (
    DEG_PER_RAD,
    RAD_PER_S_PER_SQRT_S_PER_DEG_PER_H_PER_SQRT_H,
    RAD_PER_SQRT_S_PER_DEG_PER_SQRT_H,
    S_PER_H,
)
from drd_tools.calibrate.noise.allan import B, K, N, R
from drd_tools.calibrate.noise.analysis import GyroNoise, Origin, unit_of
from drd_tools.calibrate.noise.intervals import Interval

DEG_H: Final = DEG_PER_RAD * S_PER_H
HEADER: Final = ("term", "", "value", "90 % interval", "unit")
# Robots' gyros have 0.01 to 0.1 deg/sqrt(h); a much smaller value is more likely a wrong unit.
BEST_DEG_PER_SQRT_H: Final = 0.003
COARSE_PART: Final = 0.1


def rows(result: GyroNoise) -> list[tuple[str, str, str, str, str]]:
    """One row for each term of the model; see HEADER."""
    made = []
    for term in result.fit.terms:
        name, unit, si, symbol = unit_of(term)
        interval = result.intervals[term]
        if interval.is_visible:
            value = f"{interval.value / si:.3g}"
            limits = f"{interval.low / si:.3g} to {interval.high / si:.3g}"
        else:
            value, limits = "not visible", f"at most {interval.high / si:.3g}"
        made.append((name, symbol, value, limits, unit))
    return made


def sentences(result: GyroNoise) -> list[str]:
    """Sentences that the user should know, most important first."""
    log = result.log
    said = [
        f"{len(log.rate_rad_s)} samples, {duration(log.duration_s)} at {1.0 / log.interval_s:.4g} Hz, were analysed.",
        *result.whole.notes,
        _left_out(result),
        _filtered(result),
        *_warm_up(result),
        f"Bias: {result.bias_rad_s * DEG_H:.2f} deg/h, known to {_two(result.bias_sigma_rad_s * DEG_H)} deg/h; it "
        "includes the vertical part of the Earth's rate, 15.04 deg/h times the sine of the latitude.",
        *_not_visible(result),
        *_doubts(result),
        random_walk_reason(result),
    ]
    return [sentence for sentence in said if sentence]


def _left_out(result: GyroNoise) -> str:
    if not result.left_out_s:
        return ""
    why = "as requested with --skip" if result.skipped_by_user else "as warm-up"
    return f"The first {duration(result.left_out_s)} were left out, {why}."


def _filtered(result: GyroNoise) -> str:
    if result.curve.factors[0] == 1:
        return ""
    return (
        f"Averaging times below {duration(float(result.curve.tau_s[0]))} were left out: neighbouring readings are "
        "correlated, as by a filter in the gyro, and would show too little angle random walk."
    )


def _warm_up(result: GyroNoise) -> list[str]:
    warm_up, slope, said = result.warm_up, result.slope, []
    if warm_up is None:
        said.append("No warm-up is visible: the log did not begin at power-on, or noise hides it.")
    else:
        said.append(
            f"Warm-up: the bias began {warm_up.change_rad_s * DEG_H:+.3g} deg/h off and settled with a time constant "
            f"of {duration(warm_up.time_constant_s)}. Wait {duration(result.wait_s)} after the log's start: from then "
            f"on it drifts by less than the bias instability ({_two(result.instability_rad_s * DEG_H)} deg/h) in 10 "
            "minutes."
        )
        if result.wait_s > result.whole.duration_s:
            said.append("That is longer than the log, so the time is extrapolated from the fit: record a longer one.")
    if slope is not None:
        low, high = slope.range_c
        said.append(
            f"From {low:.1f} to {high:.1f} degC the bias changed with the temperature by "
            f"{slope.rad_s_per_c * DEG_H:+.3g} deg/h per degC (standard error {_two(slope.sigma_rad_s_per_c * DEG_H)}, "
            f"correlation {slope.correlation:+.2f}). In a warm-up, one log cannot separate temperature from time."
        )
    elif result.whole.temperature_c is None:
        said.append("The log has no temperature.")
    return said


def _not_visible(result: GyroNoise) -> list[str]:
    """Sentence for each term that the log is too short or too noisy to show."""
    length = duration(result.log.duration_s)
    return [
        f"{name.capitalize()} is not visible in {length}: at most {_two(result.intervals[term].high / si)} {unit}."
        for term in (N, B, K)
        for name, unit, si, _ in [unit_of(term)]
        if not result.intervals[term].is_visible
    ]


def _doubts(result: GyroNoise) -> list[str]:
    said = []
    if result.has_ramp:
        _, unit, si, _ = unit_of(R)
        said.append(
            f"The bias drifts steadily, by about {result.intervals[R].value / si:.2g} {unit}: still warm-up, or a "
            "change of temperature. Leave out more with --skip, or record longer."
        )
    if (miss := result.misfit()) is not None:
        tau_s, ratio = miss
        said.append(
            f"The model misses the curve: at {tau_s:.3g} s the measured deviation is {ratio:.2g} times the model's. "
            "Vibration, a filter in the gyro or a periodic disturbance causes that; see the figure."
        )
    same = float(np.mean(np.diff(result.log.rate_rad_s) == 0.0))
    if same > 1.0 - COARSE_PART:
        said.append(
            f"{same:.0%} of the readings repeat the previous one: the numbers are too coarse for the noise, and the "
            "angle random walk is doubtful."
        )
    if result.filter.angle_random_walk / RAD_PER_SQRT_S_PER_DEG_PER_SQRT_H < BEST_DEG_PER_SQRT_H:
        said.append("Only navigation-grade gyros have so little noise: is the rate in rad/s, or filtered?")
    return said


def random_walk_reason(result: GyroNoise) -> str:
    """Sentence on why the configuration gets this rate random walk."""
    chosen, unit = result.filter, RAD_PER_S_PER_SQRT_S_PER_DEG_PER_H_PER_SQRT_H
    walk = chosen.random_walk
    start = f"Rate random walk for the filter: {chosen.rate_random_walk / unit:.3g} deg/h/sqrt(h), "
    if chosen.origin is Origin.MEASURED:
        return (
            f"{start}fitted without flicker (90 % interval {walk.low / unit:.3g} to {walk.high / unit:.3g}): the "
            f"filter has no state for flicker, so its random walk represents all slow terms.{_excess(result)}"
        )
    if chosen.origin is Origin.BOUND:
        return f"{start}an upper bound: the log shows none, and 0 would make the filter overconfident of the bias."
    return (
        f"{start}the default: the log only shows that it is below {walk.high / unit:.3g}, so it is too short. Use "
        "the datasheet's figure if there is one."
    )


def _excess(result: GyroNoise) -> str:
    """Sentence on how far the filter's profile exceeds the model at long averaging times, if by much."""
    n, k, tau_s = result.filter.angle_random_walk, result.filter.rate_random_walk, result.curve.tau_s[-1]
    ratio = math.sqrt((n**2 / tau_s + k**2 * tau_s / 3.0) / float(result.fit.variance[-1]))  # (49)
    return f" At {duration(tau_s)} that is {ratio:.2g} times the measured value: conservative." if ratio > 2 else ""


def snippet(result: GyroNoise) -> str:
    """The configuration's lines, with their uncertainty and provenance as comments."""
    n, si = result.intervals[N], RAD_PER_SQRT_S_PER_DEG_PER_SQRT_H
    k_si = RAD_PER_S_PER_SQRT_S_PER_DEG_PER_H_PER_SQRT_H
    walk = result.filter.random_walk
    k_comment = {
        Origin.MEASURED: f"represents flicker too; {_interval_text(walk, k_si)}",
        Origin.BOUND: "upper bound (95 %): not visible in this log",
        Origin.DEFAULT: f"the default; this log only shows: at most {_plain(walk.high / k_si)}",
    }[result.filter.origin]
    when = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    log, bias = result.log, result.bias_rad_s * DEG_PER_RAD
    file = "".join(c if c.isprintable() else "?" for c in result.whole.file)
    return f"""\
# Gyro noise for drd's configuration, to be merged into it.
# Made by `drd calibrate noise` of drd {__version__} on {when}.
# Log: {file}
# sha256: {result.whole.sha256}
# Used: {log.duration_s:.1f} s at {1.0 / log.interval_s:.6g} Hz, from time_s {log.begins_s:.1f} on.
estimation:
  noise:
    # Angle random walk; {_interval_text(n, si)}.
    gyro_deg_per_sqrt_h: {_plain(result.filter.angle_random_walk / si)}
    # Rate random walk; {k_comment}.
    gyro_bias_deg_h_per_sqrt_h: {_plain(result.filter.rate_random_walk / k_si)}
    # gyro_bias_repeatability_deg_s: not determined by one log; it is the scatter of the bias over several power-ons.
  initial:
    # Standard deviation of the bias if no standstill was measured; it includes the Earth's rate.
    # Bias in this log {bias:+.6f} deg/s, known to {_two(result.bias_sigma_rad_s * DEG_PER_RAD)}{_first(result)}.
    gyro_bias_deg_s: {_plain(result.start_sigma_rad_s * DEG_PER_RAD)}
"""


def _first(result: GyroNoise) -> str:
    if result.warm_up is None:
        return ""
    return f"; at the log's start {(result.warm_up.bias_rad_s + result.warm_up.change_rad_s) * DEG_PER_RAD:+.6f}"


def _interval_text(interval: Interval, si: float) -> str:
    if not interval.is_visible:
        return "upper bound (95 %): not visible in this log"
    return f"90 % interval {_plain(interval.low / si)} to {_plain(interval.high / si)}"


def _plain(value: float) -> str:
    """Format with four digits and no exponent: YAML 1.1 reads 2e-5 as text."""
    return str(np.format_float_positional(float(f"{value:.4g}"), trim="0"))


def _two(value: float) -> str:
    return f"{value:.2g}"


def duration(seconds: float) -> str:
    """Format a time for people: in s below two minutes, else in min or h."""
    if seconds < 120.0:
        return f"{seconds:.3g} s"
    return f"{seconds / 60.0:.3g} min" if seconds < 2.0 * S_PER_H else f"{seconds / S_PER_H:.3g} h"
