"""A selected effect with its parameters."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from drd.arrays import Array
from drd.effects.effect import END, START, ActsOn, Effect, Parameter

Values = Mapping[str, float | str]
Prior = Mapping[str, tuple[float, float]]  # mean and standard deviation of parameters, SI

# Parameters besides an effect's own: the gyro's bias if the effect acts on the sum of rate and bias (rad/s), and a
# constant scale error if the form is determined only up to one.
BIAS: Final = Parameter("bias", "rad/s", "the gyro's own bias", 1e-6, 1e-2, linear=False)
SCALE: Final = Parameter("scale", "1", "a constant scale error beside it", 1e-5, 0.05)


@dataclass(frozen=True)
class Selected:
    """An effect with parameters, SI. `free`: the names of the fitted ones, `covariance` (k, k): theirs.

    `prior`: mean and standard deviation of parameters measured independently.
    """

    effect: Effect
    values: Values
    free: tuple[str, ...]
    covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))
    prior: Prior = field(default_factory=dict)

    @property
    def id(self) -> str:
        """The effect's name."""
        return self.effect.id

    @property
    def is_timing(self) -> bool:
        """Whether it is a delay or a clock's rate."""
        return self.effect.acts_on is ActsOn.TIMING

    def number(self, name: str) -> float:
        """Value of a numerical parameter."""
        return float(self.values[name])

    def sigma(self, name: str) -> float:
        """Standard deviation of a parameter; 0 if it was not fitted."""
        if name not in self.free or not self.covariance.size:
            return 0.0
        i = self.free.index(name)
        return math.sqrt(max(float(self.covariance[i, i]), 0.0))

    def parameter(self, name: str) -> Parameter:
        """Description of one of its parameters."""
        return parameter(self.effect, name)

    @property
    def beside(self) -> Effect | None:
        """The linear effect that was fitted together with it, of size SCALE, unless its own parameters absorb that."""
        is_separate = SCALE.name in self.values and self.effect.absorbed(self.values, 0.0) is None
        return self.effect.beside if is_separate else None

    @property
    def begin_s(self) -> float | None:
        """Time from which it acts; None if it acts from the start."""
        return self.number(START.name) if START.name in self.values else None

    @property
    def end_s(self) -> float | None:
        """Time until which it acts; None if it acts to the end."""
        return self.number(END.name) if END.name in self.values else None

    @property
    def interval_s(self) -> tuple[float, float] | None:
        """Interval of time in which it acts; None if it has no start or no end."""
        begin_s, end_s = self.begin_s, self.end_s
        return None if begin_s is None or end_s is None else (begin_s, end_s)


def parameter(effect: Effect, name: str) -> Parameter:
    """The description of a parameter by its name."""
    for q in (*effect.parameters, BIAS, SCALE):
        if q.name == name:
            return q
    raise KeyError(name)


def linear_names(effect: Effect, values: Values) -> tuple[str, ...]:
    """The linear parameters, including the additional scale error if present."""
    return effect.linear() + ((SCALE.name,) if SCALE.name in values else ())


def shape_of(effect: Effect, values: Values) -> dict[str, float | str]:
    """The nonlinear parameters, which determine the shape."""
    linear = linear_names(effect, values)
    return {name: value for name, value in values.items() if name not in linear}
