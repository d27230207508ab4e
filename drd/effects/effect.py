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
    """What a look at the raw readings shows by logic, before any regression."""

    CLIPPED = "readings pile up at the largest rate"
    STOPPED = "a counter stands still while its wheel turns"
    JUMPED = "a counter jumps ahead now and then"
    MUTED = "small rates read exactly zero"


class Begins(Enum):
    """How an effect is there while a robot drives."""

    SUDDENLY = "at any moment, and stays"
    GROWING = "at any moment, and grows in proportion to the time since"
    POWER_ON = "from power-on on"


class ActsOn(Enum):
    """Where an effect enters. Effects act in this order; they are taken off in the reverse one."""

    BODY = "body"
    WHEELS = "wheels"
    GYRO = "gyro"
    TIMING = "timing"
    READOUT = "readout"  # what becomes of the sum of everything before


@dataclass(frozen=True)
class Parameter:
    """One parameter. Files and reports have it in `unit`, formulas in SI: `si` is the SI value of one unit.

    `low` to `high`, in `unit`, is the plausible range of its size, `signed` whether it comes with either sign,
    `neutral` the value without any effect.
    `linear`: the error is proportional to it. `choices`: it is one of these words. `fixed`: a reference point that is
    chosen (the only variant has it), not estimated: together with it the linear parameters would not be determined.
    `moment`: a time of the recording. `initial`: the key of `estimation.initial` that its standard deviation is one of.
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
        """A phase: two columns a quarter turn apart make any of it."""
        return self.unit == "rad" and not self.linear

    def step(self, at: float) -> float:
        """A step off a value, SI, for a numerical derivative."""
        if self.moment:
            return 0.5
        if self.unit in ("rad", "degC"):
            return 1e-3
        return min(max(0.02 * abs(at), self.low * self.si), 0.5 * abs(at) or math.inf)

    def bounded(self, at: float, move: float) -> float:
        """A move off a value, SI, no longer than a form that is not linear allows."""
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
    """What an effect adds, as arrays of the motion's shape, or 0.

    To the gyro's rate, to the speed that each wheel's counter tells, and to the body's own sideways speed (left
    positive), which no sensor tells.
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

    Radii and tread over those believed; how much later than its motion the wheels tell it at time 0, s, and by how much
    that grows, s/s. `by_gyro`: the reference is late by itself, so that all lags are counted from the gyro;
    `gyro_lag_s`: how much later than the wheels that is, which cannot be early. `gyro_clock`: actual rate of the gyro's
    samples over that by which they are stamped.
    """

    left: float = 1.0
    right: float = 1.0
    tread: float = 1.0
    wheels_lag_s: float = 0.0
    lag_growth: float = 0.0
    by_gyro: bool = False
    gyro_lag_s: float = 0.0
    gyro_clock: float = 1.0


NOMINAL = Calibrated()  # as robot.yaml has it


class Chance(NamedTuple):
    """What a simulated trial has drawn, for effects to take their values from. Numbers are uniform from 0 to 1."""

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

    `covariate` is the variable that it depends on; `proportional`: to which it is by geometry, so that what was seen
    over a range holds beyond it and with the other sign, as no slip does, which saturates. `manoeuvre` is the drive
    that shows it best. `remainder` is the largest share of itself that its removal leaves behind on samples at 10 and
    20 Hz; `irreversible` says why it cannot be undone, or is empty. `lasting`: its parameters still hold in the next
    run. `beside`: an effect of one parameter, up to which alone its form is known. `essential`: the linear parameter
    without which it is another effect. `uneven`: it makes a counter uneven within a turn; the wheel turns no less.

    For the diagnosis. `symptom`: what raw readings show of it; `searched`: whether a regression looks for it besides.
    `geometry`: it makes other speeds of the wheels, and what acts on the wheels besides acts on those.
    `repeats`: it may be there more than once; `recurs`: it comes again for the asking. `needs_wheels`: why nothing is
    known of it without them, or empty. `caveat`: what looks the same, a sentence; `advice`: one for the drive that is
    to show it, in which `{from_s}` is when an interval of other ground begins.

    For a monitor on the robot. `begins`: how it comes; `needs_position`: why gyro and wheels alone do not show it, or
    empty; `opposed`: of its two parameters only the difference shows without a position.
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
        """What it is, for humans."""
        return " ".join((self.__doc__ or "").split())

    def error(self, m: Motion, p: Values) -> Errors:
        """What it adds to the motion's channels. The one home of the formula."""
        raise NotImplementedError

    def correction(self, m: Motion, p: Values) -> Errors:
        """What is to be subtracted from a live sample, `m` being the motion without this effect, of shape (1,)."""
        return self.error(m, p)

    def delays(self, time_s: float, p: Values) -> Delays:
        """What is to be subtracted from the stamps."""
        return Delays()

    def variants(self, m: Motion) -> list[dict[str, float | str]]:
        """Values (SI) of the parameters that are not linear, between which the diagnosis is to choose first."""
        return [{}]

    def live_variants(self, m: Motion) -> list[dict[str, float | str]]:
        """Values (SI) of the parameters that are not linear, for a monitor: the same at any time of a run.

        Without linear parameters the size is in them: small, so that the error is in proportion to it.
        """
        return self.variants(m)

    def other_shapes(self, m: Motion, p: Values | None = None) -> list[Errors]:
        """Other forms that the same cause may have, of any size: the catalogue's form is always a bit wrong.

        Those near the parameters `p` that are not linear; without `p`, near the middle one of the variants.
        """
        variants = self.variants(m)
        return self.shapes(m, variants[len(variants) // 2] if p is None else p)

    def shapes(self, m: Motion, p: Values) -> list[Errors]:
        """What `other_shapes` gives; each effect has its own."""
        return []

    def clipped(self, rate_rad_s: Array, p: Values) -> Array:
        """Readings (n,) of the gyro, noise included, as far as its output can tell them."""
        return rate_rad_s

    def hidden(self, rate_rad_s: Array, p: Values) -> Array | None:
        """Those of the rates (n,) that leave no trace in the reading; None: a threshold is no part of this effect."""
        return None

    def lag_s(self, p: Values) -> float:
        """Time constant behind which its covariate is felt; 0: at once."""
        return 0.0

    def absorbed(self, p: Values, k: float) -> Values | None:
        """Parameters with which the effect does what `beside` does with `k`, too; None where it cannot."""
        return None

    def shown(self, side: str = "", begin_s: float = 0.0, end_s: float = 0.0, size: float = 0.0) -> Values:
        """Parameters of what `symptom` shows: of which wheel, from when until when, and how large, SI."""
        raise NotImplementedError

    def calibrated(self, constants: Calibrated) -> Values | None:
        """Parameters (SI) of a robot with these constants; None where they say nothing of this effect."""
        return None

    def is_neutral(self, p: Values) -> bool:
        """Whether it does nothing with these parameters, none of which is a choice."""
        return all(p[q.name] == q.neutral for q in self.parameters)

    def is_plausible(self, p: Values) -> bool:
        """Whether parameters that are each of a plausible size are so together, too."""
        return True

    def relative_tread(self, p: Values) -> float:
        """Effective tread over the one that robot.yaml states."""
        return 1.0

    def drawn(self, m: Motion, chance: Chance) -> Values:
        """Values (SI) of the parameters that are not linear, for a simulated trial along a motion."""
        found: dict[str, float | str] = {SIDE.name: chance.side, START.name: chance.begin_s, END.name: chance.end_s}
        return {q.name: found[q.name] for q in self.parameters if q.name in found}

    @property
    def channel(self) -> str:
        """Whose error it is, also where it acts on the timing or the readout: gyro, wheels or body."""
        if self.acts_on is ActsOn.BODY:
            return "body"
        return "gyro" if self.id.startswith("gyro_") else "wheels"

    @property
    def is_diagnosed(self) -> bool:
        """Whether a diagnosis may name it: by a regression, or by what raw readings show."""
        return self.searched or self.symptom is not None

    def linear(self) -> tuple[str, ...]:
        """Names of the linear parameters."""
        return tuple(q.name for q in self.parameters if q.linear and not q.choices)


def number(p: Values, name: str) -> float:
    """A parameter that is a number."""
    return float(p[name])


def largest(values: Array) -> float:
    """Of their sizes; not zero, so that one can divide by it."""
    return max(float(np.max(np.abs(values))), 1e-9)


def on_side(p: Values, values: Array) -> Errors:
    """Errors of the wheel that `side` names."""
    return Errors(left_m_s=values) if p["side"] == "left" else Errors(right_m_s=values)


def of_side(m: Motion, p: Values) -> Array:
    """Speed of the wheel that `side` names."""
    return m.left_m_s if p["side"] == "left" else m.right_m_s


def substitute(m: Motion, p: Values) -> Array:
    """The same from the other wheel and the gyro, for what a counter no longer tells."""
    across = m.tread_m * m.rate_rad_s
    return m.right_m_s - across if p["side"] == "left" else m.left_m_s + across


def both(m: Motion, share: Array | float) -> Errors:
    """Errors by one share of each wheel's speed."""
    return Errors(left_m_s=share * m.left_m_s, right_m_s=share * m.right_m_s)


def apart(m: Motion, share: Array | float) -> Errors:
    """Errors by a share of the difference of the wheels' speeds, as another tread gives them."""
    half = share * 0.5 * (m.right_m_s - m.left_m_s)
    return Errors(left_m_s=-half, right_m_s=half)


def windows(m: Motion, parts: int, step: float = 1.0) -> list[dict[str, float | str]]:
    """Windows of a `parts`-th of the motion, each `step` of a window after the one before, as `t0` and `t1`."""
    begin_s, length_s = float(m.time_s[0]), (m.end_s - float(m.time_s[0])) / parts
    count = int((parts - 1) / step) + 1
    starts_s = [begin_s + k * step * length_s for k in range(count)]
    return [{"t0": start_s, "t1": start_s + length_s} for start_s in starts_s]


def since_ever() -> dict[str, float | str]:
    """The window that has no end, as `t0` and `t1`."""
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
