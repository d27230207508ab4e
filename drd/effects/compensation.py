"""Live correction of effects: one sample at a time, with the newest data of all else and none from the future."""

import math
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from drd.arrays import Array
from drd.config.keys import Robot
from drd.effects.catalogue import acting_order
from drd.effects.chain import geometry
from drd.effects.effect import ActsOn, Effect, Values
from drd.effects.live import Clip, LiveMotion, Trend, scalar
from drd.effects.model import Term
from drd.samples import CalibratedRate, WheelSample
from drd.units import NS_PER_S, S_PER_NS

# Iterative solution of an equation: most rounds, and the tolerance (rad/s, m/s).
ROUNDS: Final = 4
SOLVED: Final = 1e-9
# The same for the speed on which the wheels' effects depend: a metre per second halved so often is below it.
PASSES, SPEED_SOLVED_M_S = 24, 1e-7
# No slope of that equation is steeper: slip of 0.2 s^2/m at 2 m/s in samples of 1 ms makes -700.
STEEPEST: Final = -1e3
# Weight of the speed at a sample's end in its mean speed; the rest is that of its start. With one half an error would
# alternate for ever; with this it more than halves in two samples.
END_WEIGHT: Final = 0.6
# m^2/s^2
TINY: Final = 1e-12
# No wheeled robot of this kind speeds up or brakes harder.
FASTEST_M_S2: Final = 3.0
# Credible slopes of an error over its channel; others come from a step of the effect, such as a window's start.
SLOPES: Final = (-0.9, 9.0)

Errors = tuple[float, ...]
NO_ERROR: Final[Errors] = (0.0, 0.0)


class LiveTerm:
    """One effect with its parameters in SI, its clip, and its parameters each one standard deviation off."""

    def __init__(self, m: LiveMotion, term: Term):
        self.effect: Effect = term.effect
        self.values: Values = term.values()
        self.clip = Clip(m, term)
        self.error = NO_ERROR
        self._m = m
        stds = term.stds()
        self._further: list[Values] = [{**self.values, q: float(self.values[q]) + std} for q, std in stds.items()]
        for values in (self.values, *self._further):  # so that the memory of each lag begins with the run
            self.effect.correction(m, values)

    def gyro(self) -> Errors:
        """Rate error, rad/s."""
        return (scalar(self.effect.correction(self._m, self.values).gyro_rad_s),)

    def wheels(self) -> Errors:
        """Speed errors, m/s, left and right."""
        errors = self.effect.correction(self._m, self.values)
        return scalar(errors.left_m_s), scalar(errors.right_m_s)

    def lateral(self) -> Errors:
        """Sideways speed, m/s, to the left."""
        return (scalar(self.effect.correction(self._m, self.values).lateral_m_s),)

    def gyro_variance(self) -> float:
        """Variance due to the parameters, (rad/s)^2; those of a file are taken as independent."""
        if not self._further:
            return 0.0
        here = self.gyro()[0]
        return sum((scalar(self.effect.correction(self._m, v).gyro_rad_s) - here) ** 2 for v in self._further)


