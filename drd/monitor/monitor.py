"""The monitor: samples in, findings out. It reads no clock; the same samples give the same findings to the bit."""

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from drd.arrays import Array
from drd.config.keys import Config
from drd.effects.catalogue import catalogue
from drd.estimation.noise import SKID_TURN_RAD_PER_SQRT_RAD, SKID_WHEEL_M_PER_SQRT_M
from drd.estimation.steering import TAPE_PART, TAPE_SIGMAS
from drd.monitor.constants import CHANGE_S, Constants, stated_constants
from drd.monitor.findings import Finding, NotObservable, Suspicion
from drd.monitor.first_turns import FirstTurns, Turns
from drd.monitor.fixes import Fixes
from drd.monitor.judging import Judge
from drd.monitor.library import BIAS, CHANGE, OWN, TRAVEL, Hypothesis, Library
from drd.monitor.noise import KINDS, RowNoise
from drd.monitor.rows import LEAD_ROWS, ROW_S, STANDS_M, RowMaker, Rows
from drd.monitor.segments import Segments
from drd.monitor.sums import Sums
from drd.monitor.symptoms import Symptoms
from drd.monitor.telling import Known, Teller
from drd.samples import GyroSample, WheelSample
from drd.units import RAD_PER_S_PER_SQRT_S_PER_DEG_PER_H_PER_SQRT_H, RAD_PER_SQRT_S_PER_DEG_PER_SQRT_H

UNFIT_LOOKS: Final = 8  # in a row, half a minute: names mean nothing for a robot unlike its configuration
ANEW: Final = 100.0  # times the stated deviation, for a constant that has changed
EVEN: Final = 0.5  # a tread that more likely than not wanders is no constant
FEWEST_SEGMENTS: Final = 10  # half a minute: with less, no constant is remembered
EVERY: Final = 2  # blocks: judging more often costs time and finds nothing earlier
SLOWING_M_S2: Final = 0.1  # of a wheel that stops or starts: gentler ones are rare
TREAD_RAD2: Final = 0.1  # weight of the nominal tread: some turns
# Additional evidence required for a robot that skids, whose slip is not white: false names on real drives had as much.
SKID_NATS: Final = 12.0
SKIDS: Final = TAPE_SIGMAS * TAPE_PART  # relative: a tread this far off means wheels that slip sideways, (34)
SKID_JITTER_S: Final = 0.1  # a drive holds its speeds this long, (31)
TURNING_RAD_S: Final = 0.05


