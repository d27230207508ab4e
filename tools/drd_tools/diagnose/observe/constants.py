"""Constants of robot and reference from the calibrator: the start of the diagnosis of a robot far from robot.yaml.

They are effects of the catalogue, with the calibrator's values and deviations as the prior of their parameters. (79)
"""

import math
from dataclasses import dataclass, replace
from itertools import chain
from typing import Final, NamedTuple

import numpy as np

from drd.config.schema import ConfigError
from drd.effects.catalogue import catalogue
from drd.effects.effect import NOMINAL, Calibrated, Effect, Symptom, number
from drd_tools.calibrate.wheels.by_gyro import fit_by_gyro
from drd_tools.calibrate.wheels.drive import make_drive
from drd_tools.calibrate.wheels.fit import PRIOR, fit_wheels
from drd_tools.calibrate.wheels.whole_turns import with_turns
from drd_tools.diagnose.observe.audit import Audit, audit
from drd_tools.diagnose.observe.comparable import check_comparable
from drd_tools.diagnose.observe.conventions import check_conventions
from drd_tools.diagnose.observe.evidence import gather
from drd_tools.diagnose.observe.grids import is_dense
from drd_tools.diagnose.observe.lags import SURE, Lags, find_lags
from drd_tools.diagnose.observe.lost_encoders import without_lost_encoders
from drd_tools.diagnose.observe.lost_gyro import without_lost_gyro
from drd_tools.diagnose.observe.lost_reference import without_lost_reference
from drd_tools.diagnose.observe.reads import as_read
from drd_tools.diagnose.observe.stops import Tread, repaired
from drd_tools.diagnose.selected import Selected
from drd_tools.recordings.folder import Recording

# The prior has the deviations: a tread of 0.8 +- 0.06 is a better start than the nominal one.
NO_LIMIT: Final = np.full(3, np.inf)
MOST_UNEQUAL: Final = 1.5  # ratio of radii: more is the calibration of a counter that stopped in a drive of 30 cm
CERTAIN: Final = Calibrated(0.0, 0.0, 0.0, gyro_clock=0.0)  # deviations
WIDER: Final = 2.0  # times its sigma: error of a constant if the calibrator attributes an effect to it


@dataclass(frozen=True)
class Constants:
    """The recording with its reference's stamps corrected by `lag_s`, the robot's constants, and their deviations.

    `unmeasured`: additional deviations due to quantities that were not measured. `held_s`: time for which the reference
    was lost, whose rows are left out.
    """

    recording: Recording
    robot: Calibrated = NOMINAL
    sigma: Calibrated = CERTAIN
    lag_s: float = 0.0
    lag_sigma_s: float = 0.0
    unmeasured: Calibrated = CERTAIN
    held_s: float = 0.0

    @property
    def has_lag(self) -> bool:
        """Whether the reference's lag is determined."""
        return self.lag_sigma_s > 0.0

    @property
    def ahead_s(self) -> float:
        """How far the reference's clock may be ahead instead: gyro and wheels are both later, by no less; else 0."""
        return min(self.robot.gyro_lag_s, self.robot.wheels_lag_s)

    @property
    def selection(self) -> tuple[Selected, ...]:
        """Effects of the catalogue with these constants."""
        found = []
        for effect in catalogue().values():
            values = effect.calibrated(self.robot)
            if values is None or effect.is_neutral(values):
                continue
            sigma = {name: self.spread(effect, name, self.sigma) for name in values}
            if any(abs(number(values, name)) > SURE * sigma[name] for name in values):  # else robot.yaml is right
                prior = {}
                for name in values:
                    unmeasured = self.spread(effect, name, self.unmeasured)
                    prior[name] = number(values, name), math.hypot(WIDER * sigma[name], unmeasured)
                found.append(Selected(effect, values, tuple(values), prior=prior))
        return tuple(found)

    def spread(self, effect: Effect, name: str, of: Calibrated) -> float:
        """Deviation of a parameter, propagated from the deviations `of` all constants."""
        at = number(effect.calibrated(self.robot) or {}, name)
        square = 0.0
        for constant, sigma in of._asdict().items():
            moved = self.robot._replace(**{constant: getattr(self.robot, constant) + sigma})
            square += (number(effect.calibrated(moved) or {}, name) - at) ** 2
        return math.sqrt(square)


class _Geometry(NamedTuple):
    """Radii and tread relative to nominal, their deviations, and those due to quantities that were not measured."""

    robot: Calibrated = NOMINAL
    sigma: Calibrated = CERTAIN
    unmeasured: Calibrated = CERTAIN

    @property
    def is_of_a_robot(self) -> bool:
        """Whether the radii are those of a possible robot."""
        left, right = self.robot.left, self.robot.right
        return min(left, right) > 0.0 and max(left / right, right / left) <= MOST_UNEQUAL


