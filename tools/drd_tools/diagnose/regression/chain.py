"""Sensors' readings of effects: through the geometry before them, and behind the wheels' delays after them. (73)"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
import numpy.typing as npt

from drd.effects.catalogue import catalogue
from drd.effects.effect import ActsOn, Begins, Delays, Effect, Errors
from drd.effects.motion import Motion
from drd_tools.diagnose.error_model.linear import Sensitivity
from drd_tools.diagnose.error_model.sensitivities import Change, Sensitivities
from drd_tools.diagnose.results import Array
from drd_tools.diagnose.selected import BIAS, SCALE, Selected, Values

NODES: Final = 4  # of a cubic


def chain_of(selection: Sequence[Selected]) -> tuple[Selected, ...]:
    """The selected effects on whose outcome others act, in the order in which they act: geometry, and delays."""
    order = list(catalogue())
    chained = (c for c in selection if c.effect.geometry or _is_delay(c.effect))
    return tuple(sorted(chained, key=lambda c: order.index(c.id)))


def _is_delay(effect: Effect) -> bool:
    return effect.acts_on is ActsOn.TIMING and effect.channel == "wheels"


def has_clock(chain: Sequence[Selected]) -> bool:
    """Whether a clock of the wheels is among the effects of a chain."""
    return any(_is_delay(c.effect) and c.effect.begins is Begins.GROWING for c in chain)


def delays_s(selection: Sequence[Selected], at_s: Array) -> tuple[Array, Array]:
    """How old the gyro's and the wheels' samples are that are stamped `at_s` (n,): clocks drift along a line."""
    ends_s = at_s[[0, -1]]
    of_ends = [[c.effect.delays(float(t), c.values) for c in selection] for t in ends_s]
    gyro, wheels = ([sum(getattr(d, name) for d in delays) for delays in of_ends] for name in Delays._fields)
    return np.interp(at_s, ends_s, gyro), np.interp(at_s, ends_s, wheels)


def stamped_later_s(delay_s: Array, at_s: Array) -> Array:
    """How much later what was at `at_s` (n,) is stamped, where samples so stamped are `delay_s` (n,) old.

    Of a clock that is 3 % off that is another 0.15 s after 170 s.
    """
    growth = float((delay_s[-1] - delay_s[0]) / (at_s[-1] - at_s[0]))
    return delay_s / (1.0 - growth)


def beside(effect: Effect, motion: Motion, size: float) -> Errors:
    """Errors, at a size, of the effect beside which alone another's form is known."""
    assert effect.beside is not None
    return effect.beside.error(motion, {effect.beside.parameters[0].name: size})


def _with(motion: Motion, chain: Sequence[Selected]) -> Motion:
    """The motion with the wheels' speeds on which these effects have acted, one after the other; angles are counted."""
    for c in chain:
        error = c.effect.error(motion, c.values)
        left, right = motion.left_m_s + error.left_m_s, motion.right_m_s + error.right_m_s
        motion = replace(motion, left_m_s=left, right_m_s=right)
    return motion


@dataclass(frozen=True)
class _Late:
    """Samples of a sum that are late: each is the sum's at the edges `first` to first + 3, times `weights` (4, n + 1).

    Lagrange's cubic: a line between two would take a tenth off what turns by 1 rad in a step.
    """

    first: npt.NDArray[np.intp]
    weights: Array

    @classmethod
    def by(cls, delay_s: Array, edges_s: Array) -> "_Late | None":
        """By `delay_s` (n + 1,) at each edge; None where that is 0. Before the first edge nothing was summed."""
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
        """The `increments` (n,), or 0, that late samples of their sum make."""
        if not isinstance(increments, np.ndarray):
            return increments
        total = np.concatenate([[0.0], np.cumsum(increments)])
        late: Array = np.sum([weight * total[self.first + j] for j, weight in enumerate(self.weights)], axis=0)
        return np.diff(late)


class Readings:
    """Sensors' readings of a motion, and of effects along it, with the geometry and the wheels' delays of a chain."""

    def __init__(self, sensitivities: Sensitivities, chain: Sequence[Selected] = ()):
        self.sensitivities, self.chain = sensitivities, tuple(chain)
        edges_s = sensitivities.e.edges_s
        self._late = _Late.by(delays_s([c for c in chain if _is_delay(c.effect)], edges_s)[1], edges_s)

    def along(self, change: Change, is_read: bool = False) -> "Readings":
        """The same of the motion changed so; `is_read`: into what sensors tell of it."""
        return Readings(self.sensitivities.along(change), () if is_read else self.chain)

    @cached_property
    def motion(self) -> Motion:
        """The motion, with the wheels' speeds as counters of the chain's geometry tell them."""
        return _with(self.sensitivities.motion, [c for c in self.chain if c.effect.geometry])

    def of_wheels(self, effect: Effect | None = None) -> Motion:
        """The motion as counters tell it, with all of the chain that comes before an effect, or with all of it."""
        if effect is not None and effect.acts_on is ActsOn.WHEELS and not effect.geometry:
            return self.motion
        order = list(catalogue())
        before = [c for c in self.chain if effect is None or order.index(c.id) < order.index(effect.id)]
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
        """Sensitivity to errors that an effect makes, behind the delays that come after it.

        A delay's own error has the geometry's in it, which is not delayed itself.
        """
        made = self.sensitivities.of(errors)
        return self.delayed(made) if effect.acts_on is ActsOn.WHEELS and not effect.geometry else made

    def delayed(self, made: Sensitivity) -> Sensitivity:
        """With the wheels' increments as late as the chain's delays make them."""
        if self._late is None:
            return made
        return replace(made, left_m=self._late(made.left_m), right_m=self._late(made.right_m))
