"""Identifiability in a recording: smallest detectable sizes, estimates of effects not found, classes of names."""

import itertools
import math
from collections.abc import Collection
from typing import Final

import numpy as np

from drd.effects.catalogue import catalogue
from drd_tools.diagnose.observe.evidence import Evidence
from drd_tools.diagnose.regression.marginal import Marginal
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.results import Because, Smallest
from drd_tools.diagnose.select.library import is_absent, library_of
from drd_tools.diagnose.select.sets import Sets

APART_NATS: Final = 3.0  # odds of 20 to 1 between two names
TYPICAL_VISIBILITY: Final = 8.0  # sigmas: 32 nats, well above the cost of a name


class Identifiability:
    """Identifiability of each effect beside those that the `sets` hold, and of any two effects alone. (81)"""

    def __init__(self, problem: Problem, sets: Sets):
        self._library = library = library_of(problem)
        self._estimates = sets.estimates()
        C = np.asarray(library.columns.T @ problem.nuisance.astype(np.float32), float)
        self._products = Marginal(problem.nuisance).beside(np.asarray(library.products, float), C.T)
        self._norm = np.sqrt(np.maximum(np.diag(self._products), 0.0))

    def detectable(self) -> dict[str, Smallest]:
        """Smallest detectable size of each effect, in the unit of its first parameter."""
        found: dict[str, Smallest] = {}
        held = self._estimates.held
        for candidate in self._library.candidates:
            if len(candidate.columns) > 1 and not candidate.angle:
                continue
            at, effect = list(candidate.columns), candidate.effect
            # Projected off itself, a held effect would be invisible.
            norm = self._norm[at].max() if effect.id in held else (1.0 / self._estimates.sigma[at]).max()
            if norm <= 0.0:
                continue
            size = math.sqrt(2.0 * candidate.penalty) / float(norm)
            q = effect.parameters[0] if effect.parameters[0].choices == () else effect.parameters[1]
            if effect.linear():
                q = next(p for p in effect.parameters if p.name in (candidate.names[0], effect.linear()[0]))
            else:  # a multiple of the variant's own size
                size *= abs(float(candidate.shape[q.name]))
            value = size / q.si
            best = found.get(effect.id)
            if best is None or best.smallest is None or value < best.smallest:
                found[effect.id] = Smallest(value, q.unit)
        return found

    def classes(self) -> list[list[str]]:
        """Effects that this recording cannot distinguish if they are of typical detectability."""
        norm = np.maximum(self._norm, 1e-30)
        R = np.abs(self._products / norm[:, None] / norm)
        first: dict[str, list[int]] = {}
        for candidate in self._library.candidates:
            if len(candidate.columns) == 1 and self._norm[candidate.columns[0]] > 0.0:
                first.setdefault(candidate.effect.id, []).append(candidate.columns[0])
        together: list[set[str]] = []
        for a, b in itertools.combinations(sorted(first), 2):
            r = float(R[np.ix_(first[a], first[b])].max())
            if 0.5 * TYPICAL_VISIBILITY**2 * (1.0 - min(r, 1.0) ** 2) < APART_NATS:
                joined = [s for s in together if a in s or b in s]
                together = [s for s in together if s not in joined] + [{a, b}.union(*joined)]
        return [sorted(s) for s in together]

    def bounds(self) -> dict[str, str]:
        """Estimate of each effect that is not held, and its gain in nats, in words."""
        said: dict[str, tuple[float, str]] = {}
        for candidate in self._library.candidates:
            (i, *others), effect = candidate.columns, candidate.effect
            value, sigma = self._estimates.value[i], self._estimates.sigma[i]
            if others or effect.id in self._estimates.held or not math.isfinite(sigma):
                continue
            nats = 0.5 * (value / sigma) ** 2
            gain = nats - candidate.penalty
            name = candidate.names[0] or next(q.name for q in effect.parameters if not q.choices)
            q = next((p for p in effect.parameters if p.name == name), None)
            if q is None:
                continue
            factor = 1.0 / q.si if effect.linear() else float(candidate.shape[name]) / q.si
            text = (
                f"{name} = {value * factor:.3g} +- {abs(sigma * factor):.2g}{'' if q.unit == '1' else f' {q.unit}'}: "
                f"gain of {nats:.1f} nats, {candidate.penalty:.0f} required"
            )
            if effect.id not in said or gain > said[effect.id][0]:
                said[effect.id] = (gain, text)
        return {name: text for name, (_, text) in said.items()}


def not_observable(e: Evidence, seen: Collection[str], found: Collection[str] = ()) -> list[Because]:
    """Effects that the recording cannot show, whatever their size. `seen`: those that it would show beside those
    `found`.
    """
    no_wheels = "the recording has no wheel encoders"
    missing = {"gyro": "the recording has no gyro", "wheels": no_wheels, "body": no_wheels}
    silent, beside = [], " beside the effects found" if found else ""
    for name, effect in catalogue().items():
        if effect.channel not in e.channels:
            silent.append(Because(name, missing[effect.channel]))
        elif effect.needs_wheels and not e.has_wheels:
            silent.append(Because(name, effect.needs_wheels))
        elif is_absent(e, effect):
            lags = "the reference's own, varying lag" if len(e.fix) else "ordinary changes of the lags"
            silent.append(Because(name, f"not distinguishable from {lags}"))
        elif name not in seen and name not in found and effect.searched:
            because = f"nothing in this drive{' or its reference' if len(e.fix) else ''} would show it{beside}"
            if effect.covariate in ("speed", "acceleration") and not e.travel_m.any():
                because = "the speed is not known without wheels or a dense reference: it may pass for another effect"
            silent.append(Because(name, because))
    return silent
