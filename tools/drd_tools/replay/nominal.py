"""From robot.yaml, the nominal model, to a configuration of the daemon; what files say instead of it."""

import dataclasses
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np

from drd.config.file import check_estimate, load_overlay
from drd.config.keys import (
    CalibrationFile,
    Config,
    Encoders,
    Estimation,
    Fog,
    Initial,
    Noise,
    Robot,
    StaticBias,
)
from drd.config.nominal import FogSheet, Nominal
from drd.config.schema import ConfigError, Loaded
from drd.effects.model import Model, check_geometry, load_model
from drd.estimation.calibration import Calibration, load_calibration
from drd_tools.recordings.folder import Recording

T = TypeVar("T")
# robot.yaml knows no top speed. No robot this is meant for is faster, and a counter that starts again at 0 is.
MAX_SPEED_M_S: Final = 10.0
# robot.yaml -> configuration. A key that is null or missing leaves the configuration's default.
#   name                                        robot.name
#   wheel.radius_m                              robot.wheel_radius_m
#   wheel.counts_per_revolution                 encoders.counts_per_revolution
#   tread_m                                     robot.tread_m
#   encoders.rate_hz                            encoders.rate_hz (missing: the median interval's)
#   fog.rate_hz                                 fog.rate_hz (missing: the median interval's)
#   standstill_at_start_s                       estimation.static_bias.duration_s, and half of it minimum_s; 0 skips it
#   the rest                                    as in these two
FOG_KEYS: Final = {"range_deg_s": "full_scale_deg_s"}
NOISE_KEYS: Final = {
    "angle_random_walk_deg_per_sqrt_h": "gyro_deg_per_sqrt_h",
    "bias_random_walk_deg_per_h_per_sqrt_h": "gyro_bias_deg_h_per_sqrt_h",
    "bias_repeatability_deg_s": "gyro_bias_repeatability_deg_s",  # and estimation.initial.gyro_bias_deg_s
}
# Not used: fog.resolution_deg_s (its noise is in the random walk that a data sheet measures), reference.*, kinds.
# What the configuration's defaults, of an RD2100 FOG, are for a MEMS gyro whose robot.yaml says no more than that:
# Xsens MTi-1 noise density 0.007 deg/s/sqrt(Hz), bias instability 10 deg/h; turn-on bias of an MTi within 0.5 deg/s.
MEMS: Final = FogSheet(
    angle_random_walk_deg_per_sqrt_h=0.42,
    bias_random_walk_deg_per_h_per_sqrt_h=10.0,
    bias_repeatability_deg_s=0.2,
)


def overlay(base: T, stated: Loaded[Any]) -> T:
    """`base` with every value that a file states, and none of the file's defaults."""
    return _overlay(base, stated.value, stated.origins, "")


def _overlay(base: T, stated: Any, origins: dict[str, str], path: str) -> T:
    changes: dict[str, Any] = {}
    for f in dataclasses.fields(base):  # type: ignore[arg-type]  # T is always a dataclass
        mine, theirs, here = getattr(base, f.name), getattr(stated, f.name), f"{path}{f.name}"
        if dataclasses.is_dataclass(mine):
            changes[f.name] = _overlay(mine, theirs, origins, f"{here}.")
        elif origins.get(here, "default") != "default":
            changes[f.name] = theirs
    return replace(base, **changes)  # type: ignore[type-var]  # the same


def with_model(recording: Recording, file: Path) -> Recording:
    """The recording, its nominal model changed by the model file, with the file's effects. Raises ConfigError."""
    model = load_model(file)
    nominal = overlay(recording.nominal, model.robot)
    wheels = recording.wheels
    if wheels is not None and wheels.left_counts is not None and nominal.wheel.counts_per_revolution is None:
        path = "wheel.counts_per_revolution"
        raise ConfigError(model.robot.place(path), path, "a number, since encoders.csv has counts", "null")
    return _with_terms(replace(recording, nominal=nominal), model, file)


