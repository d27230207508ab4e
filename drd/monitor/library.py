"""The sensitivity of gyro against wheels to each effect of the catalogue, by the effect's own formula. (94), (95)"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from drd.arrays import Array
from drd.effects.catalogue import catalogue
from drd.effects.effect import Begins, Effect, Errors, Parameter, Values
from drd.effects.motion import Motion
from drd.monitor.rows import STANDS_M, Rows

PARTS: Final = 4  # of a row: wheels turn, and delays act, within it
UNKNOWN: Final = "unknown"
# Knots of a hat-function curve for unknown effects, in m/s and rad/s; constant beyond the last.
SPEEDS: Final = (0.2, 0.5, 0.9, 1.4, 2.2)
RATES: Final = (0.05, 0.2, 0.5, 1.0)
FASTEST: Final = 0.2  # relative: largest size of an unknown curve
LATER_S: Final = 100.0  # step of the finite difference for a growing effect
# The monitor's own columns, first in each row: gyro's bias, turn, travel, change of rate.
BIAS, TURN, TRAVEL, CHANGE = range(4)
OWN: Final = 4


@dataclass(frozen=True)
class Hypothesis:
    """An effect, in one of its forms, that a monitor looks for: its columns of the rows, and their units.

    `parameters`: the parameter of each column, whose largest plausible size is in `limits` (SI).
    `growth`: the columns of a growing effect, per second; `angle`: two columns a quarter turn apart.
    """

    effect: Effect | None
    values: Values
    columns: tuple[int, ...]
    growth: tuple[int, ...]
    parameters: tuple[Parameter, ...]
    limits: tuple[float, ...]
    is_positive: bool
    has_end: bool
    text: str = ""

    @property
    def id(self) -> str:
        """The effect's name, or UNKNOWN."""
        return self.effect.id if self.effect is not None else UNKNOWN

    @property
    def angle(self) -> Parameter | None:
        """The phase of an effect that has one."""
        return next((q for q in self.effect.parameters if q.is_angle), None) if self.effect is not None else None


class LiveRows(Motion):
    """The motion of a block's rows, in PARTS each; the temperature's lags have a memory."""

    __slots__ = ("inner", "memory")
    inner: slice
    memory: dict[float, float]

    def temperature_rate_c_s(self, lag_s: float) -> Array:
        """Rate behind a first-order lag, whose state is kept from its first use on; known in the inner parts only."""
        change_c = self.temperature_change_c()
        lagged_c = self.memory.setdefault(lag_s, float(change_c[self.inner][0]))
        found = np.zeros_like(change_c)
        times_s = self.time_s.tolist()
        for k in range(self.inner.start, self.inner.stop):
            kept = math.exp(-(times_s[k] - times_s[k - 1]) / lag_s) if k else 1.0
            lagged_c = lagged_c * kept + float(change_c[k]) * (1.0 - kept)
            found[k] = (change_c[k] - lagged_c) / lag_s
        self.memory[lag_s] = lagged_c
        return found


