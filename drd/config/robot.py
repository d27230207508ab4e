"""The nominal robot: the class, its file robot.yaml, and the daemon's configuration made from it."""

import math
import typing
from collections.abc import Mapping
from dataclasses import dataclass, make_dataclass, replace
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeVar

import msgspec
import numpy as np
from msgspec import Meta

from drd.config import keys as section
from drd.config.keys import Config, Encoders, Estimation, Fog, Initial, Noise, StaticBias
from drd.config.schema import ConfigError, Loaded, is_nan, keys, load, nested

T = TypeVar("T")
# Used where no top speed is stated: no robot meant here is faster, but a counter that restarts at 0 seems to be.
MAX_SPEED_M_S: Final = 10.0
# robot.yaml -> configuration. A key that is null or missing leaves the configuration's default.
#   name, drive                                 robot.name, robot.drive
#   max_speed_m_s                               robot.max_speed_m_s (missing: MAX_SPEED_M_S)
#   wheel.radius_m                              robot.wheel_radius_m
#   wheel.counts_per_revolution                 encoders.counts_per_revolution
#   tread_m                                     robot.tread_m
#   encoders.rate_hz                            encoders.rate_hz (missing: the median interval's)
#   fog.rate_hz                                 fog.rate_hz (missing: the median interval's)
#   standstill_at_start_s                       estimation.static_bias.duration_s, and half of it minimum_s; 0 skips it
#   the rest                                    as in these two
FOG_KEYS: Final = {"gyro_range_deg_s": "full_scale_deg_s"}
NOISE_KEYS: Final = {
    "gyro_angle_random_walk_deg_per_sqrt_h": "gyro_deg_per_sqrt_h",
    "gyro_bias_random_walk_deg_per_h_per_sqrt_h": "gyro_bias_deg_h_per_sqrt_h",
    "gyro_bias_repeatability_deg_s": "gyro_bias_repeatability_deg_s",  # and estimation.initial.gyro_bias_deg_s
    "slip_noise_m_per_sqrt_m": "wheel_m_per_sqrt_m",
}
# Not used: fog.resolution_deg_s (its noise is in the random walk that a datasheet measures), reference.*, kinds.
# Replaces the configuration's defaults, which are an RD2100 FOG's, for a MEMS gyro without values in robot.yaml:
# Xsens MTi-1 noise density 0.007 deg/s/sqrt(Hz), bias instability 10 deg/h; turn-on bias of an MTi within 0.5 deg/s.
MEMS: Final = {
    "gyro_angle_random_walk_deg_per_sqrt_h": 0.42,
    "gyro_bias_random_walk_deg_per_h_per_sqrt_h": 10.0,
    "gyro_bias_repeatability_deg_s": 0.2,
}


