"""Sensor readings of effects, changed by the selected geometry before them and the wheels' delays after them. (73)"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
import numpy.typing as npt

from drd.arrays import Array, cumulative
from drd.effects.catalogue import acting_order
from drd.effects.chain import geometry
from drd.effects.effect import ActsOn, Begins, Delays, Effect, Errors
from drd.effects.motion import Motion
from drd_tools.diagnose.error_model.linear import Sensitivity
from drd_tools.diagnose.error_model.sensitivities import Change, Sensitivities
from drd_tools.diagnose.selected import BIAS, SCALE, Selected, Values

NODES: Final = 4  # of a cubic


def chain_of(selection: Sequence[Selected]) -> tuple[Selected, ...]:
    """Selected effects that change how others act, in the order in which they act: geometry, and delays."""
    chained = (c for c in selection if c.effect.geometry or _is_delay(c.effect))
    return tuple(sorted(chained, key=lambda c: acting_order(c.effect)))


def _is_delay(effect: Effect) -> bool:
    return effect.acts_on is ActsOn.TIMING and effect.channel == "wheels"


def has_clock(chain: Sequence[Selected]) -> bool:
    """Whether a chain contains a clock error of the wheels."""
    return any(_is_delay(c.effect) and c.effect.begins is Begins.GROWING for c in chain)


def delays_s(selection: Sequence[Selected], at_s: Array) -> tuple[Array, Array]:
    """Ages of the gyro's and the wheels' samples stamped `at_s` (n,): clocks drift linearly."""
    ends_s = at_s[[0, -1]]
    of_ends = [[c.effect.delays(float(t), c.values) for c in selection] for t in ends_s]
    gyro, wheels = ([sum(getattr(d, name) for d in delays) for delays in of_ends] for name in Delays._fields)
    return np.interp(at_s, ends_s, gyro), np.interp(at_s, ends_s, wheels)


def stamped_later_s(delay_s: Array, at_s: Array) -> Array:
    """Delay of the stamp of an event at `at_s` (n,), given the age `delay_s` (n,) of samples stamped at `at_s`.

    The two differ by 0.15 s after 170 s for a clock that is 3 % off.
    """
    growth = float((delay_s[-1] - delay_s[0]) / (at_s[-1] - at_s[0]))
    return delay_s / (1.0 - growth)


def beside(effect: Effect, motion: Motion, size: float) -> Errors:
    """Errors, at a given size, of the linear effect up to which this effect's form is determined."""
    assert effect.beside is not None
    return effect.beside.error(motion, {effect.beside.parameters[0].name: size})


def _with(motion: Motion, chain: Sequence[Selected]) -> Motion:
    """The motion with these effects applied to the wheels' speeds, one after the other; angles are as counted."""
    for c in chain:
        error = c.effect.error(motion, c.values)
        left, right = motion.left_m_s + error.left_m_s, motion.right_m_s + error.right_m_s
        motion = replace(motion, left_m_s=left, right_m_s=right)
    return motion


@dataclass(frozen=True)
class _Late:
    """Delayed samples of a sum: each combines the sum at the edges `first` to first + 3 with `weights` (4, n + 1).

    Lagrange's cubic: linear interpolation would reduce an oscillation of 1 rad per step by a tenth.
    """

    first: npt.NDArray[np.intp]
    weights: Array

    @classmethod
    def by(cls, delay_s: Array, edges_s: Array) -> "_Late | None":
        """Delay by `delay_s` (n + 1,) at each edge; None if all are 0. The sum is 0 before the first edge."""
        if not np.any(delay_s):
            return None
        at_s = np.clip(edges_s - delay_s, edges_s[0], edges_s[-1])
        first = np.clip(np.searchsorted(edges_s, at_s) - 2, 0, len(edges_s) - NODES)
        nodes_s = edges_s[first + np.arange(NODES)[:, None]]
        weights = np.ones_like(nodes_s)
        for j, k in itertools.permutations(range(NODES), 2):
            weights[j] *= (at_s - nodes_s[k]) / (nodes_s[j] - nodes_s[k])
        return cls(first, weights)

    def __call__(self, increments: Array | float) -> Array | float:
        """Increments (n,) of the delayed samples of the sum of `increments` (n,), which may also be 0."""
        if not isinstance(increments, np.ndarray):
            return increments
        total = cumulative(increments)
        late: Array = np.sum([weight * total[self.first + j] for j, weight in enumerate(self.weights)], axis=0)
        return np.diff(late)


class Readings:
    """Sensor readings of a motion, and of effects along it, with a chain's geometry and wheel delays."""

    def __init__(self, sensitivities: Sensitivities, chain: Sequence[Selected] = ()):
        self.sensitivities, self.chain = sensitivities, tuple(chain)
        edges_s = sensitivities.e.edges_s
        self._late = _Late.by(delays_s([c for c in chain if _is_delay(c.effect)], edges_s)[1], edges_s)

    def along(self, change: Change, is_read: bool = False) -> "Readings":
        """The readings along the changed motion; `is_read`: the change turns the motion into the sensors' readings."""
        return Readings(self.sensitivities.along(change), () if is_read else self.chain)

    @cached_property
    def motion(self) -> Motion:
        """The motion, with the wheels' speeds as counted with the chain's geometry."""
        return _with(self.sensitivities.motion, [c for c in self.chain if c.effect.geometry])

    def without_geometry(self, left_m: Array, right_m: Array) -> Array:
        """Travel (2, n) of the wheels that their counters report, with the chain's geometry, as `left_m`, `right_m`."""
        G = geometry(self.sensitivities.motion, [(c.effect, c.values) for c in self.chain if c.effect.geometry])
        return np.asarray(np.linalg.solve(G, [left_m, right_m]), float)

    def of_wheels(self, effect: Effect | None = None) -> Motion:
        """The motion as counted, with the part of the chain before an effect, or with the whole chain."""
        if effect is not None and effect.acts_on is ActsOn.WHEELS and not effect.geometry:
            return self.motion
        before = [c for c in self.chain if effect is None or acting_order(c.effect) < acting_order(effect)]
        motion = self.sensitivities.sharp if effect is None else self.sensitivities.motion_of(effect)
        return _with(motion, before)

    def sensitivity(self, effect: Effect, values: Values) -> Sensitivity:
        """Sensitivity to an effect with these parameters."""
        motion = self.of_wheels(effect) if effect.channel == "wheels" else self.sensitivities.motion_of(effect)
        if effect.acts_on is ActsOn.READOUT:
            calm = self.sensitivities.calm_rate_rad_s
            motion = replace(motion, rate_rad_s=calm + float(values.get(BIAS.name, 0.0)))
        errors = effect.error(motion, values)
        if SCALE.name in values:
            other = beside(effect, motion, float(values[SCALE.name]))
            errors = errors._replace(gyro_rad_s=errors.gyro_rad_s + other.gyro_rad_s)
        return self.of(effect, errors)

    def of(self, effect: Effect, errors: Errors) -> Sensitivity:
        """Sensitivity to an effect's errors, delayed where delays come after it.

        The geometry's error is not delayed: the delay's own error already includes it.
        """
        made = self.sensitivities.of(errors)
        return self.delayed(made) if effect.acts_on is ActsOn.WHEELS and not effect.geometry else made

    def delayed(self, made: Sensitivity) -> Sensitivity:
        """Delay the wheels' increments by the chain's delays."""
        if self._late is None:
            return made
        return replace(made, left_m=self._late(made.left_m), right_m=self._late(made.right_m))
