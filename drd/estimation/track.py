"""A filter stepped through time: one step for each piece of time, whichever sensor saw it."""

from collections.abc import Callable
from dataclasses import dataclass, field
from math import cos, sin
from typing import Final

from drd.config.keys import Config
from drd.estimation.filter import Filter
from drd.estimation.hindsight import Hindsight, Memory
from drd.estimation.noise import NoiseProfile
from drd.estimation.state import Sigmas
from drd.estimation.timeline import Piece, Segment, Stream, pieces
from drd.estimation.uncertainty import (
    HEADING_DOUBTFUL_RAD,
    UNSEEN_ACCELERATION_M_S2,
    UNSEEN_TURN_RAD_S2,
    UncertainHeading,
    unseen_growth,
)
from drd.units import NS_PER_S, S_PER_NS

STILL = Segment(0, 0, 0.0, 0.0)
# An older gyro rate is worse than the wheels' newest: it may be off by 0.25 rad/s, (36).
MOST_HELD_S: Final = 0.5
# Most intervals without a gyro, in which late wheels turn the pose, that are kept while wheels are awaited.
MOST_SPANS: Final = 256


@dataclass(slots=True)
class Track:
    """The filter, the time that it has reached, and its unseen motion.

    `no_gyro_after_s`: how long the last rate of a silent gyro is held as the robot's. `gyro_heading`: the heading is
    the gyro's, wherever there is one.
    """

    kf: Filter
    no_gyro_after_s: float
    max_speed_m_s: float
    gyro_heading: bool = False
    t_ns: int = 0  # 0: not begun
    speed_m_s: float = 0.0
    rate_rad_s: float = 0.0
    unseen_s: float = 0.0  # no wheels
    blind_s: float = 0.0  # neither wheels nor gyro
    blind_spans: tuple[tuple[int, int], ...] = ()  # since the wheels were seen last: when, ns
    no_gyro_s: float = 0.0
    unseen_turn_rad: float = 0.0  # since the wheels were seen last
    reading_ns: int = 0  # end of the wheels' newest reading
    # The turn measured by the wheels alone since the pose was set, and the tread it was computed with.
    alone_rad: float = 0.0
    alone_tread_m: float = 0.0
    _compared_ns: int = 0  # the end of the gyro's sample that was compared last
    gyro_ns: int = 0  # the time of the gyro up to which its rates have been used
    # Since the gyro's last step the lag has grown by this, and the gyro's heading has been turned for it by this. (30)
    _regained_s: float = 0.0
    _regained_rad: float = 0.0
    _lag_s: float = 0.0  # of `lag_ns`
    _lag_ns: int = 0
    # Difference by which the wheels' heading is rejected, and not yet released.
    rejected_rad: float = 0.0
    hindsight: Hindsight = field(default_factory=Hindsight)
    uncertain_heading: UncertainHeading = field(default_factory=UncertainHeading)

    def copy_from(self, other: "Track") -> None:
        """Take over another track's estimate and memory."""
        self.kf.copy_from(other.kf)
        self.t_ns, self.speed_m_s, self.rate_rad_s = other.t_ns, other.speed_m_s, other.rate_rad_s
        self.unseen_s, self.blind_s, self.no_gyro_s = other.unseen_s, other.blind_s, other.no_gyro_s
        self.blind_spans, self.unseen_turn_rad = other.blind_spans, other.unseen_turn_rad
        self.rejected_rad, self._compared_ns = other.rejected_rad, other._compared_ns
        self._regained_s, self._regained_rad = other._regained_s, other._regained_rad
        self.gyro_ns = other.gyro_ns
        self.alone_rad, self.alone_tread_m = other.alone_rad, other.alone_tread_m
        self.uncertain_heading.copy_from(other.uncertain_heading)

    def run(
        self,
        wheels: Stream,
        gyro: Stream,
        end_ns: int,
        on_gyro_end: Callable[[int, Segment, Segment], None] | None = None,
    ) -> bool:
        """Step to `end_ns`; `on_gyro_end` is called with time, wheels and gyro where a gyro sample ends and the wheels
        are known. True: the run stopped early, as that changed the lag and so the times of the gyro's rates.
        """
        lag_ns = self.lag_ns
        for piece in pieces(wheels, gyro, self.t_ns, end_ns, lag_ns, self.gyro_ns):
            self._step(piece, gyro)
            _, self.t_ns, wheel, rate = piece
            self.gyro_ns = max(self.gyro_ns, self.t_ns - lag_ns)  # in a time that is seen twice it stays
            if on_gyro_end and wheel and rate and self.t_ns == rate.end_ns + lag_ns:
                if rate.end_ns <= self._compared_ns:
                    continue  # the lag has become shorter meanwhile
                self._compared_ns = rate.end_ns
                before_s = self.kf.nominal.wheel_lag_s
                on_gyro_end(self.t_ns, wheel, rate)
                regained_s = self.kf.nominal.wheel_lag_s - before_s
                if regained_s:
                    self.lag_changed(regained_s)
                    return True
        return False

    def heading_rad(self, t_ns: int) -> float:
        """The wheels' heading at another time, approximately."""
        turned_rad = self.rate_rad_s * (t_ns - self.t_ns) * S_PER_NS
        return self.kf.nominal.heading_rad + turned_rad if self.t_ns else 0.0

    @property
    def lag_ns(self) -> int:
        """Estimated lag of the wheels behind the gyro, by which the gyro's rates are delayed. (30)"""
        lag_s = self.kf.nominal.wheel_lag_s
        if lag_s != self._lag_s:  # read many times between two comparisons, which alone change it
            self._lag_s = lag_s
            self._lag_ns = round(lag_s * NS_PER_S)
        return self._lag_ns

    def lag_changed(self, by_s: float) -> None:
        """Note a change of the lag: the next step corrects the part of the turn that is seen twice or left out."""
        self._regained_s += by_s
        self._regained_rad += self.kf.rate_rad_s * by_s

    def catch_up(self, left_m_s: float, right_m_s: float, start_ns: int, end_ns: int) -> None:
        """Move the pose on by the part of a sample that came too late, with its turn in the times without a gyro. The
        variance that (36) has added stays.
        """
        n, blind_ns = self.kf.nominal, 0
        self.blind_spans = tuple(span for span in self.blind_spans if span[1] > start_ns)
        for begin_ns, until_ns in self.blind_spans:
            blind_ns += max(min(until_ns, end_ns) - max(begin_ns, start_ns), 0)
        left_m_s, right_m_s = (1.0 - n.scale_left) * left_m_s, (1.0 - n.scale_right) * right_m_s
        turn_rad = (right_m_s - left_m_s) / n.tread_m * blind_ns * S_PER_NS
        distance_m = 0.5 * (left_m_s + right_m_s) * (end_ns - start_ns) * S_PER_NS
        middle = self.kf.heading_rad + 0.5 * turn_rad
        n.x_m, n.y_m = n.x_m + distance_m * cos(middle), n.y_m + distance_m * sin(middle)
        n.heading_rad, n.gyro_heading_rad = n.heading_rad + turn_rad, n.gyro_heading_rad + turn_rad

    def take_back(self, then: Memory | None, t_ns: int) -> None:
        """Restore the constants as known then. (18) P has no correlation of heading and tread after that, by which a
        turn measured by the wheels alone could be told anew.
        """
        self.hindsight.take_back(self.kf, then, t_ns)
        self.alone_rad = 0.0

    def tell_turn_anew(self) -> None:
        """Rescale the turn measured by the wheels alone if a comparison has changed the tread. (34)"""
        tread_m = self.kf.nominal.tread_m
        if self.alone_rad and tread_m != self.alone_tread_m:
            self.kf.tell_turn_anew(self.alone_rad, self.alone_tread_m)
            self.alone_rad *= self.alone_tread_m / tread_m
            self.alone_tread_m = tread_m

    def _step(self, piece: Piece, rates: Stream) -> None:
        start_ns, end_ns, wheels, gyro = piece
        kf, dt_s = self.kf, (end_ns - start_ns) * S_PER_NS
        if wheels and not gyro and self.rejected_rad:
            # Without this the hole would copy a slipped heading onto the gyro's, and the slip would never be found.
            kf.anchor_wheels()
            kf.add_heading_variance(self.rejected_rad**2, both=True)
            self.rejected_rad = 0.0
        _, _, left_m_s, right_m_s, lateral_m_s = wheels or STILL
        _, _, rate_rad_s, sigma_rad_s, _ = gyro or STILL
        x_m, y_m, heading_rad = kf.nominal.x_m, kf.nominal.y_m, kf.heading_rad
        kf.predict(
            dt_s, left_m_s * dt_s, right_m_s * dt_s, rate_rad_s if gyro else None, sigma_rad_s, lateral_m_s * dt_s
        )
        if (variance_rad2 := kf.heading_variance_rad2) > HEADING_DOUBTFUL_RAD**2:
            n = kf.nominal
            kf.add_position_variance(self.uncertain_heading.growth(n.x_m - x_m, n.y_m - y_m, variance_rad2))
        if gyro:
            n = kf.nominal
            self.rate_rad_s = n.gyro_scale * rate_rad_s + n.gyro_bias_rad_s
            self.no_gyro_s = 0.0
            if self._regained_s:
                # This much of the turn is seen twice, or left out; the update has allowed for it at the filter's rate.
                n.gyro_heading_rad += self._regained_rad - self._regained_turn_rad(rates, start_ns - self.lag_ns)
                self._regained_s = self._regained_rad = 0.0
        if wheels:
            self.unseen_s, self.blind_s, self.blind_spans, self.reading_ns = 0.0, 0.0, (), wheels.end_ns
            self.speed_m_s = 0.5 * (left_m_s + right_m_s)
            self.unseen_turn_rad = 0.0
            if not gyro:
                kf.anchor_gyro()  # (35)
                self.no_gyro_s += dt_s
                self.alone_tread_m = kf.nominal.tread_m
                self.alone_rad += kf.wheels_rad_s * dt_s
                if self.no_gyro_s > self.no_gyro_after_s:
                    self.rate_rad_s = kf.wheels_rad_s
            elif left_m_s or right_m_s:
                self.hindsight.moved(left_m_s * dt_s, right_m_s * dt_s, self.rate_rad_s * dt_s)
                if self.gyro_heading:  # wheels that stand are believed
                    kf.anchor_wheels()  # (35)
        else:
            self._unseen(start_ns, end_ns, without_gyro=gyro is None)
            self.unseen_turn_rad += kf.heading_rad - heading_rad

    def _regained_turn_rad(self, rates: Stream, from_ns: int) -> float:
        """The gyro's turn in the time that is seen twice, at the step's rate; negative: that is left out."""
        if self._regained_s > 0.0:
            return self.rate_rad_s * self._regained_s
        n = self.kf.nominal
        return n.gyro_bias_rad_s * self._regained_s - n.gyro_scale * rates.integral(self.gyro_ns, from_ns)

    def _unseen(self, start_ns: int, end_ns: int, without_gyro: bool) -> None:
        """Widen the position by unseen motion, without wheels; without a gyro the heading, too. (36)"""
        dt_s = (end_ns - start_ns) * S_PER_NS
        speed, rate = min(abs(self.speed_m_s), self.max_speed_m_s), abs(self.rate_rad_s)
        self.kf.add_position_variance(unseen_growth(self.unseen_s, dt_s, speed, UNSEEN_ACCELERATION_M_S2))
        self.unseen_s += dt_s
        if without_gyro:
            self.kf.add_heading_variance(unseen_growth(self.blind_s, dt_s, rate, UNSEEN_TURN_RAD_S2), both=True)
            self.blind_s += dt_s
            spans, begin_ns = self.blind_spans, start_ns
            if spans and spans[-1][1] == start_ns:
                spans, begin_ns = spans[:-1], spans[-1][0]
            self.blind_spans = (*spans[1 - MOST_SPANS :], (begin_ns, end_ns))
        else:
            self.kf.turn_by_gyro_alone(self.rate_rad_s * dt_s)
            self.kf.anchor_wheels()  # (35)


def make_track(
    config: Config, sigmas: Sigmas, noise: NoiseProfile, filter_type: Callable[..., Filter] = Filter
) -> Track:
    """A track that has not begun, with its own filter, as configured."""
    e = config.estimation
    return Track(
        filter_type(config.robot.tread_m, sigmas, noise, e.gate_sigma, e.midpoint, e.profile != "paper"),
        min(config.fog.silent_after_s, MOST_HELD_S) if config.fog.protocol != "none" else 0.0,
        config.robot.max_speed_m_s,
        e.heading == "gyro",
    )


MakeTrack = Callable[[Config, Sigmas, NoiseProfile], Track]
