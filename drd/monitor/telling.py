"""Findings in words and numbers, from the monitor's results."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np

from drd.effects.catalogue import catalogue, showing
from drd.effects.effect import Calibrated
from drd.monitor.evidence import INFORMATION, Estimate, Posterior
from drd.monitor.findings import Finding, Size, Suspicion, settling, size
from drd.monitor.library import Hypothesis
from drd.monitor.symptoms import Seen
from drd.units import NS_PER_S

FORGIVEN_NATS: Final = 0.5 * math.log1p(INFORMATION)  # cost of each size
CLASS_NATS: Final = 3.0  # names within this are reported, too; one better by this takes over
FORM_SHARE: Final = 0.08  # of the evidence, lost by a slightly wrong form: 0.15^2, and a margin
LEAST_SHARE: Final = 0.1  # of the likeliest name's probability: a suspicion lists no name below
IN_TEXT: Final = 3  # names
RULED_OUT_NATS: Final = 10.0
SYMPTOM_SURE: Final = 0.98
SYMPTOM_STD_S: Final = 0.1  # a row
COMMON: Final = 0.01  # relative: common error of both radii, unobservable without a position
LAG_STD_S: Final = 0.01  # of a lag from correlation, with rows of 0.1 s
SETTLES_S: Final = 120.0  # for this long the onset of a finding is estimated again


class Onset(NamedTuple):
    """Onset within a segment: the segment's begin, the onset's deviation, and the distance until then."""

    begin_s: float
    std_s: float
    distance_m: float


@dataclass
class Known:
    """A finding before its report: its place in the sums, and its estimates."""

    hypothesis: int
    onset: Onset
    end_s: float | None
    estimate: Estimate
    named_s: float
    others: Posterior | None = None
    doubts: int = 0
    rivalry: int = 0
    probabilities: dict[str, float] = field(default_factory=dict)

    @property
    def begin_s(self) -> float:
        """Begin of the segment within which it began."""
        return self.onset.begin_s


class Suspected(NamedTuple):
    """A suspicion before its report: names, onset, and log odds that there is any effect."""

    found: Posterior
    onset: Onset
    odds_nats: float


def class_nats(nats: float) -> float:
    """Margin within which names are of one class with the best, which has `nats`. (98)"""
    return CLASS_NATS + FORM_SHARE * max(nats, 0.0)


class Teller:
    """Makes findings. `zero_ns`: time 0 of values in s; `now_s`: the present time."""

    def __init__(self, hypotheses: Sequence[Hypothesis], zero_ns: int, now_s: float):
        self._hypotheses, self._zero_ns, self._now_s = hypotheses, zero_ns, now_s

    def alike(self, k: Known) -> list[str]:
        """Names that fit as well as a finding's own."""
        found, name = k.others, self._hypotheses[k.hypothesis].id
        assert found is not None
        own = found.nats.get(name, -math.inf)
        near = own - class_nats(own)
        mine = len(self._hypotheses[k.hypothesis].columns)
        # The Occam factor of a second size that is not needed is forgiven.
        forgiven = {
            n: max(0, len(self._hypotheses[f.hypothesis].columns) - mine) * FORGIVEN_NATS for n, f in found.best.items()
        }
        return [n for n, x in found.nats.items() if n != name and x + forgiven[n] > near]

    def _ns(self, at_s: float) -> int:
        return self._zero_ns + round(at_s * NS_PER_S)

    def told(self, k: Known) -> Finding:
        """Make the report of a finding of the regression."""
        h, found = self._hypotheses[k.hypothesis], k.others
        assert found is not None
        own = found.nats[h.id]
        alike = [(n, k.probabilities[n]) for n in self.alike(k)]
        out = tuple(n for n, x in found.nats.items() if x < own - class_nats(own) - RULED_OUT_NATS)
        channels = {catalogue()[n].channel for n in (h.id, *(n for n, _ in alike)) if n in catalogue()}
        text = h.effect.sentence if h.effect is not None else f"Something outside the catalogue acts on {h.text}."
        return Finding(
            effect=h.id,
            text=text,
            parameters=self._parameters(h, k),
            probability=k.probabilities[h.id],
            also_fits=tuple(sorted(alike, key=lambda pair: -pair[1])),
            since_ns=self._ns(k.begin_s),
            since_std_s=k.onset.std_s,
            since_m=k.onset.distance_m,
            until_ns=None if k.end_s is None else self._ns(k.end_s),
            named_ns=self._ns(k.named_s),
            ruled_out=out,
            settle=settling(h.effect, channels),
        )

    def suspicion(self, suspected: Suspected) -> Suspicion:
        """Make the report of a suspicion."""
        p, onset = 1.0 / (1.0 + math.exp(-suspected.odds_nats)), suspected.onset
        shares = suspected.found.shares()
        names = tuple((name, p * share) for name, share in shares.items() if share > LEAST_SHARE * max(shares.values()))
        effects = [catalogue().get(name) for name, _ in names]
        return Suspicion(
            text=f"Something may have changed: {' or '.join(f'{name} ({own:.2f})' for name, own in names[:IN_TEXT])}.",
            probability=p,
            names=names,
            since_ns=self._ns(onset.begin_s),
            since_std_s=onset.std_s,
            since_m=onset.distance_m,
            settle=settling(effects[0] if effects else None, {e.channel for e in effects if e is not None}),
        )

    def _parameters(self, h: Hypothesis, k: Known) -> dict[str, Size | str]:
        if h.effect is None:
            return {}
        values, std = k.estimate.sizes, np.sqrt(np.diagonal(k.estimate.covariance))
        found: dict[str, Size | str] = {}
        units = {q.name: q for q in h.effect.parameters}
        for name, value in h.values.items():
            q = units[name]
            if isinstance(value, str):
                found[name] = value
            elif math.isfinite(value) and not q.is_angle and q not in h.parameters:
                found[name] = size(value, 0.0, q.si, q.unit)
        if h.angle is not None:
            a, b = values.tolist()
            e = math.hypot(a, b)
            found[h.parameters[0].name] = size(e, float(std.mean()), h.parameters[0].si, h.parameters[0].unit)
            phase = math.atan2(-b, a) % (2.0 * math.pi)
            found[h.angle.name] = size(phase, float(std.mean()) / max(e, 1e-30), 1.0, h.angle.unit)
            return found
        if h.effect.opposed:
            half, s = 0.5 * float(values[0]), math.hypot(0.5 * float(std[0]), COMMON)
            return {
                n: size(sign * half, s, 1.0, units[n].unit) for n, sign in zip(h.effect.linear(), (-1, 1), strict=True)
            }
        # A growing effect is reported at its present size, where the catalogue states that at the run's end.
        at_end = h.growth and h.parameters[0].linear
        age_s = self._now_s - k.begin_s if at_end else 1.0
        for q, value, s in zip(h.parameters, values.tolist(), std.tolist(), strict=True):
            found[q.name] = size(q.neutral * (not at_end) + value * age_s, s * age_s, q.si, q.unit)
        return found

    def of_symptom(self, s: Seen, distance_m: float) -> Finding:
        """A finding of a symptom."""
        effect = showing(s.symptom)
        units = {q.name: q for q in effect.parameters}
        shown = effect.shown(s.side, s.begin_s, s.end_s, s.size)
        parameters: dict[str, Size | str] = {
            n: v
            if isinstance(v, str)
            else size(v, SYMPTOM_STD_S if units[n].moment else s.std, units[n].si, units[n].unit)
            for n, v in shown.items()
        }
        until_ns = self._ns(s.end_s) if self._now_s - s.end_s > SETTLES_S else None
        return Finding(
            effect=effect.id, text=effect.sentence, parameters=parameters, probability=SYMPTOM_SURE, also_fits=(),
            since_ns=self._ns(s.begin_s), since_std_s=SYMPTOM_STD_S, since_m=distance_m, until_ns=until_ns,
            named_ns=self._ns(s.named_s), ruled_out=(), settle=effect.manoeuvre,
        )  # fmt: skip

    def of_lag(self, lag_s: float, named_s: float) -> Finding:
        """A finding of the lag of the wheels that corrects the stamps; negative: the gyro's."""
        constants = Calibrated(wheels_lag_s=lag_s) if lag_s > 0.0 else Calibrated()
        effects = [
            e
            for e in catalogue().values()
            if e.covariate == "acceleration"
            and e.channel == ("wheels" if lag_s > 0.0 else "gyro")
            and e.is_diagnosed
            and not e.needs_position
        ]
        effect, *others = effects
        shown = effect.calibrated(constants) or {q.name: abs(lag_s) for q in effect.parameters}
        units = {q.name: q for q in effect.parameters}
        parameters: dict[str, Size | str] = {
            n: size(float(v), LAG_STD_S, units[n].si, units[n].unit) for n, v in shown.items()
        }
        alike = tuple((e.id, 0.0) for e in others)
        return Finding(
            effect=effect.id, text=effect.sentence, parameters=parameters, probability=SYMPTOM_SURE, also_fits=alike,
            since_ns=self._ns(0.0), since_std_s=0.0, since_m=0.0, until_ns=None, named_ns=self._ns(named_s),
            ruled_out=(), settle=effect.manoeuvre,
        )  # fmt: skip
