"""Lags of gyro, wheels and reference, and errors of their clocks. (79)"""

import math
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from drd_tools.calibrate.wheels.drift import (
    MOST_GROWTH,
    REFERENCE_WANDER_S,
    WHEELS_WANDER_S,
    Drift,
    find_drift,
    reference_drift,
)
from drd_tools.calibrate.wheels.lag import Lag, find_lag, reference_lag
from drd_tools.recordings.folder import Recording

SURE: Final = 3.0  # sigmas
LEAST_DRIFT, MOST_DRIFT = 3e-4, 5e-3  # s/s: natural change of lags in a run without a gyro; beyond any clock's error
REFERENCE_LAG_S: Final = 0.010  # prior sigma of a reference's delay (70)


class Lags(NamedTuple):
    """Lags of the sensors, s, relative to the earliest, and their standard deviations.

    `growth`: of the wheels' lag, s/s, which is then the one at time 0. `clock`: actual over nominal rate of the gyro's
    samples; its deviation is given even if no clock error was found.
    """

    wheels_s: float
    wheels_sigma_s: float
    growth: float
    growth_sigma: float
    reference_s: float
    reference_sigma_s: float
    gyro_s: float
    clock: float
    clock_sigma: float

    def in_time(self, recording: Recording) -> Recording:
        """The recording with the gyro's samples at the times at which they were taken."""
        return _at_true_times(recording, self.clock)


def find_lags(recording: Recording) -> Lags:
    """Measure the lags of a recording; 0 if it does not determine them."""
    has_gyro, has_wheels = recording.fog is not None, recording.wheels is not None
    against = "gyro" if has_gyro else "reference"
    drift = find_drift(recording, against) if has_wheels else None
    clock, clock_sigma = _gyro_clock(recording, drift, reference_drift(recording))
    in_time = _at_true_times(recording, clock)
    if clock != 1.0:
        drift = find_drift(in_time, against)
    lag = find_lag([in_time]) if has_wheels else None
    growth = 0.0 if drift is None or not _is_drift(drift, in_time) else drift.growth
    if lag is not None and drift is not None and growth:
        lag = replace(lag, lag_s=drift.lag_s)
    wheels_s, wheels_sigma_s = _determined(lag)
    behind_s, reference_sigma_s = _determined(reference_lag(in_time) if has_gyro else _reversed(lag))
    # Wheels that are slightly early on average may have a clock error.
    early_s = SURE * math.hypot(wheels_sigma_s, WHEELS_WANDER_S)
    wheels_s = wheels_s if wheels_s > SURE * wheels_sigma_s or wheels_s < -early_s else 0.0
    behind_s = behind_s if abs(behind_s) > SURE * math.hypot(reference_sigma_s, REFERENCE_LAG_S) else 0.0
    # No sensor reports a motion before it happens: the earliest of them is in time.
    gyro_s = -min(0.0, wheels_s, behind_s) if has_gyro else 0.0
    return Lags(
        wheels_s=max(0.0, wheels_s + gyro_s),
        wheels_sigma_s=wheels_sigma_s,
        growth=growth,
        growth_sigma=0.0 if drift is None else drift.sigma,
        reference_s=max(0.0, behind_s + gyro_s),
        reference_sigma_s=reference_sigma_s,
        gyro_s=gyro_s,
        clock=clock,
        clock_sigma=clock_sigma,
    )


def _determined(lag: Lag | None) -> tuple[float, float]:
    """A lag and its standard deviation, s; 0 if it is neither determined nor significant."""
    if lag is None or not (lag.determined or (lag.is_usual and abs(lag.lag_s) > SURE * lag.sigma_s)):
        return 0.0, 0.0
    return lag.lag_s, lag.sigma_s


def _reversed(lag: Lag | None) -> Lag | None:
    """Lag of the reference behind the wheels."""
    return None if lag is None else replace(lag, lag_s=-lag.lag_s)


def _gyro_clock(recording: Recording, wheels: Drift | None, reference: Drift | None) -> tuple[float, float]:
    """Rate of the gyro's clock and its deviation, if wheels and reference both drift from it: more likely one clock is
    wrong than two.
    """
    if wheels is None or reference is None or not (wheels.begins_usual and reference.begins_usual):
        return 1.0, 0.0
    w, r = wheels.growth, reference.growth
    w_variance = wheels.sigma**2 + (WHEELS_WANDER_S / _length_s(recording)) ** 2
    r_variance = reference.sigma**2 + (REFERENCE_WANDER_S / _length_s(recording)) ** 2
    squares = (w - r) ** 2 / (w_variance + r_variance)
    of_none = w**2 / w_variance + r**2 / r_variance
    of_reference = w**2 / w_variance + _beyond(r) ** 2 / r_variance
    of_wheels = r**2 / r_variance + _beyond(w) ** 2 / w_variance
    variance = 1.0 / (1.0 / w_variance + 1.0 / r_variance)
    # The range of a gyro's clock error is wider, so that each value has a lower prior density.
    wider = 2.0 * math.log(MOST_GROWTH / MOST_DRIFT)
    if squares > min(of_reference - wider, of_wheels - wider, of_none - SURE**2):
        return 1.0, math.sqrt(variance)
    # A sample taken at t is stamped t ratio: relative to it, all else is late by t (1 - ratio).
    return 1.0 - variance * (w / w_variance + r / r_variance), math.sqrt(variance)


def _beyond(growth: float) -> float:
    """Growth of a lag beyond the largest clock error of wheels or reference."""
    return max(0.0, abs(growth) - MOST_DRIFT)


def _at_true_times(recording: Recording, clock: float) -> Recording:
    fog = recording.fog
    return recording if fog is None else replace(recording, fog=replace(fog, time_s=fog.time_s / clock))


def _is_drift(drift: Drift, recording: Recording) -> bool:
    """Whether the lag grows by more than lags naturally change in a drive, and by less than a clock's largest error."""
    least = LEAST_DRIFT if recording.fog is None else SURE * WHEELS_WANDER_S / _length_s(recording)
    return abs(drift.growth) > SURE * drift.sigma and least < abs(drift.growth) < MOST_DRIFT


def _length_s(recording: Recording) -> float:
    return float(np.ptp(recording.encoders.time_s))