def constants(recording: Recording) -> Constants:
    """Measure the constants with a dense reference, else with a gyro; they stay nominal if neither determines them."""
    reference = recording.reference
    has_path = reference is not None and is_dense(reference)
    if recording.fog is None and not has_path:
        found = None if reference is None else _by_reference(recording)
        if found is None or not found.is_of_a_robot:
            return Constants(recording)
        return Constants(recording, found.robot, found.sigma)
    lags = find_lags(recording)
    in_time = lags.in_time(recording)
    if recording.wheels is None:
        geometry: _Geometry | None = _Geometry()
    else:
        geometry = _by_reference(in_time) if has_path else _by_gyro(in_time, lags)
    if geometry is None:
        return Constants(recording)
    return _with_lags(recording, lags, geometry if geometry.is_of_a_robot else _Geometry())


def _by_reference(recording: Recording) -> _Geometry | None:
    try:
        (drive,) = with_turns([make_drive(recording)])
    except ConfigError:  # hardly moves
        return None
    fit = fit_wheels([drive], limit=NO_LIMIT)
    left, right, tread = (float(a / b) for a, b in zip(fit.wheels, drive.nominal, strict=True))
    of_left, of_right, of_tread = fit.narrow_sigma  # WIDER covers the small number of windows
    return _Geometry(Calibrated(left, right, tread), Calibrated(of_left * left, of_right * right, of_tread * tread))


def _by_gyro(recording: Recording, lags: Lags) -> _Geometry | None:
    """Geometry for the mean radius of robot.yaml: a gyro determines the rest only relative to it."""
    found = fit_by_gyro(recording, lags.wheels_s - lags.gyro_s, lags.growth)
    if found is None:
        return None
    half, sigma, mean = 0.5 * found.difference, 0.5 * found.difference_sigma, float(PRIOR[0])
    return _Geometry(
        Calibrated(1.0 - half, 1.0 + half, found.tread),
        Calibrated(sigma, sigma, found.tread_sigma),
        CERTAIN._replace(left=mean, right=mean, tread=mean * found.tread),
    )


def _with_lags(recording: Recording, lags: Lags, geometry: _Geometry) -> Constants:
    robot = geometry.robot._replace(
        wheels_lag_s=lags.wheels_s,
        lag_growth=lags.growth,
        by_gyro=lags.reference_s > 0.0 and recording.fog is not None,
        gyro_lag_s=lags.gyro_s,
        gyro_clock=lags.clock,
    )
    sigma = geometry.sigma._replace(
        wheels_lag_s=lags.wheels_sigma_s,
        lag_growth=lags.growth_sigma,
        gyro_lag_s=lags.wheels_sigma_s,
        gyro_clock=lags.clock_sigma,
    )
    reference = recording.reference
    if reference is not None:
        put_right = replace(reference, time_s=reference.time_s - lags.reference_s)
        recording = replace(recording, reference=put_right)
    return Constants(recording, robot, sigma, lags.reference_s, lags.reference_sigma_s, geometry.unmeasured)


def observe(recording: Recording) -> tuple[Constants, Audit]:
    """Constants and events of a recording; stopped counters are reconstructed before the constants are measured.

    Raises ConfigError if there is nothing to compare, or sensors turn against each other.
    """
    check_comparable(recording)
    check_conventions(recording)
    seen, held_s = without_lost_reference(without_lost_encoders(recording))
    measured, audited = _observed(without_lost_gyro(as_read(seen)))
    notes = measured.recording.notes
    if measured.ahead_s:
        late = f"gyro and encoders are later than the reference, both by {measured.ahead_s:.2f} s or more"
        notes = (*notes, f"{late}: its clock may be ahead instead")
    # Keep the rows as the daemon would receive them, with repeated counts and readings.
    as_received = replace(recording, reference=measured.recording.reference, notes=notes)
    return replace(measured, recording=as_received, held_s=held_s), audited


def _observed(recording: Recording) -> tuple[Constants, Audit]:
    measured = constants(recording)
    audited = _audited(measured)
    # If the robot only drives a circle, a stopped counter looks like another tread, with which nothing stopped.
    for believed in chain([audited], map(_audited, [replace(measured, robot=NOMINAL)])):  # the second only if needed
        if _has_stopped(believed):
            again = _repaired(recording, measured, believed)
            if _has_stopped(anew := _audited(again)):
                return again, anew
    return measured, audited


def _audited(measured: Constants) -> Audit:
    tread = Tread(measured.robot.tread, measured.sigma.tread, measured.robot.tread != NOMINAL.tread)
    if abs(tread.ratio - NOMINAL.tread) <= SURE * tread.sigma:  # robot.yaml's is better
        tread = Tread(is_measured=tread.is_measured)
    return audit(
        measured.recording,
        gather(measured.recording, measured.robot, measured.lag_s if measured.has_lag else None),
        tread,
    )


def _has_stopped(audited: Audit) -> bool:
    return any(event.selected.effect.symptom is Symptom.STOPPED for event in audited.events)


def _repaired(recording: Recording, measured: Constants, audited: Audit) -> Constants:
    """Measure the constants with stopped counters reconstructed; the recording itself stays unchanged."""
    again = constants(repaired(recording, audited.evidence, audited.events, audited.tread))
    return replace(again, recording=replace(measured.recording, reference=again.recording.reference))
