"""Configuration of the daemon for robot.yaml, the nominal model, with overrides from files."""

from dataclasses import replace
from pathlib import Path

from drd.batch.samples import rate_hz
from drd.config.file import check_estimate, load_overlay
from drd.config.keys import CalibrationFile, Config
from drd.config.robot import Robot, nominal_config
from drd.config.schema import ConfigError, Loaded
from drd.effects.model import Model, check_geometry, load_model
from drd.estimation.calibration import Calibration, load_calibration
from drd_tools.recordings.folder import Recording


def with_model(recording: Recording, file: Path) -> Recording:
    """Apply a model file to a recording: change its nominal model and add the effects. Raises ConfigError."""
    model = load_model(file)
    nominal = model.changed(recording.nominal)
    wheels = recording.wheels
    if wheels is not None and wheels.left_counts is not None and nominal.counts_per_revolution is None:
        path = "wheel.counts_per_revolution"
        raise ConfigError(model.robot.place(path), path, "a number, since encoders.csv has counts", "null")
    return _with_terms(replace(recording, nominal=nominal), model, file)


def with_configured_model(recording: Recording, config: Config) -> Recording:
    """Add the effects of the model that the configuration names, if any. Raises ConfigError."""
    if config.model.file is None or recording.model is not None:
        return recording
    file = Path(config.model.file)
    model = load_model(file)
    check_geometry(model, config)
    return _with_terms(recording, model, file)


def _with_terms(recording: Recording, model: Model, file: Path) -> Recording:
    terms, notes = model.holds_in(recording.name)
    return replace(recording, model=file, terms=terms, notes=tuple(notes))


def configuration(recording: Recording) -> Config:
    """The daemon's configuration that corresponds to robot.yaml.

    For a recording made by the daemon, the configuration that was in force.
    """
    if recording.config is not None:
        return _as_believed(recording.config, recording.nominal)
    fog, encoders = recording.fog, recording.encoders
    return nominal_config(recording.nominal, None if fog is None else rate_hz(fog), rate_hz(encoders))


def _as_believed(config: Config, nominal: Robot) -> Config:
    """The configuration with the robot's geometry, which a model file may have changed."""
    robot = replace(config.robot, wheel_radius_m=nominal.wheel_radius_m, tread_m=nominal.tread_m)
    encoders = replace(config.encoders, counts_per_revolution=nominal.counts_per_revolution)
    return replace(config, robot=robot, encoders=encoders)


def in_force(recording: Recording, file: Path | None, calibration: Path | None) -> tuple[Config, Calibration | None]:
    """Configuration and calibration: those of robot.yaml, overridden by the daemon's configuration `file`.

    Any part of the file may be missing. Its ports, frames and signs are ignored, and it adds no gyro to a recording
    without one. Raises ConfigError.
    """
    config = configuration(recording)
    if file is not None:
        config = _overruled(recording, load_overlay(file, config))
    named = config.calibration.file
    calibration = calibration or (Path(named) if named is not None else None)
    if calibration is None or config.fog.protocol == "none":
        return config, None
    config = replace(config, calibration=CalibrationFile(file=str(calibration)))
    return config, load_calibration(calibration)


def _overruled(recording: Recording, loaded: Loaded[Config]) -> Config:
    """Check a configuration that a file has changed against the recording. Raises ConfigError."""
    config = loaded.value
    if recording.encoders.left_counts is not None and config.encoders.counts_per_revolution is None:
        path = "encoders.counts_per_revolution"
        raise ConfigError(loaded.place(path), path, "a number, since encoders.csv has counts", "null")
    if recording.fog is None:
        output = replace(config.output, publish_on="wheels")
        config = replace(config, fog=replace(config.fog, protocol="none"), output=output)
        if config.estimation.heading == "gyro":
            path, expected = "estimation.heading", "filter, since the recording has no gyro"
            raise ConfigError(loaded.place(path), path, expected, "'gyro'")
    check_estimate(replace(loaded, value=config))
    return config
