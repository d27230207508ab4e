"""Likelihood of each effect since each moment, besides the nuisance effects of every robot. (97), (98)"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from drd.arrays import Array
from drd.effects.effect import ActsOn, Begins
from drd.monitor import wandering
from drd.monitor.library import TURN, Hypothesis
from drd.monitor.sums import LEAST, Sums

# Rate of onset of effects, all together, per second of driving: one in 50 hours. A prior for maintained robots; with
# odds of 20 to 1 it gives a mean time of 1,000 hours between false names, see (98).
HAZARD_PER_S: Final = 1.0 / (50.0 * 3600.0)
START_S: Final = 60.0  # additional prior of a start, in seconds of driving
# Probability that an effect that can end lasts for the rest of the drive; else its length is exponential, of this mean.
STAYS: Final = 0.5
WINDOW_S: Final = 120.0
INFORMATION: Final = 64.0  # prior variance of a size over its own: an effect that shows itself, d = 8
SHEET_SEGMENTS: Final = 40.0  # weight of the stated noise, in segments
UNLIKELY: Final = 1e-3  # probability of an onset below which sizes since then are ignored
HIDDEN: Final = 0.02  # least share of an effect's information that the nuisances must leave


class Form(NamedTuple):
    """A hypothesis by its number, from a segment until before another: nats of evidence, including the prior."""

    hypothesis: int
    begin: int
    end: int
    nats: float


@dataclass(frozen=True)
class Estimate:
    """A hypothesis from a segment until before another: nats of evidence, sizes (k,) and their covariance (k, k)."""

    hypothesis: Hypothesis
    begin: int
    end: int
    nats: float
    sizes: Array
    covariance: Array


class Bank:
    """Evidence for all hypotheses since each segment, with the components of `sums` as nuisances."""

    def __init__(self, sums: Sums, hypotheses: Sequence[Hypothesis]):
        self.sums, self.hypotheses = sums, hypotheses
        raw = [(c, g) for h in hypotheses for c, g in zip(h.columns, h.growth or (-1,) * len(h.columns), strict=True)]
        self._at = at = np.array([c for c, _ in raw])
        self._grows = grows = np.array([max(g, 0) for _, g in raw])
        # The column of a growing effect is its own less its growth times the onset's time.
        since_s = np.append(sums.begins_s, 0.0)
        self._old = old = np.where(np.array([g for _, g in raw]) >= 0, -since_s[:, None], 0.0)  # (onsets, tested)
        each, since = sums.each, sums.since
        self._v = sums.whitened(sums.beside[:, :, at] + old * sums.beside[:, :, grows])
        self._score = since(each[:, at, -1]) + old * since(each[:, grows, -1]) - np.tensordot(sums.vy, self._v, 1)
        crossed, grown = since(each[:, at, grows]), since(each[:, grows, grows])
        self._full = since(each[:, at, at]) + 2.0 * old * crossed + old**2 * grown
        self._own = np.einsum("mst,mst->st", self._v, self._v)
        ends = np.cumsum([len(h.columns) for h in hypotheses])
        self._places = [slice(int(e) - len(h.columns), int(e)) for h, e in zip(hypotheses, ends, strict=True)]
        q, j = sums.scatter()
        # A growing effect scatters as its growth does.
        self._q, self._j = (np.array([x[list(h.growth or h.columns)].mean() for h in hypotheses]) for x in (q, j))
        self._turns = float(q[TURN]), max(float(j[TURN]), 1.0)
        self._most = float(self._j.max())
        self._limit = np.array([h.limits[0] for h in hypotheses])
        self._positive = np.array([h.is_positive for h in hypotheses])
        self._grown = np.array([bool(h.growth) for h in hypotheses])

    def nats(self) -> Array:
        """Evidence for each hypothesis since each onset, against no effect, shape (onsets, hypotheses)."""
        n = len(self._score) - 1
        starts = np.array([p.start for p in self._places])
        score, full, v = self._score[:, starts], self._full[:, starts], self._v[:, :, starts]
        information = full - self._own[:, starts]
        told = np.where(information > HIDDEN * full, information, 0.0)[:-1]
        # It may have begun within the segment before.
        both = self._own[1:, starts] - np.einsum("mst,mst->st", v[:, 1:], v[:, :-1])
        within = -np.diff(information, axis=0) - 2.0 * both
        began = np.zeros((2, *told.shape))
        began[:, 1:] = _edge(score[1:], information[1:], -np.diff(score, axis=0), within, both, self._limit)[:, :-1]
        found = self._nats(np.arange(len(starts)), score[:-1], told, np.where(self._grown, 0.0, began))
        for i, place in enumerate(self._places):
            if place.stop - place.start > 1:
                found[:, i] = self._together(i, slice(0, n))
        return found

    def _together(self, i: int, onsets: slice) -> Array:
        """`nats` of a hypothesis of several columns, which do not grow."""
        place, h = self._places[i], self.hypotheses[i]
        c, v = self._at[place], self._v[:, onsets, place].transpose(1, 0, 2)
        own = slice(c[0], c[-1] + 1)
        information = self.sums.since(self.sums.each[:, own, own])[onsets] - v.transpose(0, 2, 1) @ v
        score, half = self._score[onsets, place], np.array(h.limits) / 2.0
        # Along the eigenvectors, sizes being relative to the prior's largest: few headings may show only one of two.
        e, W = np.linalg.eigh(half[:, None] * information * half)
        e, z = np.maximum(e, LEAST), np.einsum("skj,sk->sj", W, half * score)
        gain = 0.5 * z**2 / e * _plausible(0.5 * np.abs(z) / e)
        gain, shrunk, cost = (x.sum(1, keepdims=True) for x in (gain, *_by_prior(gain, np.minimum(e, INFORMATION))))
        nats = self._told(np.array([i]), gain, shrunk, cost, shares=len(c) if h.effect is None else 1)
        return np.where((np.diagonal(information, axis1=1, axis2=2) > LEAST).all(1), nats[:, 0], -np.inf)

    def windows(self, i: int) -> Array:
        """`nats` of one of a single column, until before each later segment, shape (begins, ends); -inf: none."""
        t = self._places[i].start
        score, v, own, full = self._score[:, t], self._v[:, :, t], self._own[:, t], self._full[:, t]
        cross, n = v.T @ v, len(score) - 1
        information = (full - own)[:-1, None] - (full + own)[None, :-1] + 2.0 * cross[:-1, :-1]
        inside = score[:-1, None] - score[None, :-1]
        # It may have begun within the segment before, and ended within the next one.
        each = (full - own)[:-1] - (full + own)[1:] + 2.0 * np.diagonal(cross, 1)
        change, k, most = np.diff(cross, axis=1), np.arange(n), self._limit[i]
        both = change[k, k - 1][:, None] - change[:n, k - 1].T
        began = _edge(inside, information, -np.diff(score)[k - 1, None], each[k - 1, None], both, most)
        both = change[:n] - np.diagonal(change)
        edges = began * (k > 0)[:, None] + _edge(inside, information, -np.diff(score), each, both, most)
        nats = self._nats(np.array([i]), inside.ravel()[:, None], information.ravel()[:, None],
                          edges.reshape(2, -1, 1))  # fmt: skip
        return np.where(np.arange(n)[None, :] > np.arange(n)[:, None], nats.reshape(n, n), -np.inf)

    def _nats(self, i: npt.NDArray[np.integer], score: Array, information: Array, edges: Array) -> Array:
        """`nats` of hypotheses i of one column each, (..., hypotheses). `edges`: gain and cost from _edge."""
        tells = information > LEAST
        safe = np.where(tells, information, 1.0)
        prior = np.clip(safe * np.square(self._limit[i] / 2.0), 0.0, INFORMATION)
        gain = 0.5 * score**2 / safe * _plausible(np.abs(score) / safe / self._limit[i])
        nats = self._told(i, gain, *_by_prior(gain, prior), edges[0]) - edges[1]
        nats = nats + np.where(self._positive[i], math.log(2.0) + _log_above(score / np.sqrt(safe)), 0.0)
        return np.where(tells, nats, -np.inf)

    def effective_segments(self, form: Form) -> float:
        """Segments that inform a form, by Kish's effective number: (sum w)^2/sum w^2, w = X^T X. (98)

        Infinite where it began with the drive, and where it has ended.
        """
        if form.end < len(self.sums.begins_s) or not form.begin:
            return math.inf
        place, each = self._places[form.hypothesis], self.sums.each[form.begin :]
        c, g, old = self._at[place], self._grows[place], self._old[form.begin, place]
        w = (each[:, c, c] + 2.0 * old * each[:, c, g] + old**2 * each[:, g, g]).sum(1)
        return float(w.sum() ** 2 / max(float(w @ w), LEAST))

    def wanders(self) -> float:
        """Log of the odds that the tread wanders, over that nothing does. (98)"""
        q, j = self._turns
        return wandering.nats(self.sums, lambda gain: self._student(gain, (q - 2.0 * gain) / j))

    def _told(
        self,
        i: npt.NDArray[np.integer],
        gain: Array,
        shrunk: Array,
        cost: Array,
        further: Array | float = 0.0,
        shares: int = 1,
    ) -> Array:
        """Student's t for noise whose size is estimated from the segments, less Occam's factor. (97)

        `shrunk`, `cost`: see _by_prior. `further`: additional gain. `shares`: columns that divide the rows among them,
        as those of a curve do; q is their mean.
        """
        j, q = np.maximum(self._j[i], 1.0), self._q[i]
        left = (q - 2.0 * (gain + further) / shares) / j
        # A wandering tread is no white noise: the scatter that an effect leaves in the turn counts for this one, too.
        left = np.maximum(left, (self._turns[0] - 2.0 * (gain + further)) / self._turns[1])
        return np.asarray(self._student(shrunk + further, left) - cost)

    def _student(self, gain: Array, left: Array) -> Array:
        """Nats of a gain in squares; `left`: mean square of the residuals, where noise is 1. (97)"""
        # The same number of segments for all hypotheses, so that those informed by few have no advantage.
        rest = self._most * np.maximum(left, 1.0) + SHEET_SEGMENTS
        return np.asarray(0.5 * (self._most + SHEET_SEGMENTS) * np.log1p(2.0 * gain / rest))

    def estimate(self, form: Form, onsets: Array) -> Estimate:
        """Sizes of a form, averaged over its possible onsets with the probabilities `onsets`."""
        p = onsets[: form.end].copy()
        p[form.begin] = max(float(p[form.begin]), UNLIKELY)
        likely = np.flatnonzero(p >= UNLIKELY)
        p = p[likely] / p[likely].sum()
        each = [self._sizes(form.hypothesis, int(b), form.end) for b in likely]
        sizes = np.array([z for z, _ in each])
        mean = p @ sizes
        covariance = np.tensordot(p, [c for _, c in each], 1) + (sizes - mean).T * p @ (sizes - mean)
        return Estimate(self.hypotheses[form.hypothesis], form.begin, form.end, form.nats, mean, covariance)

    def _sizes(self, hypothesis: int, begin: int, end: int) -> tuple[Array, Array]:
        """Sizes (k,) and their covariance (k, k), with the noise that its segments' scatter shows."""
        h, place = self.hypotheses[hypothesis], self._places[hypothesis]
        v, score = self._v[:, begin, place], self._score[begin, place]
        full = self._products(place, begin)
        if end < len(self._score) - 1:
            v, score = v - self._v[:, end, place], score - self._score[end, place]
            full = full - self._products(place, end)
        # The prior: its deviation is the largest plausible size.
        covariance = np.linalg.inv(full - v.T @ v + np.diag(1.0 / np.square(h.limits)))
        gain, j = float(score @ covariance @ score), self._j[hypothesis]
        rest = max(self._q[hypothesis] - gain, 0.0)
        return covariance @ score, max(1.0, (rest + SHEET_SEGMENTS) / (j + SHEET_SEGMENTS)) * covariance

    def _products(self, place: slice, at: int) -> Array:
        c, g, old, full = self._at[place], self._grows[place], self._old[at, place], self.sums.each[at:].sum(0)
        cross = old[:, None] * full[np.ix_(g, c)]
        grown = old[:, None] * old[None, :] * full[np.ix_(g, g)]
        return np.asarray(full[np.ix_(c, c)] + cross + cross.T + grown)


