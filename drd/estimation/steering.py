"""Kind of steering: whether the wheels slip sideways in each turn, as the effective tread shows."""

import math
from dataclasses import replace
from typing import Final

from drd.config.keys import Config
from drd.effects.compensation import Compensation
from drd.estimation.estimate import MEASURED_TREAD, SKID_SCALE, SKID_SLIP_S, WHEEL_SCALE, is_stated_skid
from drd.estimation.filter import Filter
from drd.estimation.lead import Place, seen_from
from drd.estimation.learning import Drive, Learned, WheelNoise
from drd.estimation.noise import SKID_LATERAL_M_PER_SQRT_M, SKID_TURN_M_PER_SQRT_RAD
from drd.estimation.state import LL, RL, RR, SLIP, TREAD

# A tread this many standard deviations off, of estimate and tape measure together, is not that of two wheels. The
# tape's relative standard deviation: tyres are wide.
TAPE_SIGMAS: Final = 3.0
TAPE_PART: Final = 0.05
# However well they are known from other drives, tyres and ground differ by this much on the next day.
LEAST_KNOWN: Final = {"wheel_scale": WHEEL_SCALE, "tread": MEASURED_TREAD}
# Skid-steer robots have 1.0 to 2.0 times the measured tread: slip in turns makes it no less, and not this much more.
MOST_EFFECTIVE: Final = 2.5


def as_modelled(config: Config, model: Compensation) -> Config:
    """The configuration with the drive that a model's effective tread implies, which compensation hides (34), and with
    the model's standard deviations of the states, where they are smaller. (40)
    """
    if config.robot.drive == "auto" and abs(model.relative_tread - 1.0) > TAPE_SIGMAS * TAPE_PART:
        config = replace(config, robot=replace(config.robot, drive="skid"))
    if config.estimation.profile != "physical":
        return config
    known = {}
    for key, sigma in model.initial.items():
        stated = getattr(config.estimation.initial, key)
        known[key] = min(max(sigma, LEAST_KNOWN.get(key, 0.0)), math.inf if stated is None else stated)
    return replace(config, estimation=replace(config.estimation, initial=replace(config.estimation.initial, **known)))


class Steering:
    """The kind of steering, as stated or detected. (34)

    While it is unknown, P lacks what skid steering would add: `scale`, the standard deviation of the scale of all
    distances, and `wander_m2`, the variance of x and of y.
    """

    def __init__(self, config: Config, wheel_noise: WheelNoise):
        self._robot, self._initial, self._wheel_noise = config.robot, config.estimation.initial, wheel_noise
        self.drive, self.scale, self.wander_m2 = Drive.UNKNOWN, 0.0, 0.0
        self._last: Place | None = None
        self._is_stated = config.robot.drive != "auto" or is_stated_skid(config) or not wheel_noise.is_learned
        if is_stated_skid(config):
            self._found_skid()
        elif self._is_stated or config.fog.protocol == "none":
            self.drive = Drive.DIFFERENTIAL  # nothing could show another
        elif config.estimation.initial.wheel_scale is None:
            self.scale = SKID_SCALE

    def begin(self, kf: Filter) -> None:
        """Allow sideways slip while the kind of steering is unknown. (34)"""
        if self.drive is Drive.UNKNOWN and self._initial.slip_s is None and not kf.sigma(SLIP):
            kf.add_slip_variance(SKID_SLIP_S**2)

    def watch(self, kf: Filter) -> bool:
        """Decide after a comparison, if the effective tread is known by now. False: it is one that no robot has."""
        if self.drive is not Drive.UNKNOWN:
            return True
        self._wander(kf)
        tape_m, sigma_m = TAPE_PART * self._robot.tread_m, kf.sigma(TREAD)
        off_m, most_m = kf.nominal.tread_m - self._robot.tread_m, TAPE_SIGMAS * math.hypot(sigma_m, tape_m)
        if off_m < -most_m or off_m > max(most_m, (MOST_EFFECTIVE - 1.0) * self._robot.tread_m):
            return False
        if off_m > most_m:
            if self.scale:
                kf.add_scale_variance(SKID_SCALE, 0.0)
            kf.add_position_variance(self.wander_m2)
            # The lag so far was learned with a wrong tread: F, being linear, lacks their product.
            kf.add_lag_variance(self._initial.wheel_lag_s**2)
            self._found_skid()
        elif abs(off_m) + TAPE_SIGMAS * sigma_m < TAPE_SIGMAS * tape_m and self._has_wheels_alike(kf):
            self._decide(Drive.DIFFERENTIAL)
            if self._initial.slip_s is None:
                kf.forget_slip()
        return True

    def _has_wheels_alike(self, kf: Filter) -> bool:
        """Whether the radii agree as nominal ones do; else one wheel slips, or the robot does."""
        n, p = kf.nominal, kf.flat_P
        nominal, variance = 2.0 * (self._initial.wheel_scale or WHEEL_SCALE) ** 2, p[RR] + p[LL] - 2.0 * p[RL]
        is_known = variance < nominal  # turns on the spot do not show it
        return is_known and (n.scale_right - n.scale_left) ** 2 < TAPE_SIGMAS**2 * (nominal + variance)

    def _wander(self, kf: Filter) -> None:
        """Add the variance that skid steering would have caused since the last comparison."""
        now = (kf.nominal.x_m, kf.nominal.y_m, kf.nominal.gyro_heading_rad)
        x_m, y_m, turn_rad = seen_from(self._last or now, now)
        self._last = now
        self.wander_m2 += SKID_TURN_M_PER_SQRT_RAD**2 * abs(turn_rad)
        self.wander_m2 += SKID_LATERAL_M_PER_SQRT_M**2 * math.hypot(x_m, y_m)

    def pose_was_set(self) -> None:
        """Restart the path that led to P."""
        self._last, self.wander_m2 = None, 0.0

    def _decide(self, drive: Drive) -> None:
        self.drive, self.scale, self.wander_m2 = drive, 0.0, 0.0

    def _found_skid(self) -> None:
        self._decide(Drive.SKID)
        self._wheel_noise.skids(self._robot.tread_m)

    def recall(self, learned: Learned) -> None:
        """Continue with the earlier decision, even without the gyro that showed it; P includes it already."""
        drive = Drive(learned.drive)
        if self._is_stated or drive in (Drive.UNKNOWN, self.drive):
            return
        self._decide(drive)
        if drive is Drive.SKID:
            self._found_skid()
