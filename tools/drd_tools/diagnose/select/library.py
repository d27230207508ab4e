"""Library of candidates: every effect that may be missing, in a few variants each, as columns of one regression."""

import itertools
import math
from dataclasses import dataclass
from typing import Final
from weakref import WeakKeyDictionary

import numpy as np

from drd.arrays import Array
from drd.effects.catalogue import catalogue
from drd.effects.effect import ActsOn, Effect
from drd_tools.diagnose.error_model.linear import COLUMNS, Sensitivity
from drd_tools.diagnose.observe.evidence import Evidence
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.select.intervals import Columns, Intervals, is_of_interval
from drd_tools.diagnose.selected import BIAS, SCALE, Prior, Selected, Values, linear_names

Parameters = dict[str, float | str]
NOTHING: Final[Prior] = {}

ABOVE_NOISE: Final = 1.5  # sigmas of a gyro's sample: required rms of the rates that a dead band hides
MOST_OF_THE_WAY: Final = 0.8  # an effect on more of it is permanent, not one of an interval
LARGEST: Final = 1e16  # sigmas of a row: impossible, and its square would overflow single precision
BIASES: Final = (-1.0, -0.5, 0.0, 0.5, 1.0)  # in sigmas of the datasheet


@dataclass(frozen=True)
class Candidate:
    """A variant of an effect: `names` of its free linear parameters, and their `columns` in the library."""

    effect: Effect
    shape: Parameters
    names: tuple[str, ...]
    columns: tuple[int, ...]
    angle: str
    penalty: float

    @property
    def is_fixed(self) -> bool:
        """Whether it is a threshold or a delay: their form changes with size, so they cannot be scaled."""
        return self.effect.acts_on in (ActsOn.READOUT, ActsOn.TIMING) and self.names == ("",)

    def fitted(self, G: Array, b: Array, measured: Prior = NOTHING) -> tuple[float, Selected | None]:
        """Gain, nats, and fitted parameters, from the products of its columns, G (k, k), and with the data, b (k,)."""
        x = np.asarray(np.linalg.lstsq(G, b, rcond=1e-8)[0], float)
        return 0.5 * float(b @ x), self.selected(x, measured)

    def selected(self, coefficients: Array, measured: Prior = NOTHING) -> Selected | None:
        """The effect with parameters from the regression's coefficients; None if they are implausible."""
        values = dict(self.shape)
        linear = self.effect.linear()
        if self.effect.acts_on is ActsOn.READOUT and not 0.4 < coefficients[0] < 2.5:
            return None
        if self.angle:  # a cos(t - p) = a cos p cos t + a sin p sin t
            values[linear[0]] = math.hypot(*coefficients)
            values[self.angle] = math.atan2(coefficients[1], coefficients[0]) % (2.0 * math.pi)
        elif self.names != ("",):
            values.update(dict.fromkeys(linear, 0.0))
            values.update(zip(self.names, map(float, coefficients), strict=True))
        elif self.effect.acts_on is not ActsOn.READOUT:
            for q in self.effect.parameters:
                if not q.choices and not q.fixed:
                    at = q.neutral * q.si
                    values[q.name] = at + (float(values[q.name]) - at) * float(coefficients[0])
        chosen = linear if self.angle or self.names == ("",) else self.names
        selected = Selected(self.effect, values, chosen + _free_shape(self.effect, values))
        return selected if is_plausible(selected, measured) else None


def _free_shape(effect: Effect, values: Values) -> tuple[str, ...]:
    own = tuple(q.name for q in effect.parameters if not q.linear and not q.choices and not q.fixed)
    return own + ((BIAS.name,) if BIAS.name in values else ())


