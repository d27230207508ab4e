"""One recording as a regression: whitened data, nuisances, and signatures of effects at any parameters."""

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from drd.effects.catalogue import catalogue
from drd.effects.effect import ActsOn, Effect, Errors
from drd.effects.motion import Motion
from drd_tools.diagnose.claim import BIAS, SCALE, Claim, Values, linear_names, parameter, shape_of
from drd_tools.diagnose.columns import Signatures, nuisances
from drd_tools.diagnose.evidence import Evidence, Noise
from drd_tools.diagnose.linear import Linear, Signature
from drd_tools.diagnose.nominal_path import follow, loosened
from drd_tools.diagnose.path import Path

Array = npt.NDArray[np.float64]
Key = tuple[str, str, tuple[tuple[str, float | str], ...]]
# An effect, its shape (the parameters that are not linear), and the name of a linear one, "" or a form. Or an effect,
# all its values, and a slope.
Wanted = tuple[Effect, Values, str]

CACHED_BYTES: Final = 150e6
CLEARINGS: Final = 2
FORM: Final = "form "
SLOPE: Final = "slope "


class Temper(NamedTuple):
    """How much larger than white the innovations' slow part is, in sigmas: of the wheels, and of x, y, heading.

    Real slip and real references hang together over seconds. What is whitened as if they did not would find something
    everywhere; divided by this, a slow signature has the weight that it deserves.
    """

    wheels: float = 1.0
    fixes: tuple[float, float, float] = (1.0, 1.0, 1.0)


UNTEMPERED: Final = Temper()