@dataclass(frozen=True, kw_only=True)
class Robot:
    """A robot with two driven sides, from its drawings and its sensors' datasheets. None: not known.

    The last text in a value's annotation is its key in robot.yaml. Sizes of a robot without encoders may be NaN.
    """

    name: Annotated[str, "name"] = "robot"  # Name of the robot or of its drive
    wheel_radius_m: Annotated[float, "m", Meta(ge=0.001, le=5), "wheel.radius_m"]  # Rolling radius
    # Counts per turn of the wheel; None where the drive reports speed only
    counts_per_revolution: Annotated[
        Annotated[float, "1", Meta(ge=1e-3, le=1e9)] | None, "wheel.counts_per_revolution"
    ] = None
    tread_m: Annotated[float, "m", Meta(ge=0.01, le=50), "tread_m"]  # Distance between left and right wheels
    # How it steers: two wheels and casters, or sideways slip in each turn (four wheels, tracks); auto: determined
    drive: Annotated[Literal["auto", "differential", "skid"] | None, "drive"] = None
    # Faster wheel travel counts as a jump of the counter; None: MAX_SPEED_M_S
    max_speed_m_s: Annotated[Annotated[float, "m/s", Meta(ge=0.01, le=100)] | None, "max_speed_m_s"] = None
    # The gyro's datasheet. Values that it lacks default to a MEMS gyro's noise for kind "MEMS", else to a FOG's
    gyro_kind: Annotated[str | None, "fog.kind"] = None
    # Output rate; None: from the time stamps
    gyro_rate_hz: Annotated[Annotated[float, "Hz", Meta(ge=1e-3, le=1e5)] | None, "fog.rate_hz"] = None
    # Full scale
    gyro_range_deg_s: Annotated[Annotated[float, "deg/s", Meta(ge=1e-3, le=1e5)] | None, "fog.range_deg_s"] = None
    gyro_angle_random_walk_deg_per_sqrt_h: Annotated[
        Annotated[float, "deg/sqrt(h)", Meta(ge=0, le=1e3)] | None, "fog.angle_random_walk_deg_per_sqrt_h"
    ] = None
    # Bias, switch-on to switch-on
    gyro_bias_repeatability_deg_s: Annotated[
        Annotated[float, "deg/s", Meta(ge=0, le=1e3)] | None, "fog.bias_repeatability_deg_s"
    ] = None
    # Rate random walk
    gyro_bias_random_walk_deg_per_h_per_sqrt_h: Annotated[
        Annotated[float, "deg/h/sqrt(h)", Meta(ge=0, le=1e6)] | None, "fog.bias_random_walk_deg_per_h_per_sqrt_h"
    ] = None
    gyro_resolution_deg_s: Annotated[Annotated[float, "deg/s", Meta(ge=0, le=1e3)] | None, "fog.resolution_deg_s"] = (
        None
    )
    encoders_kind: Annotated[str | None, "encoders.kind"] = None  # For people
    # Output rate; None: from the time stamps
    encoders_rate_hz: Annotated[Annotated[float, "Hz", Meta(ge=1e-3, le=1e5)] | None, "encoders.rate_hz"] = None
    # Noise of each wheel's travel: 0.0005 indoors, 0.005 off-road
    slip_noise_m_per_sqrt_m: Annotated[
        Annotated[float, "m/sqrt(m)", Meta(ge=0, le=1)] | None, "encoders.slip_noise_m_per_sqrt_m"
    ] = None
    # Standard deviations of a reference's coordinates and of its heading, for a diagnosis
    reference_position_sigma_m: Annotated[
        Annotated[float, "m", Meta(ge=0, le=1e3)] | None, "reference.position_sigma_m"
    ] = None
    reference_heading_sigma_deg: Annotated[
        Annotated[float, "deg", Meta(ge=0, le=180)] | None, "reference.heading_sigma_deg"
    ] = None
    # Length of the initial standstill, in which the gyro's bias is measured
    standstill_at_start_s: Annotated[float, "s", Meta(ge=0, le=1e6), "standstill_at_start_s"] = 0.0

    def __post_init__(self) -> None:
        """Convert numpy's numbers to Python's. Raises ConfigError for a value of a wrong type or out of range."""
        stated = {path: _plain(getattr(self, name)) for name, path in PATHS.items()}
        known = {path: value for path, value in stated.items() if value is not None and not is_nan(value)}
        try:
            file = msgspec.convert(nested(known), RobotFile)
        except msgspec.ValidationError as error:
            path = str(error).partition(" - at `$.")[2].rstrip("`")
            name = next(name for name, p in PATHS.items() if p == path)
            raise ConfigError("robot", name, dict(keys(RobotFile))[path].expected, repr(known[path])) from error
        for name, path in PATHS.items():
            object.__setattr__(self, name, attrgetter(path)(file))

    @property
    def has_gyro_sheet(self) -> bool:
        """Whether anything is known about a gyro."""
        return any(getattr(self, name) is not None for name in SHEET)

    def without_gyro(self) -> "Robot":
        """The robot without its gyro."""
        return replace(self, **dict.fromkeys(SHEET))  # type: ignore[arg-type]  # each may be None

    def sections(self) -> dict[str, Any]:
        """The content of robot.yaml."""
        return nested({path: getattr(self, name) for name, path in PATHS.items()})

    def config(self, *, has_gyro: bool = True) -> Config:
        """The configuration of an `Estimator` that receives samples. Raises ConfigError."""
        return nominal_config(self, Fog.rate_hz if has_gyro else None, Encoders.rate_hz)


_HINTS: Final = typing.get_type_hints(Robot, include_extras=True)
PATHS: Final[dict[str, str]] = {name: hint.__metadata__[-1] for name, hint in _HINTS.items()}
SHEET: Final = tuple(name for name in PATHS if name.startswith("gyro_"))


