"""Constants of robot and reference, from the calibrator: where a diagnosis of a robot far from robot.yaml sets out.

They are effects of the catalogue, whose parameters have the calibrator's values and deviations as a prior. (79)
"""

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from drd.config.schema import ConfigError
from drd.effects.catalogue import catalogue
from drd.effects.effect import NOMINAL, Calibrated, Effect, Symptom, number
from drd_tools.calibrate.wheels.drive import Wheels, make_drive
from drd_tools.calibrate.wheels.fit import WheelFit, fit_wheels
from drd_tools.diagnose.observe.audit import Audit, audit
from drd_tools.diagnose.observe.conventions import check_conventions
from drd_tools.diagnose.observe.evidence import check_comparable, gather
from drd_tools.diagnose.observe.grids import DENSE_S
from drd_tools.diagnose.observe.lags import SURE, find_lags
from drd_tools.diagnose.observe.stops import Tread, repaired
from drd_tools.diagnose.selected import Selected
from drd_tools.recordings.folder import Recording

# Their deviations are in the prior: a tread of 0.8 +- 0.06 sets out better than the nominal one does.
NO_LIMIT: Final = np.full(3, np.inf)
MOST_UNEQUAL: Final = 1.5  # radii: what a calibration makes of a counter that stopped in a drive of 30 cm
WIDER: Final = 3.0  # than its sigma a constant may be off where the calibrator takes an effect for it


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
    lags = find_lags(recording)
    try:
        drive = make_drive(lags.in_time(recording))
    except ConfigError:  # hardly moves
        return Constants(recording)
    robot, sigma = _geometry(fit_wheels([drive], limit=NO_LIMIT), drive.nominal)
    robot = robot._replace(
        wheels_lag_s=lags.wheels_s,
        lag_growth=lags.growth,
        by_gyro=lags.reference_s > 0.0 and recording.fog is not None,
        gyro_lag_s=lags.gyro_s,
        gyro_clock=lags.clock,
    )
    sigma = sigma._replace(
        wheels_lag_s=lags.wheels_sigma_s,
        lag_growth=lags.growth_sigma,
        gyro_lag_s=lags.wheels_sigma_s,
        gyro_clock=lags.clock_sigma,
    )
    put_right = replace(reference, time_s=reference.time_s - lags.reference_s)
    return Constants(replace(recording, reference=put_right), robot, sigma, lags.reference_s, lags.reference_sigma_s)


def _geometry(fit: WheelFit, nominal: Wheels) -> tuple[Calibrated, Calibrated]:
    """Radii and tread over the nominal ones, and their deviations; robot.yaml's, where no robot has such wheels."""
    left, right, tread = (float(a / b) for a, b in zip(fit.wheels, nominal, strict=True))
    if min(left, right) <= 0.0 or max(left / right, right / left) > MOST_UNEQUAL:
        return NOMINAL, Calibrated(0.0, 0.0, 0.0)
    of_left, of_right, of_tread = fit.sigma
    return Calibrated(left, right, tread), Calibrated(of_left * left, of_right * right, of_tread * tread)


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