class Library:
    """Columns of all hypotheses along the rows, for a robot of this tread and wheel radius (m)."""

    def __init__(self, tread_m: float, radius_m: float):
        self._tread_m, self._radius_m = tread_m, radius_m
        self._memory: dict[float, float] = {}
        self._still_c = math.nan
        self._heading_rad = 0.0
        self.hypotheses: list[Hypothesis] = []

    def turns(self, rows: Rows, bias_rad_s: float, share: Array, tread: float) -> tuple[Array, Array]:
        """Turn by the wheels over the nominal tread, and the likeliest turn, (n,) each. (15)

        `share`: weight of the wheels in the likeliest turn; `tread`: effective tread over the nominal one.
        """
        by_wheels = (rows.right_m - rows.left_m) / self._tread_m
        by_gyro = rows.gyro_rad - bias_rad_s * rows.interval_s
        turn = (1.0 - share) * by_gyro + share * by_wheels / tread
        stands = np.maximum(np.abs(rows.left_m), np.abs(rows.right_m)) < STANDS_M
        return by_wheels, np.where(stands, 0.0, turn)

    def columns(self, rows: Rows, turn_rad: Array) -> Array:
        """Sensitivity of the wheels' turn less the gyro's to each column, in the block's rows: (n, columns)."""
        m = self._motion(rows, turn_rad)
        first = not self.hypotheses
        found = [self._row_means(rows, x) for x in self._own(m)]
        if first:
            self.hypotheses = list(self._made(m))
        for hypothesis in self.hypotheses:
            found += self._sensitivities(rows, m, hypothesis)
        self._heading_rad += float(turn_rad[rows.inner].sum())
        return np.column_stack(found)

    # ---- the motion -------------------------------------------------------------------------------------------

    def _motion(self, rows: Rows, turn_rad: Array) -> LiveRows:
        begin_s, middle_s = rows.end_s - rows.interval_s, rows.end_s - 0.5 * rows.interval_s
        parts = (np.arange(PARTS) + 0.5) / PARTS
        time_s = (begin_s[:, None] + rows.interval_s[:, None] * parts).ravel()

        def along(values: Array) -> Array:
            return np.asarray(np.interp(time_s, middle_s, values))

        rate, speed = along(turn_rad / rows.interval_s), along(0.5 * (rows.left_m + rows.right_m) / rows.interval_s)
        half = 0.5 * self._tread_m * rate
        before = turn_rad[: rows.lead].sum()
        heading = self._heading_rad - before + np.cumsum(turn_rad)
        angles = [np.interp(time_s, rows.end_s, total) / self._radius_m
                  for total in (rows.left_total_m, rows.right_total_m)]  # fmt: skip
        temperature_c = along(rows.temperature_c)
        if math.isnan(self._still_c) and not math.isnan(float(temperature_c[0])):
            self._still_c = float(temperature_c[0])
        m = LiveRows(
            time_s, rate, speed, np.gradient(speed, time_s), np.interp(time_s, rows.end_s, heading),
            speed - half, speed + half, angles[0], angles[1], temperature_c, self._still_c, self._tread_m,
            self._radius_m, 1.0,
        )  # fmt: skip
        m.inner, m.memory = slice(PARTS * rows.inner.start, PARTS * rows.inner.stop), self._memory
        return m

    def _row_means(self, rows: Rows, values: Array) -> Array:
        """Means of rates over the parts of each row, times its length: shape (n of the block,)."""
        means = values.reshape(-1, PARTS).mean(axis=1)
        return np.asarray((means * rows.interval_s)[rows.inner])

    def _own(self, m: Motion) -> list[Array]:
        """Columns BIAS, TURN, TRAVEL, CHANGE, as rates. The last: change of the rate by a delay of 10 ms."""
        before = np.interp(m.time_s - 0.01, m.time_s, m.rate_rad_s) - np.interp(m.time_s + 0.01, m.time_s, m.rate_rad_s)
        return [np.ones_like(m.time_s), m.rate_rad_s, m.speed_m_s / m.tread_m, 0.5 * before]

    # ---- hypotheses -------------------------------------------------------------------------------------------

    def _made(self, m: Motion) -> Iterator[Hypothesis]:
        at = OWN
        for effect in catalogue().values():
            if effect.needs_position or effect.symptom is not None:
                continue
            for values in effect.live_variants(m):
                for parameters in _together(effect):
                    count = len(parameters) * (2 if any(q.is_angle for q in effect.parameters) else 1)
                    columns = tuple(range(at, at + count))
                    growing = effect.begins is Begins.GROWING
                    growth = tuple(range(at + count, at + 2 * count)) if growing else ()
                    at += count + len(growth)
                    limits = tuple(_largest(q) for q in parameters) * (count // len(parameters))
                    positive = count == 1 and not parameters[0].signed and not parameters[0].neutral
                    has_end = any(q.name == "t1" for q in effect.parameters)
                    yield Hypothesis(effect, values, columns, growth, parameters, limits, positive, has_end)
        for text, knots in (("the gyro, by its rate", RATES), ("the wheels, by speed", SPEEDS)):
            columns = tuple(range(at, at + len(knots)))
            at += len(knots)
            yield Hypothesis(None, {}, columns, (), (), (FASTEST,) * len(knots), False, False, text)

    def _sensitivities(self, rows: Rows, m: LiveRows, h: Hypothesis) -> list[Array]:
        """Columns of a hypothesis, then those of their growth per second."""
        if h.effect is None:
            speed, knots = (m.rate_rad_s, RATES) if h.text.startswith("the gyro") else (m.speed_m_s, SPEEDS)
            scale = speed if h.text.startswith("the gyro") else speed / m.tread_m
            hats = np.array([np.interp(np.abs(speed), knots, row) for row in np.eye(len(knots))])
            return [self._row_means(rows, scale * hat) for hat in hats]
        found = [self._row_means(rows, self._seen(h.effect.error(m, p), m)) / size for p, size in _units(h)]
        if not h.growth:
            return found
        time_s = m.time_s
        m.time_s = time_s + LATER_S
        later = [self._row_means(rows, self._seen(h.effect.error(m, p), m)) / size for p, size in _units(h)]
        m.time_s = time_s
        return found + [(b - a) / LATER_S for a, b in zip(found, later, strict=True)]

    @staticmethod
    def _seen(e: Errors, m: Motion) -> Array:
        """Share of an effect in the wheels' turn less the gyro's, rad/s. (94)"""
        return np.zeros_like(m.time_s) + (e.right_m_s - e.left_m_s) / m.tread_m - e.gyro_rad_s


def _together(effect: Effect) -> list[tuple[Parameter, ...]]:
    """Parameters that are estimated together: those of either sign; each of the others alone."""
    linear = [q for q in effect.parameters if q.linear and not q.choices]
    if effect.essential:
        linear = [q for q in linear if q.name == effect.essential]  # the others show in the distance only
    if effect.opposed:
        return [tuple(linear[:1])]
    if not linear:
        linear = [q for q in effect.parameters if not q.choices and not q.moment][:1]
    return [tuple(linear)] if all(q.signed for q in linear) else [(q,) for q in linear]


def _largest(q: Parameter) -> float:
    """Largest plausible size, SI, relative to the value without any effect."""
    return abs(q.high - q.neutral) * q.si


def _units(h: Hypothesis) -> Iterator[tuple[Values, float]]:
    """Values of an effect of one parameter alone, and its size, SI."""
    assert h.effect is not None
    none = dict.fromkeys(h.effect.linear(), 0.0)
    if h.effect.opposed:
        left, right = h.effect.linear()
        yield {left: -0.5, right: 0.5}, 1.0
        return
    quarters = (0.0, -0.5 * math.pi) if h.angle is not None else (0.0,)
    for q in h.parameters:
        for quarter in quarters:
            turned: Values = {h.angle.name: quarter} if h.angle is not None else {}
            if q.linear:
                yield {**none, **h.values, q.name: 1.0, **turned}, 1.0
            else:
                yield {**h.values, **turned}, float(h.values[q.name]) - q.neutral