def _section(name: str, content: Mapping[str, Any]) -> Any:
    """Make the class of a section of robot.yaml; sizes that the file does not state are NaN."""
    rows: list[Any] = []
    for key, field in content.items():
        if isinstance(field, dict):
            part = _section(key, field)
            rows.append((key, part, part()))
            continue
        hint, own = _HINTS[field], _HINTS[field].__metadata__[:-1]
        kind: Any = Annotated[hint.__origin__, *own] if own else hint.__origin__
        rows.append((key, kind, getattr(Robot, field, math.nan)))
    return make_dataclass(name, rows, kw_only=True, frozen=True)


# robot.yaml, as `schema` reads it.
RobotFile: Final = _section("RobotFile", nested({path: name for name, path in PATHS.items()}))


def robot_of(file: Any) -> Robot:
    """The robot described by a RobotFile."""
    return Robot(**{name: attrgetter(path)(file) for name, path in PATHS.items()})


def load_robot(file: Path, has_wheels: bool = True) -> Loaded[Robot]:
    """Read robot.yaml. Without encoders it need not describe the wheels. Raises ConfigError."""
    loaded, meanings = load(file, RobotFile), dict(keys(RobotFile))
    for path in ("wheel.radius_m", "tread_m") if has_wheels else ():
        if math.isnan(attrgetter(path)(loaded.value)):
            raise ConfigError(str(file), path, meanings[path].expected, "nothing (the key is required)")
    return replace(loaded, value=robot_of(loaded.value))


def _plain(value: object) -> object:
    """Convert numpy's numbers to Python's."""
    return value.item() if isinstance(value, np.generic) else value


def nominal_config(nominal: Robot, gyro_hz: float | None, wheels_hz: float) -> Config:
    """The daemon's configuration for a robot. Nothing in it comes from the recorded motion.

    `gyro_hz`, `wheels_hz`: the sensors' rates, used where the robot does not state them. None: there is no gyro.
    """
    sheet, bias_s = datasheet(nominal), nominal.standstill_at_start_s
    protocol: Literal["ecore", "none"] = "none" if gyro_hz is None else "ecore"
    gyro_hz, wheels_hz = sheet.gyro_rate_hz or gyro_hz or Fog.rate_hz, nominal.encoders_rate_hz or wheels_hz
    noise = _stated(Noise(), sheet, NOISE_KEYS)
    initial = _stated(Initial(), sheet, {"gyro_bias_repeatability_deg_s": "gyro_bias_deg_s"})
    static_bias = StaticBias(duration_s=bias_s, minimum_s=min(StaticBias.minimum_s, max(0.1, 0.5 * bias_s)))
    robot = section.Robot(
        name=nominal.name,
        wheel_radius_m=nominal.wheel_radius_m,
        tread_m=nominal.tread_m,
        drive=nominal.drive or section.Robot.drive,
        max_speed_m_s=nominal.max_speed_m_s or MAX_SPEED_M_S,
    )
    # A slow log is not a silent one.
    fog = Fog(
        protocol=protocol,
        positive="counterclockwise",
        rate_hz=gyro_hz,
        full_scale_deg_s=5000.0,  # none stated: all of the gyro's readings are used
        silent_after_s=max(Fog.silent_after_s, 3.0 / gyro_hz),
    )
    encoders = Encoders(
        counts_per_revolution=nominal.counts_per_revolution,
        rate_hz=wheels_hz,
        gap_s=longest_gap_s(wheels_hz),
        silent_after_s=max(Encoders.silent_after_s, 3.0 / wheels_hz),
    )
    estimation = Estimation(
        noise=noise, initial=initial, static_bias=static_bias, reorder_s=max(Estimation.reorder_s, 2.5 / gyro_hz)
    )
    return Config(robot=robot, fog=_stated(fog, sheet, FOG_KEYS), encoders=encoders, estimation=estimation)


def longest_gap_s(wheels_hz: float) -> float:
    """The largest interval between rows of the wheels that still counts as motion, s."""
    return max(Encoders.gap_s, 3.0 / wheels_hz)


def datasheet(robot: Robot) -> Robot:
    """The robot, with typical MEMS noise where its gyro is a MEMS gyro and the datasheet states none."""
    if (robot.gyro_kind or "").upper() != "MEMS":
        return robot
    return replace(robot, **{name: value for name, value in MEMS.items() if getattr(robot, name) is None})  # type: ignore[arg-type]  # fields of numbers


def _stated(base: T, robot: Robot, names: dict[str, str]) -> T:
    """`base` with the values of the datasheets."""
    found = {ours: getattr(robot, theirs) for theirs, ours in names.items() if getattr(robot, theirs) is not None}
    return replace(base, **found)  # type: ignore[type-var]  # a dataclass