@dataclass(frozen=True)
class Posterior:
    """Nats of each name against no effect, including its prior; its likeliest form, and probabilities of its onsets.

    `wanders_nats`: those of a wandering tread instead of any effect.
    """

    nats: dict[str, float]
    best: dict[str, Form]
    onsets: dict[str, Array]
    wanders_nats: float = -math.inf

    @property
    def odds_nats(self) -> float:
        """Log odds that there is any effect."""
        if not self.nats:
            return -math.inf
        return float(np.logaddexp.reduce(list(self.nats.values())) - np.logaddexp(0.0, self.wanders_nats))

    @property
    def first(self) -> str:
        """Most likely name."""
        return max(self.nats, key=lambda name: self.nats[name])

    @property
    def wanders(self) -> float:
        """Probability that the tread wanders."""
        return math.exp(self.wanders_nats - self._total)

    @property
    def _total(self) -> float:
        return float(np.logaddexp.reduce([0.0, self.wanders_nats, *self.nats.values()]))

    def probabilities(self) -> dict[str, float]:
        """Probability of each name, the likeliest first; the rest is that of no effect and of a wandering tread."""
        return self._over(self._total)

    def shares(self) -> dict[str, float]:
        """Probability of each name given that one of them holds, the likeliest first."""
        return self._over(float(np.logaddexp.reduce(list(self.nats.values()))))

    def _over(self, total: float) -> dict[str, float]:
        found = {name: math.exp(x - total) for name, x in self.nats.items()}
        return dict(sorted(found.items(), key=lambda pair: -pair[1]))


