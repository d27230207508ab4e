"""From the nominal robot to the configuration of the daemon that it stands for."""

from dataclasses import replace
from typing import Final, Literal, TypeVar

from drd.config.keys import Config, Encoders, Estimation, Fog, Initial, Noise, Robot, StaticBias
from drd.config.nominal import FogSheet, Nominal

T = TypeVar("T")
# Where no top speed is stated: no robot this is meant for is faster, and a counter that starts again at 0 is.
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
FOG_KEYS: Final = {"range_deg_s": "full_scale_deg_s"}
NOISE_KEYS: Final = {
    "angle_random_walk_deg_per_sqrt_h": "gyro_deg_per_sqrt_h",
    "bias_random_walk_deg_per_h_per_sqrt_h": "gyro_bias_deg_h_per_sqrt_h",
    "bias_repeatability_deg_s": "gyro_bias_repeatability_deg_s",  # and estimation.initial.gyro_bias_deg_s
}
# Not used: fog.resolution_deg_s (its noise is in the random walk that a data sheet measures), reference.*, kinds.
# In place of the configuration's defaults, which are an RD2100 FOG's, for a MEMS gyro of which robot.yaml says no more:
# Xsens MTi-1 noise density 0.007 deg/s/sqrt(Hz), bias instability 10 deg/h; turn-on bias of an MTi within 0.5 deg/s.
MEMS: Final = FogSheet(
    angle_random_walk_deg_per_sqrt_h=0.42,
    bias_random_walk_deg_per_h_per_sqrt_h=10.0,
    bias_repeatability_deg_s=0.2,
)


def nominal_config(nominal: Nominal, gyro_hz: float | None, wheels_hz: float) -> Config:
    """The daemon's configuration that a robot stands for. Nothing in it comes from the recorded motion.

    `gyro_hz`, `wheels_hz`: how often the sensors report, where the robot does not state it. None: there is no gyro.
    """
    sheet, bias_s = data_sheet(nominal.fog), nominal.standstill_at_start_s
    protocol: Literal["ecore", "none"] = "none" if gyro_hz is None else "ecore"
    gyro_hz, wheels_hz = sheet.rate_hz or gyro_hz or Fog.rate_hz, nominal.encoders.rate_hz or wheels_hz
    noise = _stated(Noise(), sheet, NOISE_KEYS)
    if nominal.encoders.slip_noise_m_per_sqrt_m is not None:
        noise = replace(noise, wheel_m_per_sqrt_m=nominal.encoders.slip_noise_m_per_sqrt_m)
    initial = _stated(Initial(), sheet, {"bias_repeatability_deg_s": "gyro_bias_deg_s"})
    static_bias = StaticBias(duration_s=bias_s, minimum_s=min(StaticBias.minimum_s, max(0.1, 0.5 * bias_s)))
    robot = Robot(
        name=nominal.name,
        wheel_radius_m=nominal.wheel.radius_m,
        tread_m=nominal.tread_m,
        drive=nominal.drive or Robot.drive,
        max_speed_m_s=nominal.max_speed_m_s or MAX_SPEED_M_S,
    )
    # A slow log is not a silent one.
    fog = Fog(
        protocol=protocol,
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
