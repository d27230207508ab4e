"""The static bias: the gyro's mean over the seconds before a mission in which the encoders confirm a standstill."""

import math
from collections import deque
from enum import Enum

from drd.config.keys import StaticBias
from drd.estimation.health import Reasons
from drd.estimation.learning import RestNoise
from drd.samples import CalibratedRate, Validity, WheelSample
from drd.units import NS_PER_S, RAD_PER_DEG

# The chassis rocks before the counters see the first count: the last moments before a motion are not averaged.
GUARD_NS = NS_PER_S // 5
# Sums over a standstill beyond this many counts of one wheel are creep, not flicker of the last digit.
CREEP_COUNTS = 2.5
# Readings kept while the encoders are silent.
PENDING = 4096  # four seconds at 1 kHz
DEFAULT_DURATION_S = 10.0  # N = 0.1 deg/sqrt(h) then leaves 1.9 deg/h, (28)
# Largest change of a known bias, over the temperatures of a MEMS gyro; a fibre-optic one's is a thousandth of it.
MOST_CHANGE_RAD_S = 1.0 * RAD_PER_DEG
TURN_SIGMAS = 5.0  # of a reading's noise beyond that


class BiasState(Enum):
    """Progress of the measurement of the static bias."""

    WAITING = "waiting for gyro and encoders"
    MEASURING = "measuring the gyro's bias"
    DONE = "measured"
    SHORT = "cut short by motion"
    SKIPPED = "skipped"


class Standstill:
    """Says whether the encoders confirm a standstill, from increments and their sum since it began."""

    def __init__(self, resolution_m: float):
        self._resolution_m = resolution_m
        self._sum_left_m = self._sum_right_m = 0.0
        self.still = False

    def feed(self, sample: WheelSample) -> bool:
        """Take one wheel sample; returns whether the robot stands."""
        step = 1.01 * self._resolution_m
        self._sum_left_m += sample.left_m
        self._sum_right_m += sample.right_m
        creep = max(abs(self._sum_left_m), abs(self._sum_right_m)) > CREEP_COUNTS * self._resolution_m
        moved = sample.lost_s > 0.0 or abs(sample.left_m) > step or abs(sample.right_m) > step
        if creep or moved:
            self._sum_left_m = self._sum_right_m = 0.0
        self.still = not (creep or moved)
        return self.still