def posterior(bank: Bank, skids: bool = False) -> Posterior:
    """Shiryaev-Roberts sum over the onsets for each name; for a robot that skids, timing is not judged. (98)"""
    length_s = bank.sums.length_s
    n = len(length_s)
    names = list(dict.fromkeys(h.id for h in bank.hypotheses))
    prior = np.log(HAZARD_PER_S * (length_s + START_S * (np.arange(n) == 0)) / len(names))
    begins_s = bank.sums.begins_s
    ends = np.log((1.0 - STAYS) * length_s / WINDOW_S) - np.maximum(begins_s - begins_s[:, None], 0.0) / WINDOW_S
    lasts = np.log(STAYS + (1.0 - STAYS) * np.exp((begins_s - begins_s[-1] - length_s[-1]) / WINDOW_S))
    free = bank.sums.free
    since = np.where(free[:n] < free[n], bank.nats().T + prior, -np.inf).T
    found = Posterior({}, {}, {}, -math.inf if skids else bank.wanders())
    for name in names:
        most, at = Form(0, 0, n, -math.inf), np.full(n, -np.inf)
        forms = [i for i, h in enumerate(bank.hypotheses) if h.id == name]
        effect = bank.hypotheses[forms[0]].effect
        if skids and effect is not None and effect.acts_on is ActsOn.TIMING:
            continue
        for i in forms:
            own = since[:, i] + (lasts if bank.hypotheses[i].has_end else 0.0)
            if effect is not None and effect.begins is Begins.POWER_ON:
                own = np.where(np.arange(n) == 0, own, -np.inf)
            most = max(most, Form(i, int(own.argmax()), n, float(own.max())), key=attrgetter("nats"))
            if bank.hypotheses[i].has_end:
                spans = bank.windows(i) + prior[:, None] + ends
                spans = np.where(free[:n, None] < free[None, :n], spans, -np.inf)
                b, e = divmod(int(spans.argmax()), n)
                most = max(most, Form(i, b, e, float(spans[b, e])), key=attrgetter("nats"))
                own = np.logaddexp(own, np.logaddexp.reduce(spans, axis=1))
            at = np.logaddexp(at, own)
        if math.isfinite(most.nats):
            at = at - math.log(len(forms))
            found.nats[name], found.best[name] = float(np.logaddexp.reduce(at)), most
            found.onsets[name] = np.exp(at - found.nats[name])
    return found


