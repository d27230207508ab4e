"""The form of a physical effect."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import ClassVar, NamedTuple

import numpy as np

from drd.arrays import Array
from drd.effects.motion import Motion

Values = Mapping[str, float | str]


class Symptom(Enum):
    """Symptom that the raw readings show directly, before any regression."""

    CLIPPED = "readings pile up at the largest rate"
    STOPPED = "a counter stands still while its wheel turns"
    JUMPED = "a counter jumps ahead now and then"
    MUTED = "small rates read exactly zero"


class Begins(Enum):
    """When an effect sets in, and whether it grows."""

    SUDDENLY = "at any moment, and stays"
    GROWING = "at any moment, and grows in proportion to the time since"
    POWER_ON = "from power-on on"


class ActsOn(Enum):
    """Where an effect enters. Effects act in this order and are removed in reverse order."""

    BODY = "body"
    WHEELS = "wheels"
    GYRO = "gyro"
    TIMING = "timing"
    READOUT = "readout"  # acts on the sum of everything before it


@dataclass(frozen=True)
class Parameter:
    """One parameter. Files and reports have it in `unit`, formulas in SI: `si` is the SI value of one unit.

    `low` to `high`, in `unit`, is the plausible range of its magnitude, `signed` whether it may have either sign,
    `neutral` the value without any effect.
    `linear`: the error is proportional to it. `choices`: it is one of these words. `fixed`: a chosen reference point
    (the only variant has it), not estimated: the linear parameters would not be identifiable along with it.
    `moment`: a time of the recording. `initial`: the key of `estimation.initial` that its standard deviation sets.
    """

    name: str
    unit: str
    text: str
    low: float = 0.0
    high: float = 0.0
    si: float = 1.0
    signed: bool = True
    linear: bool = True
    neutral: float = 0.0
    choices: tuple[str, ...] = ()
    fixed: bool = False
    moment: bool = False
    initial: str = ""

    @property
    def is_angle(self) -> bool:
        """Whether it is a phase: two columns a quarter turn apart span all of them."""
        return self.unit == "rad" and not self.linear

    def step(self, at: float) -> float:
        """Step from a value for a numerical derivative, SI."""
        if self.moment:
            return 0.5
        if self.unit in ("rad", "degC"):
            return 1e-3
        return min(max(0.02 * abs(at), self.low * self.si), 0.5 * abs(at) or math.inf)

    def bounded(self, at: float, move: float) -> float:
        """Limit a move from a value, SI, to what a nonlinear form allows."""
        if self.linear:
            return move
        if self.moment:
            return min(max(move, -15.0), 15.0)
        if self.unit == "rad":
            return min(max(move, -0.5), 0.5)
        if not self.signed and self.unit != "degC":
            return min(max(move, -0.5 * abs(at)), abs(at))  # at most halved or doubled
        return move


class Errors(NamedTuple):
    """Errors that an effect adds, as arrays of the motion's shape, or 0.

    They add to the gyro's rate, to the speed that each wheel's counter reports, and to the body's own sideways speed
    (left positive), which no sensor measures.
    """

    gyro_rad_s: Array | float = 0.0
    left_m_s: Array | float = 0.0
    right_m_s: Array | float = 0.0
    lateral_m_s: Array | float = 0.0


class Delays(NamedTuple):
    """How much older than their stamps the samples are, s."""

    gyro_s: float = 0.0
    wheels_s: float = 0.0


class Calibrated(NamedTuple):
    """Constants of a robot, as a calibration measures them.

    Radii and tread over the nominal ones; the wheels' delay behind the motion at time 0, s, and its growth, s/s.
    `by_gyro`: the reference is itself delayed, so that all lags are relative to the gyro; `gyro_lag_s`: the gyro's
    delay behind the wheels, which cannot be early. `gyro_clock`: actual rate of the gyro's samples over the rate at
    which they are stamped.
    """

    left: float = 1.0
    right: float = 1.0
    tread: float = 1.0
    wheels_lag_s: float = 0.0
    lag_growth: float = 0.0
    by_gyro: bool = False
    gyro_lag_s: float = 0.0
    gyro_clock: float = 1.0


NOMINAL = Calibrated()  # as robot.yaml states it


class Chance(NamedTuple):
    """Random draws of a simulated trial, from which effects take their values. Numbers are uniform from 0 to 1."""

    side: str = ""
    begin_s: float = 0.0
    end_s: float = 0.0
    phase: float = 0.0
    period: float = 0.0
    pitch: float = 0.0
    settling: float = 0.0
    lag: float = 0.0
    speed: float = 0.0
    large: float = 0.0
    small: float = 0.0


class Effect:
    """One physical effect. Its class docstring says in one sentence what it is.

    `covariate`: the variable on which it depends; `proportional`: in proportion, by geometry, so that a fit over some
    range holds beyond it and for the other sign (not so slip, which saturates). `manoeuvre`: the drive that excites it
    best. `remainder`: largest share of it left after correction, on samples at 10 and 20 Hz; `irreversible`: why it
    cannot be corrected, or empty. `lasting`: its parameters still hold in the next run. `beside`: an effect of one
    parameter, up to which its form is known. `essential`: the linear parameter without which it is another effect.
    `uneven`: it makes a counter uneven within a turn, without changing how far the wheel turns.

    For the diagnosis. `symptom`: what raw readings show of it; `searched`: whether a regression also looks for it.
    `geometry`: it changes the wheels' speeds, and other effects on the wheels act on the changed ones.
    `repeats`: it may occur more than once; `recurs`: a new drive can show it again. `needs_wheels`: why it cannot be
    identified without wheels, or empty. `caveat`: a sentence on what looks the same; `advice`: one on the drive that is
    to show it, in which `{from_s}` is when an interval of other ground begins.

    For a monitor on the robot. `begins`: how it sets in; `needs_position`: why gyro and wheels alone do not show it, or
    empty; `opposed`: without a position, only the difference of its two parameters shows.
    """

    id: ClassVar[str]
    acts_on: ClassVar[ActsOn]
    formula: ClassVar[str]
    source: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]]
    covariate: ClassVar[str]
    proportional: ClassVar[bool] = False
    manoeuvre: ClassVar[str]
    remainder: ClassVar[float] = 0.05
    irreversible: ClassVar[str] = ""
    lasting: ClassVar[bool] = True
    beside: ClassVar["Effect | None"] = None
    essential: ClassVar[str] = ""
    uneven: ClassVar[bool] = False
    symptom: ClassVar[Symptom | None] = None
    searched: ClassVar[bool] = True
    geometry: ClassVar[bool] = False
    repeats: ClassVar[bool] = False
    recurs: ClassVar[bool] = True
    needs_wheels: ClassVar[str] = ""
    caveat: ClassVar[str] = ""
    advice: ClassVar[str] = ""
    begins: ClassVar[Begins] = Begins.SUDDENLY
    needs_position: ClassVar[str] = ""
    opposed: ClassVar[bool] = False

    @property
    def sentence(self) -> str:
        """The class docstring as one line, for humans."""
        return " ".join((self.__doc__ or "").split())

    def error(self, m: Motion, p: Values) -> Errors:
        """Errors added to the motion's channels. The only place of the formula."""
        raise NotImplementedError

    def correction(self, m: Motion, p: Values) -> Errors:
        """Errors to subtract from a live sample; `m` is the motion without this effect, of shape (1,)."""
        return self.error(m, p)

    def delays(self, time_s: float, p: Values) -> Delays:
        """Delays to subtract from the stamps."""
        return Delays()

    def variants(self, m: Motion) -> list[dict[str, float | str]]:
        """Values (SI) of the nonlinear parameters among which the diagnosis chooses first."""
        return [{}]

    def live_variants(self, m: Motion) -> list[dict[str, float | str]]:
        """Values (SI) of the nonlinear parameters, for a monitor: the same at any time of a run.

        Without linear parameters they include the size: small, so that the error is proportional to it.
        """
        return self.variants(m)

    def other_shapes(self, m: Motion, p: Values | None = None) -> list[Errors]:
        """Other forms that the same cause may have, of any size: the catalogue's form is never exact.

        They lie near the nonlinear parameters `p`; without `p`, near the middle variant.
        """
        variants = self.variants(m)
        return self.shapes(m, variants[len(variants) // 2] if p is None else p)

    def shapes(self, m: Motion, p: Values) -> list[Errors]:
        """Forms for `other_shapes`; each effect has its own."""
        return []

    def clipped(self, rate_rad_s: Array, p: Values) -> Array:
        """Readings (n,) of the gyro, noise included, limited to the range of its output."""
        return rate_rad_s

    def hidden(self, rate_rad_s: Array, p: Values) -> Array | None:
        """The rates among (n,) that leave no trace in the reading; None: this effect has no threshold."""
        return None

    def lag_s(self, p: Values) -> float:
        """Time constant of the lag of its covariate; 0: no lag."""
        return 0.0

    def absorbed(self, p: Values, k: float) -> Values | None:
        """Parameters with which the effect includes that of `beside` at `k`; None where it cannot."""
        return None

    def shown(self, side: str = "", begin_s: float = 0.0, end_s: float = 0.0, size: float = 0.0) -> Values:
        """Parameters of the effect that `symptom` shows: which wheel, from when until when, and its size, SI."""
        raise NotImplementedError

    def calibrated(self, constants: Calibrated) -> Values | None:
        """Parameters (SI) for a robot with these constants; None where they say nothing about this effect."""
        return None

    def is_neutral(self, p: Values) -> bool:
        """Whether it does nothing with these parameters, none of which is a choice."""
        return all(p[q.name] == q.neutral for q in self.parameters)

    def is_plausible(self, p: Values) -> bool:
        """Whether parameters that are plausible one by one are plausible together."""
        return True

    def relative_tread(self, p: Values) -> float:
        """Effective tread over the one that robot.yaml states."""
        return 1.0

    def drawn(self, m: Motion, chance: Chance) -> Values:
        """Values (SI) of the nonlinear parameters, for a simulated trial along a motion."""
        found: dict[str, float | str] = {SIDE.name: chance.side, START.name: chance.begin_s, END.name: chance.end_s}
        return {q.name: found[q.name] for q in self.parameters if q.name in found}

    @property
    def channel(self) -> str:
        """Channel of the error, also where it acts on timing or readout: gyro, wheels or body."""
        if self.acts_on is ActsOn.BODY:
            return "body"
        return "gyro" if self.id.startswith("gyro_") else "wheels"

    @property
    def is_diagnosed(self) -> bool:
        """Whether a diagnosis may name it: from a regression, or from raw readings."""
        return self.searched or self.symptom is not None

    def linear(self) -> tuple[str, ...]:
        """Names of the linear parameters."""
        return tuple(q.name for q in self.parameters if q.linear and not q.choices)


def number(p: Values, name: str) -> float:
    """A numeric parameter."""
    return float(p[name])


def largest(values: Array) -> float:
    """Largest magnitude; never zero, so that one can divide by it."""
    return max(float(np.max(np.abs(values))), 1e-9)


def on_side(p: Values, values: Array) -> Errors:
    """Errors with `values` for the wheel that `side` names."""
    return Errors(left_m_s=values) if p["side"] == "left" else Errors(right_m_s=values)


def of_side(m: Motion, p: Values) -> Array:
    """Speed of the wheel that `side` names."""
    return m.left_m_s if p["side"] == "left" else m.right_m_s


def substitute(m: Motion, p: Values) -> Array:
    """The same from the other wheel and the gyro, where a counter no longer reports it."""
    across = m.tread_m * m.rate_rad_s
    return m.right_m_s - across if p["side"] == "left" else m.left_m_s + across


def both(m: Motion, share: Array | float) -> Errors:
    """Errors of the same share of each wheel's speed."""
    return Errors(left_m_s=share * m.left_m_s, right_m_s=share * m.right_m_s)


def apart(m: Motion, share: Array | float) -> Errors:
    """Errors of a share of the wheels' speed difference, as another tread causes them."""
    half = share * 0.5 * (m.right_m_s - m.left_m_s)
    return Errors(left_m_s=-half, right_m_s=half)


def windows(m: Motion, parts: int, step: float = 1.0) -> list[dict[str, float | str]]:
    """Windows of 1/`parts` of the motion, each `step` windows after the one before, as `t0` and `t1`."""
    begin_s, length_s = float(m.time_s[0]), (m.end_s - float(m.time_s[0])) / parts
    count = int((parts - 1) / step) + 1
    starts_s = [begin_s + k * step * length_s for k in range(count)]
    return [{"t0": start_s, "t1": start_s + length_s} for start_s in starts_s]


def since_ever() -> dict[str, float | str]:
    """The unbounded window, as `t0` and `t1`."""
    return {START.name: -math.inf, END.name: math.inf}


def window(time_s: Array, start_s: float, end_s: float) -> Array:
    """1 from `start_s` until `end_s`, else 0."""
    return ((time_s >= start_s) & (time_s < end_s)).astype(float)


SIDES = ("left", "right")


def between(low: float, high: float, share: float) -> float:
    """The value a share of the way from `low` to `high`."""
    return low + (high - low) * share


def between_logs(low: float, high: float, share: float) -> float:
    """The same on a logarithmic scale."""
    return float(np.exp(between(float(np.log(low)), float(np.log(high)), share)))


SIDE = Parameter("side", "", "which wheel", linear=False, choices=SIDES)
START = Parameter("t0", "s", "start of the interval", 0.0, 1e6, signed=False, linear=False, moment=True)
END = Parameter("t1", "s", "end of the interval", 0.0, 1e6, signed=False, linear=False, moment=True)