def with_configured_model(recording: Recording, config: Config) -> Recording:
    """The recording with the effects of the model that the configuration names, if any. Raises ConfigError."""
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
    """The daemon's configuration that robot.yaml stands for. Nothing in it comes from the recorded motion.

    Of a recording that the daemon made, the configuration that was in force.
    """
    nominal = recording.nominal
    if recording.config is not None:
        return _as_believed(recording.config, nominal)
    sheet, bias_s = data_sheet(nominal.fog), nominal.standstill_at_start_s
    wheels_hz = nominal.encoders.rate_hz or _rate_hz(recording.encoders.time_s)
    gyro_hz = sheet.rate_hz or (_rate_hz(recording.fog.time_s) if recording.fog is not None else 10.0)
    noise = _stated(Noise(), sheet, NOISE_KEYS)
    if nominal.encoders.slip_noise_m_per_sqrt_m is not None:
        noise = replace(noise, wheel_m_per_sqrt_m=nominal.encoders.slip_noise_m_per_sqrt_m)
    initial = _stated(Initial(), sheet, {"bias_repeatability_deg_s": "gyro_bias_deg_s"})
    static_bias = StaticBias(duration_s=bias_s, minimum_s=min(StaticBias.minimum_s, max(0.1, 0.5 * bias_s)))
    robot = Robot(
        name=nominal.name,
        wheel_radius_m=nominal.wheel.radius_m,
        tread_m=nominal.tread_m,
        max_speed_m_s=MAX_SPEED_M_S,
    )
    # A slow log is not a silent one.
    fog = Fog(
        protocol="none" if recording.fog is None else Fog.protocol,
        positive="counterclockwise",
        rate_hz=gyro_hz,
        full_scale_deg_s=5000.0,  # none stated: whatever the gyro gave is used
        silent_after_s=max(Fog.silent_after_s, 3.0 / gyro_hz),
    )
    encoders = Encoders(
        counts_per_revolution=nominal.wheel.counts_per_revolution,
        rate_hz=wheels_hz,
        gap_s=max(Encoders.gap_s, 3.0 / wheels_hz),
        silent_after_s=max(Encoders.silent_after_s, 3.0 / wheels_hz),
    )
    estimation = Estimation(
        noise=noise,
        initial=initial,
        static_bias=static_bias,
        reorder_s=max(Estimation.reorder_s, 2.5 / gyro_hz),
    )
    return Config(robot=robot, fog=_stated(fog, sheet, FOG_KEYS), encoders=encoders, estimation=estimation)


def _as_believed(config: Config, nominal: Nominal) -> Config:
    """The configuration with the robot's geometry, which a model file may have changed."""
    robot = replace(config.robot, wheel_radius_m=nominal.wheel.radius_m, tread_m=nominal.tread_m)
    encoders = replace(config.encoders, counts_per_revolution=nominal.wheel.counts_per_revolution)
    return replace(config, robot=robot, encoders=encoders)


def data_sheet(fog: FogSheet) -> FogSheet:
    """The data sheet, with its class's typical values where it is a MEMS gyro's and says nothing."""
    if (fog.kind or "").upper() != "MEMS":
        return fog
    typical = {f: getattr(MEMS, f) for f in NOISE_KEYS if getattr(fog, f) is None}
    return replace(fog, **typical)


def _stated(base: T, sheet: FogSheet, names: dict[str, str]) -> T:
    """`base` with the values that the data sheet states."""
    found = {ours: getattr(sheet, theirs) for theirs, ours in names.items() if getattr(sheet, theirs) is not None}
    return replace(base, **found)  # type: ignore[type-var]  # a dataclass


def _rate_hz(time_s: Any) -> float:
    return 1.0 / float(np.median(np.diff(time_s))) if len(time_s) > 1 else 10.0


def in_force(recording: Recording, file: Path | None, calibration: Path | None) -> tuple[Config, Calibration | None]:
    """Configuration and calibration: robot.yaml's, then what the daemon's configuration `file` states instead of it.

    Any part of it may be missing. Its ports, frames and signs have no meaning here; a recording without a gyro stays
    one. Raises ConfigError.
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
    """The configuration that a file has changed, checked against the recording. Raises ConfigError."""
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
