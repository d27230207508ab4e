"""Run the estimator in each of its configurations, and compute the limit set by the sensors."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from drd.batch.run import latest
from drd.config.keys import Config
from drd.estimation.estimate import initial_sigmas
from drd.samples import Validity
from drd.units import S_PER_NS
from drd_tools.calibrate.wheels.drive import Mounting, make_drive
from drd_tools.calibrate.wheels.file import write_snippet
from drd_tools.calibrate.wheels.fit import fit_wheels
from drd_tools.calibrate.wheels.found import find
from drd_tools.calibrate.wheels.keys import sections
from drd_tools.calibrate.wheels.whole_turns import with_turns
from drd_tools.evaluate.replayed import poses_of
from drd_tools.honesty.figures import Estimated, Figures
from drd_tools.limit.drive import replayed_drive
from drd_tools.limit.known import known_of
from drd_tools.limit.limit import limit_on
from drd_tools.recordings.folder import Recording
from drd_tools.replay.folder_source import replay_folder
from drd_tools.replay.nominal import configuration

DEFAULT, CALIBRATED, PAPER, STATED, LIMIT = "default", "calibrated", "paper", "stated", "limit"
NOMINAL_LIMIT: Final = "limit, nominal"
WHEEL_LAG_S: Final = 0.05


def estimated(recording: Recording, config: Path | None = None) -> Estimated:
    """Estimate a recording with the daemon's estimator, as it stands or with a piece of configuration."""
    replayed = replay_folder(recording, config)
    poses, published = poses_of(replayed, recording.name), latest(replayed.poses)
    at_s = np.array([(pose.t_ns - replayed.zero_ns) * S_PER_NS for pose in published])
    bound_m = np.interp(poses.time_s, at_s, [pose.position_bound_m for pose in published])
    valid = np.array([pose.validity is Validity.VALID for pose in published])
    # The start, which is not a pose of the daemon, is as valid as the first one.
    valid = np.concatenate([np.full(len(poses.time_s) - len(valid), valid[0]), valid])
    return Estimated(replace(poses, bound_m=bound_m), valid)


def with_paper_profile(recording: Recording) -> Recording:
    """Configure a recording for the paper's Q and R."""
    config = configuration(recording)
    return replace(recording, config=replace(config, estimation=replace(config.estimation, profile="paper")))


def as_simulated(config: Config) -> Config:
    """Configuration with the distributions from which simulated robots are drawn, without noise the simulator lacks.

    Two driven wheels; white noise of the wheels' travel and of the gyro, gyro bias and its random walk. Nothing slips
    in turns, scales and tread are constant. The uncertainty of the time stamps stays: samples are means over intervals,
    which a lag cuts in two. The lag is that of sensors on one computer: the default's prior, for drives that hold their
    speeds, would make the gyro equally late, which no robot shows.
    """
    noise = replace(
        config.estimation.noise,
        lateral_m_per_sqrt_m=0.0,
        turn_rad_per_sqrt_rad=0.0,
        turn_m_per_sqrt_rad=0.0,
        wheel_scale_per_sqrt_m=0.0,
        tread_per_sqrt_rad=0.0,
        gyro_scale_per_sqrt_h=0.0,
    )
    robot = replace(config.robot, drive="differential")
    initial = replace(config.estimation.initial, wheel_lag_s=WHEEL_LAG_S)
    return replace(config, robot=robot, estimation=replace(config.estimation, noise=noise, initial=initial))


@dataclass(frozen=True)
class Calibration:
    """Result of `drd calibrate wheels` on other drives: wheels.yaml, and the mounting of the reference on the robot."""

    file: Path
    mounting: Mounting


def calibrate(recordings: Sequence[Recording], file: Path) -> Calibration:
    """Calibrate the wheels on the recordings, and write `file`. Raises ConfigError, OSError."""
    drives = with_turns([make_drive(recording) for recording in recordings])
    fit = fit_wheels(drives)
    found = find(recordings, drives, [], fit, judged=False)
    write_snippet(file, sections(found), [f"from {', '.join(recording.name for recording in recordings)}"])
    return Calibration(file, fit.mounting)


def limits(recording: Recording, drawn: Config | None = None) -> dict[str, Figures]:
    """Limits set by the noise with known geometry and, for a simulated robot, also with unknown geometry.

    `drawn`: distributions from which the robot and its noise were drawn; None: a real one, as robot.yaml states.
    """
    config = configuration(recording) if drawn is None else drawn
    drive = replayed_drive(recording, config)
    cases = {LIMIT: known_of(recording, config, drive)}
    if drawn is not None:
        cases[NOMINAL_LIMIT] = replace(cases[LIMIT], sigmas=initial_sigmas(drawn, estimates_gyro_scale=True))
    found = {name: limit_on(drive, known) for name, known in cases.items()}
    return {name: Figures(one.position_rms_m, one.heading_rms_deg, one.drift_percent) for name, one in found.items()}
