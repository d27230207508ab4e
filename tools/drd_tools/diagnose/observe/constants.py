"""Constants of robot and reference, from the calibrator: where a diagnosis of a robot far from robot.yaml sets out.

They are effects of the catalogue, whose parameters have the calibrator's values and deviations as a prior. (79)
"""

import math
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from drd.config.schema import ConfigError
from drd.effects.catalogue import catalogue
from drd.effects.effect import NOMINAL, Calibrated, Effect, Symptom, number
from drd_tools.calibrate.wheels.drive import Wheels, make_drive
from drd_tools.calibrate.wheels.fit import WheelFit, fit_wheels
from drd_tools.calibrate.wheels.lag import (
    REFERENCE_WANDER_S,
    WHEELS_WANDER_S,
    Drift,
    Lag,
    find_drift,
    find_lag,
    reference_drift,
    reference_lag,
)
from drd_tools.diagnose.observe.audit import Audit, audit
from drd_tools.diagnose.observe.conventions import check_conventions
from drd_tools.diagnose.observe.evidence import check_comparable, gather
from drd_tools.diagnose.observe.grids import DENSE_S
from drd_tools.diagnose.observe.stops import Tread, repaired
from drd_tools.diagnose.selected import Selected
from drd_tools.recordings.folder import Recording

SURE, SURELY = 3.0, 5.0  # sigmas; of a drift, of which few blocks tell
LEAST_DRIFT, MOST_DRIFT = 3e-4, 5e-3  # s/s: real drives' lags change by the first in a run; no clock is so far off
# Their deviations are in the prior: a tread of 0.8 +- 0.06 sets out better than the nominal one does.
NO_LIMIT: Final = np.full(3, np.inf)
MOST_UNEQUAL: Final = 1.5  # radii: what a calibration makes of a counter that stopped in a drive of 30 cm
WIDER: Final = 3.0  # than its sigma a constant may be off where the calibrator takes an effect for it
REFERENCE_LAG_S: Final = 0.010  # prior sigma of a reference's delay, `nuisances`


@dataclass(frozen=True)
class Constants:
    """The recording with its reference's stamps put right by `lag_s`, the robot's constants, and their deviations."""

    recording: Recording
    robot: Calibrated = NOMINAL
    sigma: Calibrated = NOMINAL
    lag_s: float = 0.0
    lag_sigma_s: float = 0.0

    @property
    def selection(self) -> tuple[Selected, ...]:
        """Effects of the catalogue with these constants."""
        found = []
        for effect in catalogue().values():
            values = effect.calibrated(self.robot)
            if values is None or effect.is_neutral(values):
                continue
            prior = {name: (float(value), self._sigma(effect, name)) for name, value in values.items()}
            if any(abs(mean) > sigma for mean, sigma in prior.values()):  # else it is as robot.yaml has it
                found.append(Selected(effect, values, tuple(values), prior=prior))
        return tuple(found)

    def _sigma(self, effect: Effect, name: str) -> float:
        """Deviation of a parameter: of all constants that it is made of."""
        at = number(effect.calibrated(self.robot) or {}, name)
        square = 0.0
        for constant, sigma in self.sigma._asdict().items():
            moved = self.robot._replace(**{constant: getattr(self.robot, constant) + sigma})
            square += (number(effect.calibrated(moved) or {}, name) - at) ** 2
        return WIDER * math.sqrt(square)


def constants(recording: Recording) -> Constants:
    """Measure the constants; without a dense reference, or where nothing is determined, they are those believed."""
    reference = recording.reference
    if recording.wheels is None or reference is None or len(reference.time_s) < 3:
        return Constants(recording)
    if float(np.median(np.diff(reference.time_s))) > DENSE_S:
        return Constants(recording)
    clock = _gyro_clock(recording)
    in_time = _at_true_times(recording, clock)
    try:
        drive = make_drive(in_time)
    except ConfigError:  # hardly moves
        return Constants(recording)
    fit, lag, growth = fit_wheels([drive], limit=NO_LIMIT), find_lag([in_time]), 0.0
    drift = None if lag is None else find_drift(in_time, lag.against)
    if lag is not None and drift is not None and _is_drift(drift, in_time):
        lag, growth = replace(lag, lag_s=drift.lag_s), drift.growth
    wheels_s, wheels_sigma_s = (lag.lag_s, lag.sigma_s) if lag is not None and lag.determined else (0.0, 0.0)
    late = reference_lag(in_time) if recording.fog is not None else _reversed(lag)
    by_s, lag_sigma_s = (late.lag_s, late.sigma_s) if late is not None and late.determined else (0.0, 0.0)
    # Wheels that are a little early on the whole may have a clock that runs off.
    early_s = SURE * math.hypot(wheels_sigma_s, WHEELS_WANDER_S)
    wheels_s = wheels_s if wheels_s > SURE * wheels_sigma_s or wheels_s < -early_s else 0.0
    by_s = by_s if abs(by_s) > SURE * math.hypot(lag_sigma_s, REFERENCE_LAG_S) else 0.0
    # No sensor tells a motion before it is: the earliest of them is in time.
    gyro_s = -min(0.0, wheels_s, by_s) if recording.fog is not None else 0.0
    lag_s = max(0.0, by_s + gyro_s)
    robot, sigma = _geometry(fit, drive.nominal)
    robot = robot._replace(
        wheels_lag_s=max(0.0, wheels_s + gyro_s),
        lag_growth=growth,
        by_gyro=lag_s > 0.0 and recording.fog is not None,
        gyro_lag_s=gyro_s,
        gyro_clock=clock.ratio,
    )
    growth_sigma = 0.0 if drift is None else drift.sigma
    sigma = sigma._replace(
        wheels_lag_s=wheels_sigma_s, lag_growth=growth_sigma, gyro_lag_s=wheels_sigma_s, gyro_clock=clock.sigma
    )
    put_right = replace(reference, time_s=reference.time_s - lag_s)
    return Constants(replace(recording, reference=put_right), robot, sigma, lag_s, lag_sigma_s)


