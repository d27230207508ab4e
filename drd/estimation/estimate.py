"""The estimate that one estimator passes to the next: at a restart by a file, at a reload directly."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Final

import msgspec
import numpy as np
from msgspec import Meta

from drd.config.keys import Config
from drd.estimation.covariance import unfit
from drd.estimation.filter import LEAST_LAG_S, MOST_LAG_S, Filter
from drd.estimation.learning import Drive, Learned
from drd.estimation.state import (
    GYRO_BIAS,
    GYRO_HEADING,
    GYRO_SCALE,
    HEADING,
    HEADING_UNKNOWN_RAD2,
    POSITION_UNKNOWN_M2,
    SCALE_L,
    SCALE_R,
    SLIP,
    TREAD,
    WHEEL_LAG,
    Matrix,
    N,
    Nominal,
    Sigmas,
    X,
    Y,
)
from drd.units import RAD_PER_DEG

# Plausible range of each computed quantity: beyond 1e7 m doubles no longer resolve a step of the robot; the others
# amply cover what the configuration allows.
LIMITS: Final = {
    "tread_m": (0.005, 50.0),
    "x_m": (-1e7, 1e7),
    "y_m": (-1e7, 1e7),
    "heading_rad": (-1e7, 1e7),
    "scale_right": (-0.9, 0.9),
    "scale_left": (-0.9, 0.9),
    "gyro_heading_rad": (-1e7, 1e7),
    "gyro_scale": (0.1, 10.0),
    "gyro_bias_rad_s": (-1.0, 1.0),
    "wheel_lag_s": (LEAST_LAG_S, MOST_LAG_S),
    "slip_s": (-5.0, 5.0),
    "origin_x_m": (-1e7, 1e7),
    "origin_y_m": (-1e7, 1e7),
}
# Relative standard deviations of nominal tyre radii, and of a tread measured with a tape.
WHEEL_SCALE: Final = 0.005
MEASURED_TREAD: Final = 0.02
# Skid steering: the effective tread is 1.0 to 2.0 times the measured one, the distance 3 to 8 % shorter than the wheels
# say, and the body slips sideways by -0.4 to 0.4 s times speed and yaw rate.
EFFECTIVE_TREAD: Final = 0.5
SKID_SCALE: Final = 0.04
SKID_SLIP_S: Final = 0.25
LARGEST_VARIANCE: Final = 1e10  # of any state: a hundred times the largest that the filter keeps, 1e8 m^2
Row = Annotated[list[float], Meta(min_length=N, max_length=N)]
Rows = Annotated[list[Row], Meta(min_length=N, max_length=N)]
Speed = Annotated[float, Meta(ge=-1e3, le=1e3)]


def is_stated_skid(config: Config) -> bool:
    """Whether the configuration says that the wheels slip sideways: by name, or by taking the gyro's heading."""
    by_gyro = config.robot.drive == "auto" and config.estimation.heading == "gyro"
    return config.robot.drive == "skid" or (by_gyro and config.estimation.profile == "physical")


def initial_sigmas(config: Config, estimates_gyro_scale: bool) -> Sigmas:
    """Standard deviations of a cold start: as configured, or typical of the kind of steering."""
    initial, has_gyro = config.estimation.initial, config.fog.protocol != "none"
    is_physical = config.estimation.profile == "physical"
    skids, is_auto = is_stated_skid(config), config.robot.drive == "auto" and is_physical
    wheel_scale, tread, slip_s = initial.wheel_scale, initial.tread, initial.slip_s
    if wheel_scale is None:
        wheel_scale = SKID_SCALE if skids else WHEEL_SCALE
    if tread is None:
        tread = EFFECTIVE_TREAD if skids or (has_gyro and is_auto) else MEASURED_TREAD
    if slip_s is None:
        slip_s = SKID_SLIP_S if skids else 0.0
    return Sigmas(
        position_m=initial.position_m,
        heading_rad=initial.heading_deg * RAD_PER_DEG,
        wheel_scale=wheel_scale,
        tread_m=tread * config.robot.tread_m,
        gyro_scale=initial.gyro_scale if estimates_gyro_scale else 0.0,
        gyro_bias_rad_s=initial.gyro_bias_deg_s * RAD_PER_DEG,
        wheel_lag_s=initial.wheel_lag_s if has_gyro and is_physical else 0.0,
        slip_s=slip_s,
        scale_difference=SKID_SCALE if has_gyro and is_auto and initial.wheel_scale is None else 0.0,
    )


