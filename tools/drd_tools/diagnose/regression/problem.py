"""One recording as a regression: whitened data, nuisances, and sensitivities of effects at any parameters."""

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from drd.arrays import Array
from drd.effects.catalogue import catalogue
from drd.effects.effect import Effect
from drd_tools.diagnose.error_model.linear import Linear, Sensitivity
from drd_tools.diagnose.error_model.nominal_path import follow, inflated_model
from drd_tools.diagnose.error_model.path import Path
from drd_tools.diagnose.error_model.sensitivities import Change, Sensitivities, nuisances
from drd_tools.diagnose.observe.evidence import Evidence, Noise
from drd_tools.diagnose.regression.chain import Readings, beside, chain_of, delays_s, has_clock, stamped_later_s
from drd_tools.diagnose.regression.gram import Gram
from drd_tools.diagnose.selected import SCALE, Selected, Values, linear_names, parameter, shape_of

Key = tuple[str, str, tuple[tuple[str, float | str], ...]]
# An effect, its shape (the nonlinear parameters), and the name of a linear one, "" or a form; or an effect, all its
# values, and a slope.
Wanted = tuple[Effect, Values, str]

CACHED_BYTES: Final = 150e6  # of whitened columns in one problem: limits the memory
# Rounds of removing effects along the motion cleared of them, at most. Each leaves as much of the last change as the
# effects are of the motion: half if wheels spin. They end if increments change by less, relative to the largest.
CLEARINGS: Final = 10
CLEARED: Final = 0.005
FORM: Final = "form "
SLOPE: Final = "slope "


class Inflation(NamedTuple):
    """Long-run inflation of the innovations over white noise, in sigmas: of the wheels, and of x, y, heading.

    Real slip and real references are correlated over seconds. Whitened as if they were not, the data would show
    effects everywhere; divided by this, a slow sensitivity has its correct weight. If the wheels' tails are heavy, each
    of their rows has its own, (n,); on real ground so has each fix, (m, 3), depending on whether the robot moves.
    """

    wheels: float | Array = 1.0
    fixes: Array = np.ones(3)

    def of_another_drive(self) -> "Inflation":
        """The inflation for other rows: one for all wheel rows and one for all fixes, with their mean information."""
        return Inflation(float(_mean_inflation(np.reshape(self.wheels, (-1, 1)))[0]), _mean_inflation(self.fixes))


def _mean_inflation(sizes: Array) -> Array:
    """The inflation of each column that corresponds to the mean information of its rows."""
    rows = np.atleast_2d(sizes)
    return np.asarray(np.mean(rows**-2.0, axis=0) ** -0.5 if len(rows) else np.ones(rows.shape[1]), float)


NOT_INFLATED: Final = Inflation()