def is_plausible(selected: Selected, measured: Prior = NOTHING) -> bool:
    """Whether parameters have the right sign and a possible size; around the values, if any, measured otherwise: its
    own prior, or `measured`.
    """
    measured = measured or selected.prior
    for q in selected.effect.parameters:
        if q.choices or q.moment or q.is_angle:
            continue
        value = selected.number(q.name)
        usual, _ = measured.get(q.name, (0.0, 0.0))
        if q.neutral and abs(value / q.si - q.neutral) > 3.0 * abs(q.high - q.neutral):
            return False
        if (not q.signed and value < 0.0) or not abs(value - usual) <= 3.0 * q.high * q.si:
            return False
    if not selected.effect.is_plausible(selected.values):
        return False
    if abs(float(selected.values.get(SCALE.name, 0.0))) > 3.0 * SCALE.high:
        return False
    return selected.interval_s is None or selected.interval_s[1] > selected.interval_s[0]


def is_hidden(problem: Problem, selected: Selected) -> bool:
    """Whether a threshold hides hardly any rate above the gyro's noise: it would then only explain noise."""
    e = problem.evidence
    if selected.effect.acts_on is not ActsOn.READOUT or e.gyro_rad is None:
        return False
    rate_rad_s = problem.sensitivities.calm_rate_rad_s + float(selected.values.get(BIAS.name, 0.0))
    hidden = selected.effect.hidden(rate_rad_s, selected.values)
    if hidden is None:
        return False
    sigma_rad_s = float(np.median(np.sqrt(e.datasheet.gyro(e)) / e.step_s))
    return not (len(hidden) and float(np.sqrt(np.mean(hidden**2))) > ABOVE_NOISE * sigma_rad_s)


def is_everywhere(problem: Problem, selected: Selected) -> bool:
    """Whether its interval covers nearly all of the path: a permanent effect needs no interval."""
    e = problem.evidence
    if not is_of_interval(selected.effect) or selected.interval_s is None:
        return False
    begin_s, end_s = selected.interval_s
    inside = (e.time_s > begin_s) & (e.time_s <= end_s)
    return float(e.travel_m[inside].sum()) > MOST_OF_THE_WAY * float(e.travel_m.sum())


def is_possible(problem: Problem, selected: Selected) -> bool:
    """Whether it is plausible and this recording can show it."""
    return is_plausible(selected) and not is_hidden(problem, selected) and not is_everywhere(problem, selected)


class Library:
    """The candidates of a problem and their whitened columns (r, p); for interval effects, all intervals."""

    def __init__(self, problem: Problem):
        e = problem.evidence
        effects = [x for x in catalogue().values() if x.searched and x.channel in e.channels and not is_absent(e, x)]
        self.candidates: list[Candidate] = []
        self.intervals = [Intervals(problem, effect) for effect in effects if is_of_interval(effect)]
        whitened: list[Columns] = []
        sensitivities: list[Sensitivity] = []
        first = 0
        plain = [effect for effect in effects if not is_of_interval(effect)]
        for effect in plain:
            for shape in variants(problem, effect):
                made, own = columns_of(problem, effect, shape, first + len(sensitivities))
                self.candidates += made
                sensitivities += own
            # In chunks: all sensitivities of 20 minutes at once would take 130 MB.
            if len(sensitivities) >= COLUMNS or effect is plain[-1]:
                whitened.append(problem.whiten(sensitivities, np.float32).astype(np.float32, copy=False))
                first += len(sensitivities)
                sensitivities = []
        for intervals in self.intervals:
            for shape in variants(problem, intervals.effect):
                columns = [intervals.column(shape, name) for name in intervals.names]
                if all(c.any() for c in columns):
                    self.candidates += _candidates(problem, intervals.effect, shape, intervals.names, first)
                    whitened.append(np.column_stack(columns))
                    first += len(columns)
        self.columns = np.concatenate(whitened, axis=1)
        self.columns[:, np.maximum(self.columns.max(axis=0), -self.columns.min(axis=0)) > LARGEST] = 0.0
        self.products: Columns = self.columns.T @ self.columns