class Problem:
    """What a recording says, around the best path, with noise of given sizes."""

    def __init__(
        self,
        evidence: Evidence,
        path: Path | None = None,
        noise: Noise | None = None,
        doubt: Array | None = None,
        cleared: Evidence | None = None,
        temper: Temper = UNTEMPERED,
        near: "Problem | None" = None,
    ):
        self.evidence = evidence
        self.path = follow(evidence) if path is None else path
        self.noise = evidence.sheet if noise is None else noise
        self.doubt, self.temper = doubt, temper
        self.linear: Linear = Linear(evidence, self.path, self.noise, doubt, None if near is None else near.linear)
        self._loose: Linear | None = None if near is None else near._loose
        self.signatures = Signatures(evidence if cleared is None else cleared, self.path)
        self.nuisances = nuisances(evidence, self.path)
        whitened = self.whiten([self.linear.data(), *(s * sigma for _, sigma, s in self.nuisances)])
        # `nuisance` (r, q) is scaled so that the prior of each coefficient is 1.
        self.data, self.nuisance = whitened[:, 0], whitened[:, 1:]
        self._cache: dict[Key, Array] = {}
        self._form_counts: dict[str, int] = {}
        self._rows: npt.NDArray[np.bool_] | None = None

    def part(self, rows: npt.NDArray[np.bool_], data: Array, held: Array | None = None) -> "Problem":
        """The same with some rows only, of `data` (r,). `held` (r, s): in place of the nuisances."""
        made = copy(self)
        made._rows, made.data = rows, data[rows]
        made.nuisance = (self.nuisance if held is None else held)[rows]
        return made

    def along(self, motion: Motion) -> "Problem":
        """The same with the effects' signatures along another motion."""
        made = copy(self)
        made.signatures, made._cache = copy(self.signatures), {}
        made.signatures.motion = motion
        return made

    @property
    def per_parameter(self) -> float:
        """What a parameter costs, nats (Schwarz 1978)."""
        return 0.5 * math.log(max(len(self.data), 2))

    @property
    def per_effect(self) -> float:
        """What the choice of an effect from the catalogue costs, nats."""
        return math.log(len(catalogue()))

    def penalty(self, claims: Sequence[Claim]) -> float:
        """What so many effects and parameters cost, nats."""
        return sum(len(c.free) * self.per_parameter + self.per_effect for c in claims)

    def around(self, claims: Sequence[Claim]) -> "Problem":
        """The same around the path, and along the motion, that the sensors tell once the claims are taken off."""
        cleared = self._cleared(claims)
        if len(cleared.fix):
            self._loose = loosened(cleared, self.path, self._loose)
            path = self._loose.smoothed()
        else:
            path = follow(cleared)
        return Problem(self.evidence, path, self.noise, self.doubt, cleared, self.temper, near=self)

    def _cleared(self, claims: Sequence[Claim]) -> Evidence:
        """The evidence without the claims: what, with them added, gives the readings."""
        raw = self.evidence
        delays = [c.effect.delays(0.0, c.values) for c in claims]
        gyro_s, wheels_s = sum(d.gyro_s for d in delays), sum(d.wheels_s for d in delays)
        clear = replace(
            raw,
            gyro_rad=None if raw.gyro_rad is None else np.zeros_like(raw.gyro_rad),
            left_m=np.zeros_like(raw.left_m),
            right_m=np.zeros_like(raw.right_m),
        )
        added = Signature()
        for _ in range(CLEARINGS):
            gyro = clear.gyro_rad
            if raw.gyro_rad is not None and gyro is not None:
                # A delay is undone by a shift; subtracting it would amplify what is fast.
                gyro = gyro + raw.earlier(raw.gyro_rad - gyro - added.gyro_rad, gyro_s)
            left = clear.left_m + raw.earlier(raw.left_m - clear.left_m - added.left_m, wheels_s)
            right = clear.right_m + raw.earlier(raw.right_m - clear.right_m - added.right_m, wheels_s)
            clear = replace(raw, gyro_rad=gyro, left_m=left, right_m=right)
            # Where no fix holds the path, the old one would drag shifted turns back into their old place.
            signatures = Signatures(clear, self.path if len(raw.fix) else follow(clear))
            added = Signature()
            for claim in claims:
                added = added + signatures.of(self._errors(signatures, claim.effect, claim.values))
        return clear

    @staticmethod
    def _errors(signatures: Signatures, effect: Effect, values: Values) -> Errors:
        motion = signatures.motion
        if effect.acts_on is ActsOn.READOUT:
            motion = replace(motion, rate_rad_s=signatures.calm_rate_rad_s + float(values.get(BIAS.name, 0.0)))
        errors = effect.error(motion, values)
        if SCALE.name in values:
            beside = _beside(effect, motion, float(values[SCALE.name]))
            errors = errors._replace(gyro_rad_s=errors.gyro_rad_s + beside.gyro_rad_s)
        return errors

    def whiten(self, signatures: Sequence[Signature], dtype: type = np.float64) -> Array:
        """Rows (r, p): first those of the wheels against the gyro, in order of time, then those of the fixes.

        Those of absent sensors are left out: without a gyro the first, without wheels the fixes' positions, and of the
        first all but those at standstill.
        """
        rows, n = self.linear.rows(signatures, dtype), len(self.evidence.step_s)
        rows[:n] /= self.temper.wheels
        rows[n:] /= np.tile(self.temper.fixes, len(self.evidence.fix))[:, None]
        return rows[self.evidence.telling]

    @property
    def row_time_s(self) -> Array:
        """When each row is, (r,)."""
        e = self.evidence
        fixes = np.repeat(e.time_s[e.fix_step], 3)
        return np.concatenate([e.time_s, fixes])[e.telling]

    # ---- signatures of effects, whitened ------------------------------------------------------------------------

    def signature(self, effect: Effect, values: Values) -> Signature:
        """What an effect with these parameters adds."""
        return self.signatures.of(self._errors(self.signatures, effect, values))

    def unit(self, effect: Effect, shape: Values, name: str) -> Signature:
        """Of a unit of a linear parameter ("": there is none), one of the other forms, or a slope."""
        if name == SCALE.name:
            return self.signatures.of(_beside(effect, self.signatures.motion, 1.0))
        if name.startswith(FORM):
            ones = dict.fromkeys(effect.linear(), 1.0)
            shapes = effect.other_shapes(self.signatures.motion, {**ones, **shape})
            return self.signatures.of(shapes[int(name.removeprefix(FORM))])
        if name.startswith(SLOPE):
            of = name.removeprefix(SLOPE)
            at = float(shape[of])
            h = parameter(effect, of).step(at)
            ahead, back = (self.signature(effect, {**shape, of: value}) for value in (at + h, at - h))
            return (ahead + back * -1.0) * (0.5 / h)
        none = dict.fromkeys(effect.linear(), 0.0)
        return self.signature(effect, {**shape, **none, name: 1.0} if name else shape)

    def units(self, wanted: Sequence[Wanted]) -> list[Array]:
        """Whitened signatures (r,) of units; each is made once."""
        keys: list[Key] = [(e.id, name, tuple(sorted(shape.items()))) for e, shape, name in wanted]
        missing = {key: i for i, key in enumerate(keys) if key not in self._cache}
        if missing:
            if len(self._cache) * 8 * len(self.data) > CACHED_BYTES:
                self._cache = {key: self._cache[key] for key in keys if key in self._cache}
            rows = self.whiten([self.unit(*wanted[i]) for i in missing.values()])
            self._cache.update({key: np.ascontiguousarray(rows[:, j]) for j, key in enumerate(missing)})
        made = [self._cache[key] for key in keys]
        return made if self._rows is None else [row[self._rows] for row in made]

    def forms(self, claim: Claim) -> Array:
        """Other shapes of a claim's cause, (r, s), each as large as the claim itself."""
        rows = self.units(self.wanted_forms(claim))
        explained = self.effect_rows([claim])
        size = math.sqrt(float(explained @ explained))
        sized = [r * (size / norm) for r in rows if (norm := math.sqrt(float(r @ r))) > 0.0]
        return _columns(sized, len(self.data))

    def wanted_forms(self, claim: Claim) -> list[Wanted]:
        """Other shapes of a claim's cause, near its own: a rough shape is enough for them."""
        rough = {
            name: float(f"{value:.2g}") if isinstance(value, float) else value
            for name, value in shape_of(claim.effect, claim.values).items()
        }
        values = {**rough, **{n: claim.values[n] for n in linear_names(claim.effect, claim.values)}}
        count = self._form_counts.get(claim.id)
        if count is None:
            count = len(claim.effect.other_shapes(self.signatures.motion, values))
            self._form_counts[claim.id] = count
        return [(claim.effect, rough, f"{FORM}{i}") for i in range(count)]

    def wanted_rows(self, claims: Sequence[Claim]) -> list[Wanted]:
        """The units that claims are made of."""
        return [
            (c.effect, shape_of(c.effect, c.values), name)
            for c in claims
            for name in linear_names(c.effect, c.values) or ("",)
        ]

    def effect_rows(self, claims: Sequence[Claim]) -> Array:
        """What the claims explain of the data, (r,)."""
        factors = [f for c in claims for f in _factors(c)]
        total = np.zeros(len(self.data))
        for factor, rows in zip(factors, self.units(self.wanted_rows(claims)), strict=True):
            total += factor * rows
        return total

    def wanted_tangents(self, claims: Sequence[Claim]) -> list[Wanted]:
        """The units that are derivatives, one for each free parameter."""
        wanted: list[Wanted] = []
        for claim in claims:
            shape, names = shape_of(claim.effect, claim.values), linear_names(claim.effect, claim.values)
            for name in claim.free:
                # Differences are taken before they are whitened: so it is one column, whatever moves it.
                wanted.append(
                    (claim.effect, shape, name) if name in names else (claim.effect, claim.values, SLOPE + name)
                )
        return wanted

    def tangents(self, claims: Sequence[Claim]) -> Array:
        """Derivatives of the explained with respect to all free parameters, (r, k)."""
        return _columns(self.units(self.wanted_tangents(claims)), len(self.data))


def _beside(effect: Effect, motion: Motion, size: float) -> Errors:
    """What the effect, beside which alone another's form is known, adds at a size."""
    assert effect.beside is not None
    return effect.beside.error(motion, {effect.beside.parameters[0].name: size})


def _columns(rows: Sequence[Array], length: int) -> Array:
    """Columns (r, k), each in one piece: to spread them over rows takes longer than what is computed with them."""
    return np.array(rows).reshape(len(rows), length).T


def _factors(claim: Claim) -> list[float]:
    return [claim.number(name) for name in linear_names(claim.effect, claim.values)] or [1.0]