class Monitor:
    """Takes the estimator's samples, in order of time by sensor; `findings` gives the result.

    `config`: the robot's sizes and its sensors' noise. `known`: its constants from earlier drives, if any.
    """

    def __init__(self, config: Config, known: Constants | None = None):
        robot, noise = config.robot, config.estimation.noise
        self._tread_m = robot.tread_m
        self._stated = stated_constants(config)
        self._walk = noise.gyro_deg_per_sqrt_h * RAD_PER_SQRT_S_PER_DEG_PER_SQRT_H
        self._bias_walk = noise.gyro_bias_deg_h_per_sqrt_h * RAD_PER_S_PER_SQRT_S_PER_DEG_PER_H_PER_SQRT_H
        self._wheel_noise = noise.wheel_m_per_sqrt_m
        counts = config.encoders.counts_per_revolution
        self._count_m = 2.0 * math.pi * robot.wheel_radius_m / counts if counts else 0.0
        # A creeping wheel may seem to stand: its last count takes this long. Rows next to those with counts.
        last_s = math.sqrt(2.0 * self._count_m / SLOWING_M_S2)
        self._creep_rows = min(max(1, math.ceil(last_s / ROW_S)), LEAD_ROWS)
        self._rows, self._segments = RowMaker(), Segments(self._white)
        self._library = Library(robot.tread_m, robot.wheel_radius_m)
        self._symptoms = Symptoms(robot.tread_m)
        self._theta: Array | None = None
        wheel_scale = self._stated.sigmas[TRAVEL] / math.sqrt(2.0)
        self._fixes = Fixes(wheel_scale, self._walk, self._wheel_noise)
        self._drive = robot.drive
        self._skids = robot.drive == "skid"
        self._noise, self._first = RowNoise(self._skids), FirstTurns()
        self._constants = known or self._stated
        self.lag_s, self._lag_named_s = 0.0, 0.0
        self._turned = np.array([TREAD_RAD2, TREAD_RAD2])
        self._bias_rad_s = 0.0
        self._judging = Judge(self._segments, self._library, self._constants.sigmas, self._skids)
        self._distance_m = self._rolled_m = 0.0
        self.now_s = 0.0
        self._blocks = self._unfit = 0

    # ---- in ----------------------------------------------------------------------------------------------------

    def gyro(self, sample: GyroSample) -> None:
        """A calibrated sample of the gyro."""
        self._rows.gyro(sample)
        self._work()

    def wheels(self, sample: WheelSample) -> None:
        """A sample of the wheels."""
        self._rows.wheels(sample)
        self._work()

    def fix(self, t_ns: int, x_m: float, y_m: float, sigma_m: float) -> None:
        """Take a position from outside (set_pose, a dock), before the samples of later times.

        `sigma_m` inf: a reset, after which poses are in another frame.
        """
        self._fixes.fix(t_ns, x_m, y_m, sigma_m)

    def _work(self) -> None:
        rows = self._rows.take()
        if rows is not None:
            self._add(rows)
            self._judge()

    def _add(self, rows: Rows) -> None:
        """Add a block of rows: their weighted sensitivities go into the sums. (95), (96)"""
        h, inner = rows.interval_s, rows.inner
        self.now_s = end_s = float(rows.end_s[inner][-1])
        if self._theta is None:
            still = np.maximum(np.abs(rows.left_m), np.abs(rows.right_m)) < STANDS_M
            self._bias_rad_s = float(np.median((rows.gyro_rad / h)[still])) if still.any() else 0.0
        distances, gyro_var = np.abs(rows.left_m) + np.abs(rows.right_m), self._walk**2 * h
        near = np.convolve(distances > STANDS_M, np.ones(2 * self._creep_rows + 1)) > 0.5
        moves = near[self._creep_rows : self._creep_rows + len(distances)]
        wheel_var = self._wheel_variance(rows, distances, moves)
        tread = self._turned[0] / self._turned[1]
        share = gyro_var / (gyro_var + wheel_var + 1e-30)
        by_wheels, turn = self._library.turns(rows, self._bias_rad_s, share, tread)
        useless = self._symptoms.look(
            rows, by_wheels, tread, self._bias_rad_s, wheel_var, self._walk * float(np.median(h)) ** 0.5
        )
        self._forget_what_symptoms_spoilt(float(rows.end_s[-1]))
        first = self._first.add((by_wheels / h)[inner], (rows.gyro_rad / h)[inner] - self._bias_rad_s)
        if first is not None:
            self._begin_anew(first)
        self._fixes.rows(rows, turn, self._rows.zero_ns or 0)
        x = self._library.columns(rows, turn)
        good = rows.is_good[inner] & ~useless
        y = (by_wheels - rows.gyro_rad)[inner]
        x[:, BIAS] *= -1.0
        y -= sum(mean * x[:, c] for c, mean in self._constants.means.items())
        kind = np.where(~moves[inner], 0, np.where(np.abs(turn / h)[inner] < TURNING_RAD_S, 1, 2))
        variance = (gyro_var + wheel_var)[inner]
        if self._theta is None:
            self._theta = np.zeros(x.shape[1])
            self._theta[BIAS] = self._bias_rad_s
        weights = self._noise.weights(x, y - x @ self._theta, variance, kind, good)
        z = np.column_stack([x, y]) * np.sqrt(weights)[:, None]
        products = z.T @ z
        score = products[:OWN, -1] - products[:OWN, :-1] @ self._theta
        self._noise.scatter.learn(products[:OWN, :OWN], score, np.bincount(kind[good], minlength=KINDS).astype(float))
        self._tread_of(by_wheels[inner][good], turn[inner][good])
        begin_s = self._segments.all[-1].end_s if self._segments.all else float((rows.end_s - h)[inner][0])
        pinned = {t for k in self.known for t in (k.begin_s, k.end_s) if t is not None}
        rolled = 0.5 * distances[inner]
        self._segments.add(
            begin_s, end_s, self._distance_m, products, pinned, self._rolled_m, float(rolled[kind == 2].sum())
        )
        self._rolled_m += float(rolled.sum())
        self._distance_m += float(0.5 * np.abs(rows.left_m + rows.right_m)[inner].sum())

    def _wheel_variance(self, rows: Rows, distances_m: Array, moves: npt.NDArray[np.bool_]) -> Array:
        """Variance of the wheels' turn in each row, rad^2, (n,); `distances_m`: both wheels' together. (95)"""
        h = rows.interval_s
        variance = (self._wheel_noise**2 * distances_m + moves * self._count_m**2 / 3.0) / self._tread_m**2
        if self._skids:
            turned, changed = rows.gyro_rad - self._bias_rad_s * h, np.gradient(rows.gyro_rad / h)
            variance += SKID_WHEEL_M_PER_SQRT_M**2 * distances_m / self._tread_m**2
            variance += moves * (SKID_TURN_RAD_PER_SQRT_RAD**2 * np.abs(turned) + (SKID_JITTER_S * changed) ** 2)
        return variance

    def _white(self, products: Array) -> Array:
        return self._noise.scatter.white(products)

    def _forget_what_symptoms_spoilt(self, seen_s: float) -> None:
        """Forget the sums since the onset of a symptom once it is certain, and the names based on them."""
        for seen in self._symptoms.seen.values():
            if seen.sure and not seen.is_told:
                seen.is_told, seen.named_s = True, seen_s
                self._segments.drop_since(seen.begin_s)
                old = [k for k in self.known if k.named_s < seen.begin_s and (k.end_s or 0.0) < seen.begin_s]
                self._judging.forget(old)

    def _begin_anew(self, first: Turns) -> None:
        """Correct the stamps by a lag, use the noise of a robot that skids, and forget the sums so far. (99)"""
        self._turned = TREAD_RAD2 * np.array([first.tread, 1.0])
        skids = abs(first.tread - 1.0) > SKIDS and self._drive == "auto"
        if not first.lag_s and not skids:
            return
        self._skids |= skids
        self._judging.skids = self._skids
        self.lag_s, self._lag_named_s = first.lag_s, self.now_s
        if first.lag_s:
            self._rows.put_right(first.lag_s)
            means, sigmas = self._constants.means, self._constants.sigmas
            self._constants = Constants({**means, CHANGE: means[CHANGE] - first.lag_s / CHANGE_S}, sigmas)
        self._segments.all.clear()
        self._judging.forget()
        self._theta, self._noise = None, RowNoise(self._skids, self._noise)

    def _tread_of(self, by_wheels: Array, turn: Array) -> None:
        self._turned += (by_wheels @ turn, turn @ turn)
        if self._turned[1] > 100.0 * TREAD_RAD2:
            self._turned *= 0.5

    # ---- judged ------------------------------------------------------------------------------------------------

    def _judge(self) -> None:
        self._blocks += 1
        if len(self._segments.all) < 3 or self._blocks % EVERY:
            return
        sums = self._judging.look(self.now_s, self._bias_walk * self._noise.at_rest)
        self._theta = sums.theta[-1].copy()
        self._bias_rad_s = float(self._theta[BIAS])
        self._unfit = 0 if self._noise.is_fit else self._unfit + 1
        if not self.is_judging:
            self._judging.forget()
        elif self._drive != "auto" or self._first.is_over:  # for a robot that may skid nothing is named before
            self._judging.decide(SKID_NATS * self._skids)

    @property
    def known(self) -> list[Known]:
        """The findings that have been named and not retracted."""
        return self._judging.known

    def constants(self, changed: int | None = None) -> Constants | None:
        """The robot's constants since the onset of the newest lasting finding; None while data are too few. (100)

        `changed`: a column for which knowledge from before the drive no longer holds.
        """
        segments = self._segments.white
        lasting = [k.begin_s for k in self.known if k.end_s is None]
        segments = [s for s in segments if s.begin_s >= max(lasting, default=-math.inf)]
        if self.wanders > EVEN or not self.is_judging or len(segments) < FEWEST_SEGMENTS:
            return None
        walk = self._bias_walk * self._noise.at_rest
        stated = {c: sigma * (ANEW if c == changed else 1.0) for c, sigma in self._stated.sigmas.items()}
        sums = Sums(segments, walk, stated, False, [])
        found = {c: sums.constant(c) for c in stated}
        lag = {CHANGE: self.lag_s / CHANGE_S}
        return Constants(
            {c: self._constants.means[c] + lag.get(c, 0.0) + value for c, (value, _) in found.items()},
            {c: std for c, (_, std) in found.items()},
        )

    def began_with(self, column: int) -> float:
        """A constant as known before the drive."""
        return self._constants.means[column]

    @property
    def wanders(self) -> float:
        """Probability that the tread wanders, as that of wheels that slip sideways in each turn does."""
        if self._skids:
            return 1.0
        return self._judging.nothing.wanders if self._judging.nothing is not None else 0.0

    @property
    def bias_rad_s(self) -> float:
        """The gyro's bias, without the named effects."""
        return self._bias_rad_s

    # ---- out ---------------------------------------------------------------------------------------------------

    def findings(self) -> list[Finding]:
        """All findings so far, in the order in which they were named."""
        teller = self._teller()
        told = [teller.told(k) for k in self.known]
        told += [teller.of_lag(self.lag_s, self._lag_named_s)] if self.lag_s else []
        for seen in self._symptoms.seen.values():
            if seen.is_told:
                before = [g.distance_m for g in self._segments.all if g.begin_s <= seen.begin_s]
                told.append(teller.of_symptom(seen, before[-1] if before else self._distance_m))
        return sorted([*told, *self._fixes.findings()], key=lambda f: f.named_ns)

    def suspected(self) -> Suspicion | None:
        """The suspicion, while an effect is more likely than not and no name is certain; else None. (98)"""
        suspected = self._judging.suspected
        return None if suspected is None else self._teller().suspicion(suspected)

    @property
    def is_judging(self) -> bool:
        """False while the robot is so unlike its configuration that no name means anything. (99)"""
        return self._unfit < UNFIT_LOOKS

    def not_observable(self) -> list[NotObservable]:
        """Effects that need the position."""
        needing = [NotObservable(e.id, e.needs_position) for e in catalogue().values() if e.needs_position]
        return [*needing, *self._fixes.not_observable()]

    @property
    def distance_m(self) -> float:
        """Distance that the robot has travelled."""
        return self._distance_m

    def alike(self, k: Known) -> list[str]:
        """Names that fit as well as a finding's own."""
        return self._teller().alike(k)

    def _teller(self) -> Teller:
        return Teller(self._library.hypotheses, self._rows.zero_ns or 0, self.now_s)

    @property
    def hypotheses(self) -> list[Hypothesis]:
        """All hypotheses; empty before the first block."""
        return self._library.hypotheses

    @property
    def zero_ns(self) -> int | None:
        """Time of the first sample, from which `now_s` counts."""
        return self._rows.zero_ns