def is_absent(e: Evidence, effect: Effect) -> bool:
    """Whether the calibration of a robot far from robot.yaml looked for a delay or drift and found none, or counts all
    delays from this one.

    Changes of its lag, or of the reference's, during a run would be mistaken for one.
    """
    measured = effect.calibrated(e.robot) if e.is_far and effect.acts_on is ActsOn.TIMING else None
    return measured is not None and effect.is_neutral(measured)


def variants(problem: Problem, effect: Effect) -> list[Parameters]:
    """Shapes of an effect from which a search starts."""
    shapes = effect.variants(problem.sensitivities.motion)
    measured = effect.calibrated(problem.evidence.robot)
    if measured is not None and not effect.linear() and not effect.is_neutral(measured):
        shapes = [dict(measured)]
    if effect.acts_on is ActsOn.READOUT:
        sigma = problem.evidence.datasheet.bias_rad_s
        shapes = [{**s, BIAS.name: k * sigma} for s in shapes for k in BIASES]
    return shapes


def columns_of(
    problem: Problem, effect: Effect, shape: Parameters, first: int
) -> tuple[list[Candidate], list[Sensitivity]]:
    """Candidates of a variant, and their sensitivities, the columns from `first` on; none if no sensor shows it."""
    sensitivities = [problem.unit(effect, s, name) for s, name in units_of(effect, shape)]
    if not all(is_seen(s) for s in sensitivities):
        return [], []
    return _candidates(problem, effect, shape, _names(effect), first, _angle(effect)), sensitivities


def units_of(effect: Effect, shape: Parameters) -> list[tuple[Parameters, str]]:
    """Shape and linear parameter of each column of a variant; an effect with an angle has two, 90 degrees apart."""
    names, angle = _names(effect), _angle(effect)
    if angle:
        return [({**shape, angle: p}, names[0]) for p in (0.0, 0.5 * math.pi)]
    return [(shape, name) for name in names]


def _angle(effect: Effect) -> str:
    return next((q.name for q in effect.parameters if q.is_angle), "")


def _names(effect: Effect) -> tuple[str, ...]:
    return linear_names(effect, {SCALE.name: 0.0} if effect.beside else {}) or ("",)


def _candidates(
    problem: Problem, effect: Effect, shape: Parameters, names: tuple[str, ...], first: int, angle: str = ""
) -> list[Candidate]:
    """Candidates of a variant whose columns start at `first`: one for each choice of its parameters."""
    made = []
    for which in [(0, 1)] if angle else choices(effect, names):
        chosen = names if angle else tuple(names[i] for i in which)
        values = {**shape, SCALE.name: 0.0} if SCALE.name in chosen else shape
        count = len(which) + len(_free_shape(effect, values)) - bool(angle)
        penalty = count * problem.per_parameter + problem.per_effect
        made.append(Candidate(effect, values, chosen, tuple(first + i for i in which), angle, penalty))
    return made


def choices(effect: Effect, names: tuple[str, ...]) -> list[tuple[int, ...]]:
    """Subsets of an effect's linear parameters that are meaningful without the others."""
    own = {i for i, name in enumerate(names) if name != SCALE.name}
    return [
        which
        for size in range(1, len(names) + 1)
        for which in itertools.combinations(range(len(names)), size)
        if set(which) & own and (not effect.essential or names.index(effect.essential) in which)
    ]


# Building a library takes as long as a search in it, and the verdict needs it again. It keeps no problem alive.
_MADE: Final[WeakKeyDictionary[Problem, Library]] = WeakKeyDictionary()


def library_of(problem: Problem) -> Library:
    """The problem's library, built once."""
    if problem not in _MADE:
        _MADE[problem] = Library(problem)
    return _MADE[problem]


def release(problem: Problem) -> None:
    """Drop the problem's library, which is large for a long recording."""
    _MADE.pop(problem, None)


def is_seen(sensitivity: Sensitivity) -> bool:
    """Whether any channel is non-zero."""
    return any(isinstance(c, np.ndarray) and bool(np.any(c)) for c in sensitivity.channels)