def _edge(score: Array, information: Array, own_score: Array, own: Array, both: Array, most: Array | float) -> Array:
    """Gain and cost of an effect's partial size in the segment within which it begins or ends, (2, ...).

    `own_score`, `own`: that segment's score and information; `both`: its information in common with the effect's;
    `most`: the largest plausible size.
    """
    safe = np.where(information > LEAST, information, np.inf)
    size = score / safe
    left, rest = np.maximum(own - both**2 / safe, 0.0), own_score - both * size
    # Uniform from zero to the whole size, approximated by a Gaussian of the same mean and variance.
    mean = 0.5 * np.clip(size, -most, most)
    variance = mean**2 / 3.0
    inflated = 1.0 + left * variance
    gain = (0.5 * rest**2 * variance + rest * mean - 0.5 * left * mean**2) / inflated
    # A segment with more information than all the rest is not one within which it begins or ends.
    return np.where(own < information, np.stack([gain, 0.5 * np.log(inflated)]), 0.0)


def _by_prior(gain: Array, prior: Array) -> tuple[Array, Array]:
    """A gain under a prior of `prior` times a size's own variance, and Occam's factor, nats."""
    return gain * prior / (1.0 + prior), 0.5 * np.log1p(prior)


def _plausible(size: Array) -> Array:
    """Share of the gain that is left if a size, relative to its largest plausible one, is limited to that."""
    return np.asarray(1.0 - np.square(np.maximum(1.0 - 1.0 / np.maximum(size, 1e-12), 0.0)))


def _log_above(x: Array) -> Array:
    """Logarithm of the normal distribution function, within 0.01: a size's sign is positive (Page 1977)."""
    return np.asarray(-np.logaddexp(0.0, -(1.5976 * x + 0.070566 * np.clip(x, -4.0, 4.0) ** 2 * x)))