def _length_s(recording: Recording) -> float:
    return float(np.ptp(recording.encoders.time_s))


class _Clock(NamedTuple):
    """Actual over nominal rate of the gyro's samples, and its standard deviation."""

    ratio: float = 1.0
    sigma: float = 0.0


def _gyro_clock(recording: Recording) -> _Clock:
    """The gyro's clock, where wheels and reference both run away from it: rather it than both of them. (79)"""
    wheels, reference = find_drift(recording, "gyro"), reference_drift(recording)
    if wheels is None or reference is None:
        return _Clock()
    w, r = wheels.growth, reference.growth
    w_variance = wheels.sigma**2 + (WHEELS_WANDER_S / _length_s(recording)) ** 2
    r_variance = reference.sigma**2 + (REFERENCE_WANDER_S / _length_s(recording)) ** 2
    squares_of_one = w**2 / w_variance, r**2 / r_variance  # where it is the other's
    squares = (w - r) ** 2 / (w_variance + r_variance)
    if squares > min(*squares_of_one, sum(squares_of_one) - SURELY**2):
        return _Clock()
    variance = 1.0 / (1.0 / w_variance + 1.0 / r_variance)
    # What is at t is stamped t ratio: all else is later by the rest of t.
    return _Clock(1.0 - variance * (w / w_variance + r / r_variance), math.sqrt(variance))


def _at_true_times(recording: Recording, clock: _Clock) -> Recording:
    """The recording with the gyro's samples at the times at which they were taken."""
    fog = recording.fog
    return recording if fog is None else replace(recording, fog=replace(fog, time_s=fog.time_s / clock.ratio))


def _geometry(fit: WheelFit, nominal: Wheels) -> tuple[Calibrated, Calibrated]:
    """Radii and tread over the nominal ones, and their deviations; robot.yaml's, where no robot has such wheels."""
    left, right, tread = (float(a / b) for a, b in zip(fit.wheels, nominal, strict=True))
    if min(left, right) <= 0.0 or max(left / right, right / left) > MOST_UNEQUAL:
        return NOMINAL, Calibrated(0.0, 0.0, 0.0)
    of_left, of_right, of_tread = fit.sigma
    return Calibrated(left, right, tread), Calibrated(of_left * left, of_right * right, of_tread * tread)


def _is_drift(drift: Drift, recording: Recording) -> bool:
    """Whether the lag grows by more than a drive's own changes of it, and by no more than a clock's may."""
    least = LEAST_DRIFT if recording.fog is None else SURE * WHEELS_WANDER_S / _length_s(recording)
    return abs(drift.growth) > SURELY * drift.sigma and least < abs(drift.growth) < MOST_DRIFT


def _reversed(lag: Lag | None) -> Lag | None:
    """How late the reference is against the wheels."""
    return None if lag is None else replace(lag, lag_s=-lag.lag_s)


def observe(recording: Recording, measured: Constants | None = None) -> tuple[Constants, Audit]:
    """Constants and events of a recording: where a counter stopped, the constants are those of the rest.

    `measured`: the constants of all of it, where they are known. Raises ConfigError where there is nothing to compare,
    or sensors turn against each other.
    """
    check_comparable(recording)
    check_conventions(recording)
    measured = constants(recording) if measured is None else measured
    audited = _audited(measured)
    if _has_stopped(audited):
        measured = _repaired(recording, measured, audited)
        return measured, _audited(measured)
    # A counter that stopped where a robot drives one circle only passes for another tread, of which it did not stop.
    believed = _audited(replace(measured, robot=NOMINAL))
    if _has_stopped(believed):
        again = _repaired(recording, measured, believed)
        if _has_stopped(anew := _audited(again)):
            return again, anew
    return measured, audited


def _audited(measured: Constants) -> Audit:
    tread = Tread(measured.robot.tread, measured.sigma.tread, measured.robot.tread != NOMINAL.tread)
    if abs(tread.ratio - NOMINAL.tread) <= SURE * tread.sigma:  # robot.yaml's is the better one
        tread = Tread(is_measured=tread.is_measured)
    return audit(measured.recording, gather(measured.recording, measured.robot, measured.lag_s), tread)


def _has_stopped(audited: Audit) -> bool:
    return any(event.selected.effect.symptom is Symptom.STOPPED for event in audited.events)


def _repaired(recording: Recording, measured: Constants, audited: Audit) -> Constants:
    """The constants of the rest, where counters stopped; the recording as it is."""
    again = constants(repaired(recording, audited.evidence, audited.events, audited.tread))
    return replace(again, recording=replace(measured.recording, reference=again.recording.reference))