class Compensation:
    """Removes a model's effects from the samples of one run.

    `zero_ns`: where `time` is 0 (None: at the first sample). `end_s`: when the run ends, for effects that last so long.
    `outside`: a covariate of the last sample was outside the range in which an effect was seen, or an effect could not
    be inverted. `lateral_m_s`: the body's own sideways speed in the last wheel sample. `gyro_delay_ns`,
    `wheel_delay_ns`: age of the last samples. `relative_tread`: the effective tread over the stated one.
    `initial`: the model's standard deviations of the filter's states, by the keys of `estimation.initial`, in SI.
    """

    def __init__(
        self, terms: Sequence[Term], robot: Robot, has_gyro: bool, zero_ns: int | None = None, end_s: float = math.inf
    ):
        self._m = m = LiveMotion(robot.tread_m, robot.wheel_radius_m, end_s)
        in_reverse = sorted(terms, key=lambda term: acting_order(term.effect), reverse=True)
        live = [LiveTerm(m, term) for term in in_reverse]
        self._gyro = [t for t in live if t.effect.channel == "gyro"]
        wheels = [t for t in live if t.effect.channel == "wheels" and t.effect.acts_on is not ActsOn.TIMING]
        # Geometry acts first, and is linear unless it is clipped: it is removed last, by one product.
        first = [t for t in wheels if t.effect.geometry]
        G = geometry(m, [(t.effect, t.values) for t in first[::-1]])
        largest, smallest = np.linalg.svd(G, compute_uv=False) - 1.0
        if any(t.clip.is_bounded for t in first) or not SLOPES[0] < smallest <= largest < SLOPES[1]:
            first, G = [], np.eye(2)
        self._inverse_geometry = tuple(map(tuple, np.linalg.inv(G).tolist()))
        self._wheels = wheels[: len(wheels) - len(first)]
        self._body = [t for t in live if t.effect.channel == "body"]
        self._timing = [t for t in live if t.effect.acts_on is ActsOn.TIMING]
        self.relative_tread = math.prod(t.effect.relative_tread(t.values) for t in live)
        self.initial = initial_of(terms)
        self._has_gyro, self._zero_ns = has_gyro, zero_ns
        self._radius_m = robot.wheel_radius_m * robot.left_scale, robot.wheel_radius_m * robot.right_scale
        self._speed, self._rate = Trend(), Trend()
        self._end_m_s = self._off_m_s = 0.0
        self._slope = -1.0
        self._still_sum_c, self._still_count, self._still_known = 0.0, 0, False
        self.outside = False
        self.lateral_m_s = 0.0
        self.gyro_delay_ns = self.wheel_delay_ns = 0

    def gyro(self, rate: CalibratedRate, temperature_c: float, heading_rad: float, standing: bool) -> CalibratedRate:
        """The true rate, at its true time. `standing`: the bias is being measured. (39), (40)"""
        m, self.outside = self._m, False
        end_ns, interval_s, time_s = self._timed(rate.t_ns, rate.interval_s, wheels=False)
        self._temperature(time_s, temperature_c, standing)
        m.time_s[0] = time_s = time_s - 0.5 * interval_s
        m.heading_rad[0] = heading_rad
        speed = self._speed.at(time_s)
        m.speed_m_s[0] = 0.0 if speed is None else speed
        true_rad_s, variance = rate.rate_rad_s, rate.sigma_rad_s**2
        with np.errstate(all="ignore"):
            for term in self._gyro:
                true_rad_s = self._solve(term, term.gyro, (m.rate_rad_s,), (true_rad_s,))[0]
                variance += self._variance(term)
        m.rate_rad_s[0] = true_rad_s
        self._rate.take(time_s, true_rad_s)
        return CalibratedRate(end_ns, interval_s, true_rad_s, math.sqrt(variance))

    def wheels(self, sample: WheelSample, heading_rad: float) -> WheelSample:
        """The true travel, at its true time; `lateral_m_s` is the body's. (39)"""
        m, self.outside = self._m, False
        end_ns, interval_s, time_s = self._timed(sample.t_ns, sample.interval_s, wheels=True)
        m.time_s[0] = time_s = time_s - 0.5 * interval_s
        m.heading_rad[0] = heading_rad
        reading = sample.left_m / interval_s, sample.right_m / interval_s
        rate = self._rate.at(time_s) if self._has_gyro else None
        angles = (m.left_wheel_rad, m.right_wheel_rad)
        turned = sample.left_m / self._radius_m[0], sample.right_m / self._radius_m[1]
        for angle, step in zip(angles, turned, strict=True):
            angle[0] += 0.5 * step  # at the middle of the interval
        with np.errstate(all="ignore"):
            left, right = self._true_wheels(reading, time_s, interval_s, rate)
            m.left_m_s[0], m.right_m_s[0] = left, right
            self.lateral_m_s = sum(self._error(term, term.lateral)[0] for term in self._body)
        for i, angle in enumerate(angles):
            # The counter's angle without its unevenness: a wrong radius does not change how far the wheel turned.
            ripple = sum(t.error[i] for t in self._wheels if t.effect.uneven)
            angle[0] += 0.5 * turned[i] - ripple * interval_s / self._radius_m[i]
        return WheelSample(end_ns, interval_s, left * interval_s, right * interval_s, *sample[4:])

    # ---- one channel after the other ---------------------------------------------------------------------------

    def _true_wheels(
        self, reading: tuple[float, float], time_s: float, interval_s: float, rate: float | None
    ) -> tuple[float, float]:
        """True wheel speeds behind the reading; the body's speed and acceleration are those of their mean."""
        m, (left, right) = self._m, reading
        # The error and the slope are nearly those of the previous sample.
        x, old_x, old_off = 0.5 * (left + right) - self._off_m_s, 0.0, 0.0
        for term in self._wheels:
            term.error = NO_ERROR
        for i in range(PASSES):
            m.rate_rad_s[0] = (right - left) / m.tread_m if rate is None else rate
            self._ahead(interval_s, x)
            left, right = reading
            for term in self._wheels:
                # Start from the error of the previous pass, which is nearly the same.
                left, right = self._solve(term, term.wheels, (m.left_m_s, m.right_m_s), (left, right), term.error)
            (ll, lr), (rl, rr) = self._inverse_geometry
            left, right = ll * left + lr * right, rl * left + rr * right
            # Falls at least as fast as x grows (more acceleration, more slip to remove), so the root is near.
            off = 0.5 * (left + right) - x
            if abs(off) < SPEED_SOLVED_M_S:
                break
            if i == 0:
                low, high = min(x, x + off), max(x, x + off)
            else:
                low, high = (max(x, low), high) if off > 0.0 else (low, min(x, high))
            if i and x != old_x:
                self._slope = min(max((off - old_off) / (x - old_x), STEEPEST), -1.0)
            old_x, old_off = x, off
            x -= off / self._slope
            if i and not low - SPEED_SOLVED_M_S < x < high + SPEED_SOLVED_M_S:
                x = 0.5 * (low + high)
        mean = 0.5 * (left + right)
        self._off_m_s = 0.5 * sum(reading) - mean
        self._end_m_s = self._ahead(interval_s, mean)
        self._speed.take(time_s, mean)
        if rate is None:
            m.rate_rad_s[0] = (right - left) / m.tread_m
        return left, right

    def _ahead(self, interval_s: float, mean: float) -> float:
        """Set speed and acceleration for a mean wheel speed `mean`; return the speed at the sample's end.

        The acceleration is such that speed times acceleration adds up to half the change of the squared speed: slip
        in starting and stopping then cancels, as in reality, and no delay accumulates. (39)
        """
        m, begin = self._m, self._end_m_s
        end = (mean - (1.0 - END_WEIGHT) * begin) / END_WEIGHT
        m.speed_m_s[0], changed = mean, end - begin
        work = 0.5 * (end * abs(end) - begin * abs(begin))
        share = abs(mean) * changed
        weight = work / share if abs(share) > TINY else 0.0
        acceleration = min(max(weight, 0.0), 2.0) * changed / interval_s
        m.acceleration_m_s2[0] = min(max(acceleration, -FASTEST_M_S2), FASTEST_M_S2)
        return end

    def _solve(
        self,
        term: LiveTerm,
        errors: Callable[[], Errors],
        channels: tuple[Array, ...],
        reading: Errors,
        likely: Errors = NO_ERROR,
    ) -> Errors:
        """Solve x + error(x) = reading by the secant method per channel: exact where the error is linear. (39)

        `likely`: initial guess of the error.
        """

        def tried(x: Errors) -> tuple[Errors, Errors]:
            """The error at x, and the residual x + error - reading."""
            for channel, value in zip(channels, x, strict=True):
                channel[0] = value
            error = self._error(term, errors)
            return error, tuple(a + b - c for a, b, c in zip(x, error, reading, strict=True))

        x = tuple(c - b for c, b in zip(reading, likely, strict=False))
        old_x = old_off = x
        for i in range(ROUNDS + 1):
            error, off = tried(x)
            if i == ROUNDS or max(map(abs, off)) < SOLVED:
                break
            steps = off if i == 0 else tuple(map(_secant, x, off, old_x, old_off))
            old_x, old_off = x, off
            x = tuple(a - b for a, b in zip(x, steps, strict=True))
        if not (left := max(map(abs, off))) < SOLVED:
            # For an effect that cannot be inverted this diverges; the reading itself is then closer to the truth.
            if left <= max(map(abs, tried(reading)[1])):
                tried(x)  # sets the motion back to x
            else:
                x, error, self.outside = reading, (0.0,) * len(reading), True
        term.error = error
        return x

    def _error(self, term: LiveTerm, errors: Callable[[], Errors]) -> Errors:
        """The error, its covariates clipped to the range in which it was seen."""
        if not term.clip.is_bounded:
            return errors()
        outside = term.clip.apply()
        found = errors()
        self.outside |= term.clip.undo() or outside
        return found

    def _variance(self, term: LiveTerm) -> float:
        """Variance due to the parameters and, outside the range seen, to what the clip left out. (40)"""
        if not term.clip.is_bounded:
            return term.gyro_variance()
        free = term.gyro()[0]
        term.clip.apply()
        missing, variance = free - term.gyro()[0], term.gyro_variance()
        term.clip.undo()
        found = variance + missing * missing
        return found if math.isfinite(found) else 0.0

    # ---- time and temperature ----------------------------------------------------------------------------------

    def _timed(self, t_ns: int, interval_s: float, wheels: bool) -> tuple[int, float, float]:
        """A sample's true end, in ns and in s from the zero, and its true length."""
        if self._zero_ns is None:
            self._zero_ns = t_ns
        end_s = (t_ns - self._zero_ns) * S_PER_NS
        late_s, late_before_s = self._late_s(end_s, wheels), self._late_s(end_s - interval_s, wheels)
        late_ns = round(late_s * NS_PER_S)
        if wheels:
            self.wheel_delay_ns = late_ns
        else:
            self.gyro_delay_ns = late_ns
        return t_ns - late_ns, interval_s - (late_s - late_before_s), end_s - late_s

    def _late_s(self, time_s: float, wheels: bool) -> float:
        found = 0.0
        for term in self._timing:
            delays = term.effect.delays(time_s - found, term.values)
            found += delays.wheels_s if wheels else delays.gyro_s
        return found

    def _temperature(self, time_s: float, temperature_c: float, standing: bool) -> None:
        m = self._m
        m.warm(time_s, temperature_c)
        if self._still_known or math.isnan(temperature_c):
            return
        if self._still_count == 0:
            m.still_c = temperature_c
        elif not standing:
            m.still_c = self._still_sum_c / self._still_count
        self._still_known = not standing
        self._still_sum_c += temperature_c
        self._still_count += 1


def initial_of(terms: Sequence[Term]) -> dict[str, float]:
    """Standard deviations that the terms state of the filter's states; the larger of two wheels'. (40)"""
    found: dict[str, float] = {}
    for term in terms:
        stds, relative_tread = term.stds(), term.effect.relative_tread(term.values())
        for q in term.effect.parameters:
            if q.initial and q.name in stds:  # relative to the model's effective tread
                found[q.initial] = max(found.get(q.initial, 0.0), stds[q.name] / relative_tread)
    return found


def _secant(x: float, off: float, old_x: float, old_off: float) -> float:
    """The step to subtract: Newton's, with the slope between the last two points."""
    slope = (off - old_off) / (x - old_x) - 1.0 if x != old_x else 0.0
    return off / (1.0 + slope) if SLOPES[0] < slope < SLOPES[1] else off