@dataclass(frozen=True)
class Estimate:
    """The filter's quantities with their covariance, (N, N) in its order; the state of motion, and the learned noise
    and drive.

    `at_rest`: the encoders confirmed a standstill. `lost`: only a pose from outside makes the pose good again.
    """

    nominal: Nominal
    P: Matrix
    at_rest: bool
    lost: bool
    speed_m_s: Speed
    rate_rad_s: Speed
    learned: Learned = field(default_factory=Learned)

    def plain(self) -> dict[str, Any]:
        """Values for JSON, exact to the bit."""
        found: dict[str, Any] = msgspec.to_builtins(self, enc_hook=lambda P: P.tolist())
        return found


def estimate_of(plain: Any) -> Estimate:
    """The inverse of `plain()`, checked. Raises ValueError with the defect."""
    found = msgspec.convert(plain, Estimate, dec_hook=_matrix)
    for name, (low, high) in LIMITS.items():
        if not low <= (value := getattr(found.nominal, name)) <= high:  # NaN neither
            raise ValueError(f"nominal.{name}: expected a number from {low:g} to {high:g}, got {value!r}")
    Drive(found.learned.drive)
    check_covariance(found.P)
    return found


def _matrix(_: Any, rows: Any) -> Matrix:
    try:
        return np.array(msgspec.convert(rows, Rows))
    except msgspec.ValidationError as error:
        raise ValueError(str(error)) from error  # gets its path in the message, unlike the other


def check_covariance(P: Matrix) -> None:
    """Raises ValueError unless P is finite, symmetric and positive semidefinite, up to a filter's rounding."""
    if not np.abs(P).max() <= LARGEST_VARIANCE:
        raise ValueError(f"P: expected finite numbers up to {LARGEST_VARIANCE:g}")
    if (found := unfit(P)) is not None:
        raise ValueError(f"P: expected {found[0]}, got {found[1]}")


def forget_wheels(kf: Filter, tread_m: float, s: Sigmas) -> None:
    """Reset wheel scales, tread and sideways slip; the rest stays."""
    n = kf.nominal
    n.scale_right = n.scale_left = n.slip_s = 0.0
    kf.set_tread(tread_m)
    known = ((SCALE_R, s.wheel_scale), (SCALE_L, s.wheel_scale), (TREAD, s.tread_m), (SLIP, s.slip_s))
    for state, sigma in known:
        kf.forget(state, sigma)
    kf.add_scale_variance(0.0, s.scale_difference)


def forget_gyro(kf: Filter, s: Sigmas) -> None:
    """Reset the gyro's scale and bias; the rest stays."""
    kf.nominal.gyro_scale, kf.nominal.gyro_bias_rad_s = 1.0, 0.0
    for state, sigma in ((GYRO_SCALE, s.gyro_scale), (GYRO_BIAS, s.gyro_bias_rad_s)):
        kf.forget(state, sigma)


def forget_lag(kf: Filter, s: Sigmas) -> None:
    """Reset the uncertainty of the wheels' lag. While the robot turns, its value stays, and both headings get the
    error that follows from the lag's: learning the lag corrects them, too. (30)
    """
    if not s.wheel_lag_s or not kf.rate_rad_s:  # it is not estimated, or nothing depends on it
        kf.nominal.wheel_lag_s = 0.0
    kf.forget(WHEEL_LAG, 0.0)
    kf.add_lag_variance(s.wheel_lag_s**2)


def _forget(P: Matrix, sigmas: Mapping[int, float]) -> None:
    for i, sigma in sigmas.items():
        P[i, :] = P[:, i] = 0.0
        P[i, i] = sigma**2


def forget_pose(P: Matrix) -> None:
    """Make the pose unknown: any position, any heading."""
    _forget(P, {X: math.sqrt(POSITION_UNKNOWN_M2), Y: math.sqrt(POSITION_UNKNOWN_M2)})
    _forget(P, dict.fromkeys((HEADING, GYRO_HEADING), math.sqrt(HEADING_UNKNOWN_RAD2)))
    P[HEADING, GYRO_HEADING] = P[GYRO_HEADING, HEADING] = P[HEADING, HEADING]
