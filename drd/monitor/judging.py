"""Named effects, judged again given each other, and the evidence for the next one. (98)"""

import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from drd.arrays import Array
from drd.monitor.evidence import Bank, Estimate, Form, Posterior, posterior
from drd.monitor.library import Library
from drd.monitor.segments import Segments
from drd.monitor.sums import Component, Sums
from drd.monitor.telling import SETTLES_S, Known, Onset, Suspected, class_nats

NAMED_NATS: Final = math.log(20.0)  # odds at which something is named, (98)
EVEN_NATS: Final = 0.0  # odds above which something is suspected, and below which a name is retracted
# Effective number: an effect seen only in the segment of its onset has no form yet; half of a turn on another floor
# looks like a delay.
LEAST_SEGMENTS: Final = 2.0
PATIENCE: Final = 2  # looks in a row before the report changes: no flapping
MOST: Final = 5  # findings at a time
BESIDE_SHARE: Final = 0.15  # of the strongest one's evidence, required of another: else it repairs that one's form
BY_RATE: Final = ("gyro_scale_asymmetry", "gyro_scale_nonlinearity")  # look like a tread that depends on rate
LOST: Final = 0.05  # probability below which another name takes over at once


class Judge:
    """Names effects from the segments' sums.

    `sigmas`: deviations of the constants before the drive. `skids`: the robot's slip is no white noise.
    """

    def __init__(self, segments: Segments, library: Library, sigmas: Mapping[int, float], skids: bool):
        self._segments, self._library, self._sigmas, self.skids = segments, library, sigmas, skids
        self.known: list[Known] = []
        self.nothing: Posterior | None = None
        self.suspected: Suspected | None = None
        self._walk = self._now_s = 0.0
        self._turn = self._looks = self._changing = 0

    def look(self, now_s: float, bias_walk: float) -> Sums:
        """All sums so far, given the known findings. `bias_walk`: the gyro's, rad/s/sqrt(s)."""
        self._now_s, self._walk = now_s, bias_walk
        sums = self._sums(self.known)
        self._bank = Bank(sums, self._library.hypotheses)
        self.nothing = posterior(self._bank, self.skids)
        return sums

    def decide(self, further_nats: float) -> None:
        """Name an effect if the evidence suffices, or judge a known one again. `further_nats`: beyond NAMED_NATS."""
        found = self.nothing
        assert found is not None
        beside = BESIDE_SHARE * max((k.estimate.nats for k in self.known), default=0.0)
        self._suspect(found, max(EVEN_NATS + further_nats, beside), further_nats)
        if found.odds_nats > max(NAMED_NATS + further_nats, beside) and len(self.known) < MOST:
            form = found.best[found.first]
            if self._bank.effective_segments(form) >= LEAST_SEGMENTS:
                self._looks += 1
                # Another name for what is known already may explain this, too.
                if not any(self._again(k, at_once=True) for k in self.known[::-1]) and self._looks >= PATIENCE:
                    self._name(self._bank.estimate(form, found.onsets[found.first]), found)
                    self.suspected = None
                return
        self._looks = 0
        if self.known:  # one at a time, in turn
            self._turn += 1
            self._again(self.known[self._turn % len(self.known)])

    def _suspect(self, found: Posterior, least_nats: float, further_nats: float) -> None:
        """Start or end a suspicion once some looks in a row agree."""
        suspects, is_likely = self.suspected is not None, found.odds_nats > least_nats
        self._changing = self._changing + 1 if is_likely != suspects else 0
        if self._changing >= PATIENCE:
            self._changing, self.suspected = 0, None
        if is_likely and self._changing == 0:
            p = np.sum([share * found.onsets[name] for name, share in found.shares().items()], axis=0)
            median = int(np.searchsorted(np.cumsum(p), 0.5))
            self.suspected = Suspected(found, self._onset(median, p), found.odds_nats - further_nats)

    def forget(self, but: Sequence[Known] = ()) -> None:
        """Retract all named effects except those in `but`, and the suspicion."""
        self.known[:] = but
        self.suspected, self._looks, self._changing = None, 0, 0

    def _sums(self, known: Sequence[Known]) -> Sums:
        begins = self._segments.begins_s
        n, every = len(begins), self._library.hypotheses
        # Sideways slip depends on speed, rate and curvature all along, which looks like many effects. (99)
        own = [h for h in every if self.skids and (h.effect is None or h.effect.channel == "wheels" or h.id in BY_RATE)]
        parts = [Component({c: 1.0}, limit, 0, n) for h in own for c, limit in zip(h.columns, h.limits, strict=True)]
        edges: set[int] = set()
        for k in known:
            h = every[k.hypothesis]
            b = begins.index(k.begin_s) if k.begin_s in begins else 0
            e = begins.index(k.end_s) if k.end_s is not None and k.end_s in begins else n
            for c, g, limit in zip(h.columns, h.growth or (-1,) * len(h.columns), h.limits, strict=True):
                parts.append(Component({c: 1.0} if g < 0 else {c: 1.0, g: -begins[b]}, limit, b, e))
            if not h.growth:  # it began within a segment
                edges |= {x for at in (b, e) for x in (at - 1, at) if 0 <= x < n and at not in (0, n)}
        return Sums(self._segments.white, self._walk, self._sigmas, self.skids, parts, edges)

    def _again(self, k: Known, at_once: bool = False) -> bool:
        """Judge a finding again, given the others; returns whether its name or end has changed. (98)"""
        sums = self._sums([other for other in self.known if other is not k])
        bank = Bank(sums, self._library.hypotheses)
        found = posterior(bank, self.skids)
        k.doubts = k.doubts + 1 if found.odds_nats < EVEN_NATS else 0
        if k.doubts >= PATIENCE or found.odds_nats < -NAMED_NATS or not found.best:
            self.known.remove(k)
            return False
        k.others, k.probabilities = found, found.probabilities()
        name = self._library.hypotheses[k.hypothesis].id
        best = found.first
        leads = found.nats[best] - found.nats.get(name, -math.inf)
        leaves = leads > class_nats(found.nats[best])
        k.rivalry = k.rivalry + 1 if leaves else 0
        is_lost = leaves and k.probabilities.get(name, 0.0) < LOST and found.odds_nats > NAMED_NATS
        if k.rivalry >= PATIENCE or is_lost or (leads > 0.0 and at_once):
            name, k.rivalry = best, PATIENCE
        if name not in found.best:
            return False
        before = k.hypothesis, k.end_s
        estimate = bank.estimate(found.best[name], found.onsets[name])
        if k.rivalry >= PATIENCE or self._now_s - k.named_s < SETTLES_S or k.end_s != self._end(estimate):
            self._place(k, estimate, found)
        else:
            begins = sums.begins_s.tolist()
            b = begins.index(k.begin_s) if k.begin_s in begins else 0
            e = begins.index(k.end_s) if k.end_s in begins else len(begins)
            k.estimate = bank.estimate(Form(k.hypothesis, b, e, found.nats[name]), found.onsets[name])
        return before != (k.hypothesis, k.end_s)

    def _end(self, estimate: Estimate) -> float | None:
        segments = self._segments.all
        return segments[estimate.end].begin_s if estimate.end < len(segments) else None

    def _place(self, k: Known, estimate: Estimate, found: Posterior) -> None:
        k.hypothesis, k.estimate, k.rivalry, k.end_s = self._number(estimate), estimate, 0, self._end(estimate)
        k.onset = self._onset(estimate.begin, found.onsets[estimate.hypothesis.id])

    def _number(self, estimate: Estimate) -> int:
        return next(i for i, h in enumerate(self._library.hypotheses) if h is estimate.hypothesis)

    def _onset(self, begin: int, p: Array) -> Onset:
        """Onset at the begin of a segment, with the deviation from the probabilities p (n,) of all onsets."""
        segments = self._segments.all
        begin_s, end_s = segments[begin].begin_s, segments[begin].end_s
        middle = np.array([0.5 * (s.begin_s + s.end_s) for s in segments])
        mean = float(p @ middle)
        std_s = math.sqrt(float(p @ (middle - mean) ** 2) + (end_s - begin_s) ** 2 / 12.0)
        return Onset(begin_s, std_s, segments[begin].distance_m)

    def _name(self, estimate: Estimate, found: Posterior) -> None:
        h, onset = self._number(estimate), self._onset(estimate.begin, found.onsets[estimate.hypothesis.id])
        k = Known(h, onset, self._end(estimate), estimate, self._now_s, found, probabilities=found.probabilities())
        self.known.append(k)