class Problem:
    """Regression of a recording, linearised around its best path, with noise of given sizes."""

    def __init__(
        self,
        evidence: Evidence,
        path: Path | None = None,
        noise: Noise | None = None,
        fix_inflation: Array | None = None,
        cleared: Evidence | None = None,
        inflation: Inflation = NOT_INFLATED,
        near: "Problem | None" = None,
        chain: Sequence[Selected] = (),
    ):
        self.evidence = evidence
        self.path = follow(evidence) if path is None else path
        self.noise = evidence.datasheet if noise is None else noise
        self.fix_inflation, self.inflation = fix_inflation, inflation
        self.linear: Linear = Linear(
            evidence, self.path, self.noise, fix_inflation, None if near is None else near.linear
        )
        self._inflated: Linear | None = None if near is None else near._inflated
        self.sensitivities = Sensitivities.on(evidence if cleared is None else cleared, self.path)
        self.readings = Readings(self.sensitivities, chain)
        self.nuisances = nuisances(evidence, self.path, self.noise.ahead_m)
        if evidence.has_three_clocks and not has_clock(chain):
            self.nuisances.append(self.sensitivities.wheels_drift(self.readings.of_wheels()))
        whitened = self.whiten([self.linear.data(), *(s * sigma for _, sigma, s in self.nuisances)])
        # `nuisance` (r, q) is scaled so that the prior of each coefficient is 1.
        self.data, self.nuisance = whitened[:, 0], whitened[:, 1:]
        self._cache: dict[Key, Array] = {}
        self._form_counts: dict[str, int] = {}
        self._rows: npt.NDArray[np.bool_] | None = None
        self._is_exact = False
        self._gram: Gram | None = None

    def exact(self) -> "Problem":
        """The problem without model discrepancy: causes have exactly the catalogue's form, as in simulation."""
        made = copy(self)
        made._is_exact = True
        return made

    def with_data(self, data: Array) -> "Problem":
        """A problem with other data (r,)."""
        made = copy(self)
        made.data, made._gram = data, None
        return made

    def part(self, rows: npt.NDArray[np.bool_], data: Array, held: Array | None = None) -> "Problem":
        """A problem restricted to some rows, with `data` (r,). `held` (r, s) replaces the nuisances."""
        made = self.with_data(data[rows])
        made._rows = rows
        made.nuisance = (self.nuisance if held is None else held)[rows]
        return made

    def with_nuisance(self, sensitivity: Sensitivity) -> "Problem":
        """A problem with one more nuisance, of which the sensitivity is a standard deviation."""
        made = self.with_data(self.data)
        made.nuisance = np.column_stack([self.nuisance, self.whiten([sensitivity])])
        return made

    def along(self, change: Change, is_read: bool = False) -> "Problem":
        """The problem with sensitivities along the changed motion. `is_read`: the change turns the motion into the
        sensors' readings, to which the selected geometry and delays are not added again.
        """
        made = copy(self)
        made.readings, made._cache, made._gram = self.readings.along(change, is_read), {}, None
        made.sensitivities = made.readings.sensitivities
        return made

    @property
    def per_parameter(self) -> float:
        """Penalty of a parameter, nats (Schwarz 1978)."""
        return 0.5 * math.log(max(len(self.data), 2))

    @property
    def per_effect(self) -> float:
        """Penalty of the choice of an effect from the catalogue, nats."""
        return math.log(len(catalogue()))

    def penalty(self, selection: Sequence[Selected]) -> float:
        """Penalty of effects and their parameters, nats. A parameter of one sign has twice the prior density."""
        one_sided = sum(not c.parameter(name).signed and c.parameter(name).linear for c in selection for name in c.free)
        return sum(len(c.free) * self.per_parameter + self.per_effect for c in selection) - math.log(2.0) * one_sided

    def with_noise(self, noise: Noise, fix_inflation: Array | None, inflation: Inflation) -> "Problem":
        """The problem with the same path and data, but other noise."""
        return Problem(self.evidence, self.path, noise, fix_inflation, inflation=inflation, near=self)

    def around(self, selection: Sequence[Selected]) -> "Problem":
        """Relinearise around the path and the motion that the sensors give once the effects are removed."""
        cleared = self.cleared(selection)
        if len(cleared.fix):
            self._inflated = inflated_model(cleared, self.path, self._inflated)
            path = self._inflated.smoothed()
        else:
            path = follow(cleared)
        return Problem(
            self.evidence, path, self.noise, self.fix_inflation, cleared, self.inflation, self, chain_of(selection)
        )

    def cleared(self, selection: Sequence[Selected]) -> Evidence:
        """The evidence with the selected effects removed; adding them gives the readings."""
        raw = self.evidence
        gyro_s, wheels_s = (stamped_later_s(late_s, raw.edges_s) for late_s in delays_s(selection, raw.edges_s))
        counted = raw.earlier(raw.left_m, wheels_s), raw.earlier(raw.right_m, wheels_s)
        readings = Readings(self.sensitivities, chain_of(selection))
        clear, body, added, last = raw, Sensitivity(), Sensitivity(), math.inf
        # No reading has the travel that a stopped counter lost: repeating does not improve it.
        is_lost = any(c.effect.irreversible for c in selection)
        for i in range(2 if is_lost else CLEARINGS):
            if i:  # along the motion that is already cleared
                # If no fix constrains the path, the old one would drag shifted turns back to their old place.
                sensitivities = Sensitivities.on(clear, self.path if len(raw.fix) else follow(clear))
                readings = Readings(sensitivities, readings.chain)
                body, added = sensitivities.body, Sensitivity()
                for selected in selection:
                    added = added + readings.sensitivity(selected.effect, selected.values)
            # Undo a delay by a shift: subtracting it would amplify high frequencies.
            gyro = raw.gyro_rad
            if gyro is not None:
                gyro = body.gyro_rad + raw.earlier(gyro - body.gyro_rad - added.gyro_rad, gyro_s)
            others_m = raw.left_m - body.left_m - added.left_m, raw.right_m - body.right_m - added.right_m
            left_m, right_m = readings.without_geometry(*others_m)
            left = body.left_m + raw.earlier(left_m, wheels_s)
            right = body.right_m + raw.earlier(right_m, wheels_s)
            cleared = replace(raw, gyro_rad=gyro, left_m=left, right_m=right, counted_m=counted)
            change = _change(clear, cleared) if i else math.inf
            if change > last:  # effects larger than the motion: it diverges
                break
            clear, last = cleared, change
            if change < CLEARED:
                break
        return clear

    def whiten(self, sensitivities: Sequence[Sensitivity], dtype: type = np.float64) -> Array:
        """Whiten: rows (r, p), first those of the wheels against the gyro, in order of time, then those of the fixes.

        Rows of absent sensors are left out: without a gyro the first kind; without wheels the fixes' positions, and all
        of the first kind except those at standstill.
        """
        rows, n = self.linear.rows(sensitivities, dtype), len(self.evidence.step_s)
        rows[:n] /= np.reshape(self.inflation.wheels, (-1, 1))
        rows[n:] /= np.broadcast_to(self.inflation.fixes, self.evidence.fix.shape).reshape(-1, 1)
        return rows[self.evidence.observed]

    def adjoint(self, rows: Array) -> Array:
        """Transpose of `whiten`: projection of rows (r,) on the response to a unit of each step's increments.

        (n, 4): gyro, left, right and lateral.
        """
        n = len(self.evidence.step_s)
        every = np.zeros(n + 3 * len(self.evidence.fix))
        every[self.evidence.observed] = rows
        every[:n] /= self.inflation.wheels
        every[n:] /= np.broadcast_to(self.inflation.fixes, self.evidence.fix.shape).ravel()
        return self.linear.adjoint(every)

    @property
    def row_time_s(self) -> Array:
        """Time of each row, (r,)."""
        e = self.evidence
        fixes = np.repeat(e.time_s[e.fix_step], 3)
        return np.concatenate([e.time_s, fixes])[e.observed]

    # ---- sensitivities of effects, whitened ------------------------------------------------------------------------

    def sensitivity(self, effect: Effect, values: Values) -> Sensitivity:
        """Sensitivity to an effect with these parameters."""
        return self.readings.sensitivity(effect, values)

    def unit(self, effect: Effect, shape: Values, name: str) -> Sensitivity:
        """Sensitivity to a unit of a linear parameter ("" if it has none), to another form, or to a slope."""
        if name == SCALE.name:
            return self.readings.of(effect, beside(effect, self.sensitivities.motion, 1.0))
        if name.startswith(FORM):
            ones = dict.fromkeys(effect.linear(), 1.0)
            shapes = effect.other_shapes(self.sensitivities.motion_of(effect), {**ones, **shape})
            return self.readings.of(effect, shapes[int(name.removeprefix(FORM))])
        if name.startswith(SLOPE):
            of = name.removeprefix(SLOPE)
            at = float(shape[of])
            h = parameter(effect, of).step(at)
            ahead, back = (self.sensitivity(effect, {**shape, of: value}) for value in (at + h, at - h))
            return (ahead + back * -1.0) * (0.5 / h)
        none = dict.fromkeys(effect.linear(), 0.0)
        return self.sensitivity(effect, {**shape, **none, name: 1.0} if name else shape)

    def units(self, wanted: Sequence[Wanted]) -> list[Array]:
        """Whitened sensitivities (r,) to units; each is computed once."""
        return self._units(wanted, _keys(wanted))

    def _units(self, wanted: Sequence[Wanted], keys: Sequence[Key]) -> list[Array]:
        missing = {key: i for i, key in enumerate(keys) if key not in self._cache}
        if missing:
            if len(self._cache) * 8 * len(self.data) > CACHED_BYTES:
                self._cache = {key: self._cache[key] for key in keys if key in self._cache}
            rows = self.whiten([self.unit(*wanted[i]) for i in missing.values()])
            self._cache.update({key: np.ascontiguousarray(rows[:, j]) for j, key in enumerate(missing)})
        made = [self._cache[key] for key in keys]
        return made if self._rows is None else [row[self._rows] for row in made]

    def products(self, wanted: Sequence[Wanted]) -> Array:
        """Products (1 + q + m, 1 + q + m) of the data, the nuisances, and m units."""
        keys = _keys(wanted)
        if self._gram is None:
            self._gram = Gram(self.data, self.nuisance)
        return self._gram.of(keys, self._units(wanted, keys))

    def combined(self, coefficients: Array, wanted: Sequence[Wanted]) -> Array:
        """Linear combination (r,) of the data, the nuisances, and m units, with coefficients (1 + q + m,)."""
        held, own = coefficients[: len(coefficients) - len(wanted)], coefficients[len(coefficients) - len(wanted) :]
        total: Array = held[0] * self.data + self.nuisance @ held[1:]
        for factor, unit in zip(own, self.units(wanted), strict=True):
            total += factor * unit
        return total

    def discrepancy_shapes(self, selected: Selected) -> Array:
        """Other shapes of a selected effect's cause, (r, s), each as large as the selected effect itself."""
        return float(np.linalg.norm(self.effect_rows([selected]))) * self.unit_shapes(selected)

    def unit_shapes(self, selected: Selected) -> Array:
        """Other shapes of a selected effect's cause, (r, s), each of norm 1; those that no row shows are left out."""
        rows = self.units(self.wanted_shapes(selected))
        seen = [r / norm for r in rows if (norm := math.sqrt(float(r @ r))) > 0.0]
        return as_columns(seen, len(self.data))

    def wanted_shapes(self, selected: Selected) -> list[Wanted]:
        """Units of the other shapes of a selected effect's cause; the effect's rounded parameters suffice for them."""
        if self._is_exact:
            return []
        rough = {
            name: float(f"{value:.2g}") if isinstance(value, float) else value
            for name, value in shape_of(selected.effect, selected.values).items()
        }
        values = {**rough, **{n: selected.values[n] for n in linear_names(selected.effect, selected.values)}}
        count = self._form_counts.get(selected.id)
        if count is None:
            motion = self.sensitivities.motion_of(selected.effect)
            count = len(selected.effect.other_shapes(motion, values))
            self._form_counts[selected.id] = count
        return [(selected.effect, rough, f"{FORM}{i}") for i in range(count)]

    def wanted_rows(self, selection: Sequence[Selected]) -> list[Wanted]:
        """Units of which the rows of the selected effects are linear combinations."""
        return [
            (c.effect, shape_of(c.effect, c.values), name)
            for c in selection
            for name in linear_names(c.effect, c.values) or ("",)
        ]

    def effect_rows(self, selection: Sequence[Selected]) -> Array:
        """Whitened data that the selected effects explain, (r,)."""
        factors = [f for c in selection for f in factors_of(c)]
        total = np.zeros(len(self.data))
        for factor, rows in zip(factors, self.units(self.wanted_rows(selection)), strict=True):
            total += factor * rows
        return total

    def wanted_tangents(self, selection: Sequence[Selected]) -> list[Wanted]:
        """Units that are derivatives, one for each free parameter."""
        wanted: list[Wanted] = []
        for selected in selection:
            shape, names = shape_of(selected.effect, selected.values), linear_names(selected.effect, selected.values)
            for name in selected.free:
                # Differences are taken before whitening: one column per parameter.
                wanted.append(
                    (selected.effect, shape, name)
                    if name in names
                    else (selected.effect, selected.values, SLOPE + name)
                )
        return wanted

    def tangents(self, selection: Sequence[Selected]) -> Array:
        """Derivatives of the explained data with respect to all free parameters, (r, k)."""
        return as_columns(self.units(self.wanted_tangents(selection)), len(self.data))


def _change(before: Evidence, after: Evidence) -> float:
    """Largest change of the wheels' increments, relative to the largest increment."""
    sides = (before.left_m, after.left_m), (before.right_m, after.right_m)
    return max(float(np.abs(b - a).max() / max(np.abs(b).max(), 1e-12)) for a, b in sides)


def _keys(wanted: Sequence[Wanted]) -> list[Key]:
    return [(e.id, name, tuple(sorted(shape.items()))) for e, shape, name in wanted]


def as_columns(rows: Sequence[Array], length: int) -> Array:
    """Stack as columns (r, k), each contiguous: interleaving them would take longer than the computation."""
    return np.array(rows).reshape(len(rows), length).T


def factors_of(selected: Selected) -> list[float]:
    """Factor of each unit of an effect's rows."""
    return [selected.number(name) for name in linear_names(selected.effect, selected.values)] or [1.0]