class BiasMeasurement:
    """Averages calibrated rates that the encoders have confirmed as standstill. (28)

    `active`: the gyro's samples are needed here. `is_settled`: there is nothing more to report. `turned`: the
    gyro turned while the wheels stood. `is_known`: a bias was measured, or known from before a restart.
    """

    def __init__(self, static_bias: StaticBias, rest_noise: RestNoise):
        self._config, self.rest_noise = static_bias, rest_noise
        # Skipped before a mission, it can still be requested.
        self.duration_s = static_bias.duration_s or DEFAULT_DURATION_S
        self.state = BiasState.WAITING
        self.bias_rad_s = self.sigma_rad_s = self.averaged_s = 0.0
        self.is_known = False
        self.restart()
        if static_bias.duration_s == 0.0:
            self.state = BiasState.SKIPPED

    @property
    def state(self) -> BiasState:
        """Progress of the measurement."""
        return self._state

    @state.setter
    def state(self, state: BiasState) -> None:
        self._state = state
        self.active = state is BiasState.WAITING or state is BiasState.MEASURING
        self.is_settled = state is BiasState.DONE or state is BiasState.SKIPPED

    def restart(self, known_rad_s: float | None = None) -> None:
        """Begin (again), also when the configuration skips the measurement before the mission.

        `known_rad_s`: the bias so far. Readings that no change of it explains end the measurement: the robot turns.
        """
        self.state, self._known_rad_s, self.turned = BiasState.WAITING, known_rad_s, False
        self._pending: deque[CalibratedRate] = deque(maxlen=PENDING)
        self._sum_rad = self._sum_s = 0.0
        self._still_since_ns: int | None = None

    def gyro(self, rate: CalibratedRate) -> None:
        """Keep a reading until the encoders have reported the motion of that time."""
        self._pending.append(rate)
        if self._known_rad_s is not None:
            noise_rad_s = math.sqrt(self.rest_noise.variance_rad2_per_s / rate.interval_s)
            change_rad_s = abs(rate.rate_rad_s - self._known_rad_s)
            self.turned = self.turned or change_rad_s > MOST_CHANGE_RAD_S + TURN_SIGMAS * noise_rad_s

    def wheels(self, sample: WheelSample, still: bool) -> None:
        """Take a wheel sample, and whether it confirms a standstill."""
        if self.turned:
            self._finish(BiasState.SHORT)
            return
        if still and self._still_since_ns is None:
            self._still_since_ns = sample.t_ns - round(sample.interval_s * NS_PER_S)
        while still and self._pending and self._pending[0].t_ns <= sample.t_ns - GUARD_NS:
            rate = self._pending.popleft()
            began_ns = rate.t_ns - round(rate.interval_s * NS_PER_S)
            if self._still_since_ns is None or began_ns < self._still_since_ns + GUARD_NS:
                continue  # a standstill at that time is not confirmed
            self._sum_rad += rate.rate_rad_s * rate.interval_s
            self._sum_s += rate.interval_s
            self.rest_noise.add(rate.rate_rad_s, rate.interval_s)
            self.state = BiasState.MEASURING
        if self._sum_s >= self.duration_s:
            self._finish(BiasState.DONE)
        elif not still and (self._sum_s > 0.0 or self._pending):
            self._finish(BiasState.DONE if self._sum_s >= self._config.minimum_s else BiasState.SHORT)
        elif not still:
            self.state = BiasState.SHORT

    def _finish(self, state: BiasState) -> None:
        self.state, self.averaged_s = state, self._sum_s
        self.rest_noise.interrupt()
        if state is BiasState.DONE:
            self.bias_rad_s, self.is_known = self._sum_rad / self._sum_s, True
            self.sigma_rad_s = self.sigma_after_rad_s(self._sum_s)

    def sigma_after_rad_s(self, averaged_s: float) -> float:
        """Standard deviation of a mean over `averaged_s` seconds of a gyro with angle random walk N: N/sqrt(T). (28)"""
        return math.sqrt(self.rest_noise.variance_rad2_per_s / averaged_s)

    def tell(self, reasons: Reasons, t_ns: int) -> None:
        """Turn the state of the measurement into the reason of a pose."""
        if self.active:
            severity = Validity.DEGRADED if self.is_known else Validity.INITIALISING
            reasons.set("bias", self.state.value, t_ns, severity)
            return
        reasons.clear("bias")
        if not self.is_known:
            text = f"gyro bias not measured: the robot moved after {self.averaged_s:.1f} s of standstill"
            reasons.set("bias", text, t_ns)

    def watch(self, reasons: Reasons, sigma_rad_s: float, now_ns: int) -> None:
        """Update the reason between two wheel samples. `sigma_rad_s`: deviation of the filter's bias."""
        if not reasons.has("bias"):
            if self.active:
                self.tell(reasons, now_ns)
        elif self.state is BiasState.SHORT and sigma_rad_s < 2.0 * self.sigma_after_rad_s(self._config.minimum_s):
            reasons.clear("bias")

    def take_over(self, other: "BiasMeasurement", rest_noise: RestNoise) -> None:
        """Continue with another's result; a measurement in progress starts again."""
        self.rest_noise, self.is_known = rest_noise, other.is_known
        if not other.active:
            self.state, self.averaged_s = other.state, other.averaged_s
            self.bias_rad_s, self.sigma_rad_s = other.bias_rad_s, other.sigma_rad_s

    def take_pending(self) -> list[CalibratedRate]:
        """The readings that were not averaged: the filter's first ones."""
        rates = list(self._pending)
        self._pending.clear()
        return rates
