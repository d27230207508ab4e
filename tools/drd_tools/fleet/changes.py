"""Changes of a series: the exact posterior over all ways to cut it into segments.

A segment is a random walk about a level, or about one that creeps. `Prior` has the probability and size of changes;
`evidence` filters each segment, over run lengths; `posterior` sums over all segmentations by dynamic programming
(Fearnhead 2006; Adams and MacKay 2007), `most_likely` takes the best. All series of a fleet are processed at once.
"""

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from drd.arrays import Array

CREEP: Final = 1  # kind of a segment; 0 is a level
# Share of recordings that are off by about a jump: a lidar that lost its pose, a load, a passenger.
OUTLIERS: Final = 0.01
# Prior share of creeping segments, if the constant can creep at all: leaks are rarer than sudden changes.
CREEPING: Final = 0.2
ROOM: Final = 2_000_000  # segments in memory at once: limits it to some 100 MB
LOG_2PI: Final = float(np.log(2.0 * np.pi))


@dataclass(frozen=True)
class Prior:
    """Prior of a segmentation. `mean`, `spread`: those of the first level, shape (series,) and scalar; `jump`, `slope`:
    sigma of later levels beyond the spread, and of creep per day; `walk`: variance added per day. `change`: probability
    of a change before each observation, shape (series, n); its first column is not used.
    """

    mean: Array
    spread: float
    jump: float
    slope: float
    walk: float
    change: Array


class Changes(NamedTuple):
    """Posterior probabilities: `change`, of a change before each observation, shape (series, n); `segments`, of each
    segment, shape (series, kinds, n, n).
    """

    change: Array
    segments: Array

    def any_change(self, series: int, first: int, last: int) -> float:
        """Posterior probability of at least one change before an observation from `first` to `last`."""
        spanning = self.segments[series, :, :first, last:]
        return float(np.clip(1.0 - spanning.sum(), 0.0, 1.0))


def evidence(day: Array, value: Array, variance: Array, prior: Prior) -> Array:
    """Log evidence of segments [kind, first, last], shape (series, kinds, n, n). (104)

    `day`, `value`, `variance`: shape (series, n); NaN at the end: no observation.

    Outliers are a mixture of two, which is collapsed to one Gaussian after each observation.
    """
    series, n = value.shape
    kinds = 2 if prior.slope > 0.0 else 1
    log = np.full((series, kinds, n, n), -np.inf)
    m0, m1, p00, p01, p11, total = (np.zeros((series, kinds, n)) for _ in range(6))
    for k in range(n):
        at = slice(0, k + 1)
        if k:
            gap = np.nan_to_num(day[:, k] - day[:, k - 1])[:, None, None]
            m0[..., :k] += gap * m1[..., :k]
            p00[..., :k] += 2.0 * gap * p01[..., :k] + gap**2 * p11[..., :k] + prior.walk * gap
            p01[..., :k] += gap * p11[..., :k]
        m0[..., k] = prior.mean[:, None]
        p00[..., k] = prior.spread**2 + (prior.jump**2 if k else 0.0)
        p11[:, CREEP:, k] = prior.slope**2
        is_there = np.isfinite(value[:, k])[:, None, None]
        off = np.where(is_there, np.nan_to_num(value[:, k])[:, None, None] - m0[..., at], 0.0)
        near = p00[..., at] + np.where(is_there, np.nan_to_num(variance[:, k])[:, None, None], 1.0)
        far = near + prior.jump**2
        a = np.log1p(-OUTLIERS) - 0.5 * (np.log(near) + off**2 / near + LOG_2PI)
        b = np.log(OUTLIERS) - 0.5 * (np.log(far) + off**2 / far + LOG_2PI)
        either = np.logaddexp(a, b)
        w = np.exp(a - either)
        gain = np.where(is_there, w / near + (1.0 - w) / far, 0.0)
        less = gain - np.where(is_there, w * (1.0 - w) * (off * (1.0 / near - 1.0 / far)) ** 2, 0.0)
        total[..., at] += np.where(is_there, either, 0.0)
        c0, c1 = p00[..., at].copy(), p01[..., at].copy()
        m0[..., at] += gain * c0 * off
        m1[..., at] += gain * c1 * off
        p00[..., at] -= less * c0 * c0
        p01[..., at] -= less * c0 * c1
        p11[..., at] -= less * c1 * c1
        log[..., at, k] = total[..., at]
    return log


def _prior_of_segments(log: Array, change: Array) -> tuple[Array, Array]:
    """Log evidence of segments with the prior of their kind and of no change within; log h before each observation."""
    kinds = log.shape[1]
    kind = np.log([1.0 - CREEPING, CREEPING]) if kinds == 2 else np.zeros(1)
    with np.errstate(divide="ignore"):
        begins = np.log(change)
    begins[:, 0] = 0.0
    stays = np.log1p(-change)
    stays[:, 0] = 0.0
    stay = np.cumsum(stays, 1)
    segments = log + kind[None, :, None, None] + (stay[:, None, None, :] - stay[:, None, :, None])
    return segments, begins


def log_evidence(log: Array, change: Array) -> Array:
    """Log evidence of each series, summed over all segmentations, shape (series,). (105)"""
    return _before(*_prior_of_segments(log, change))[:, -1]


def _before(segments: Array, begins: Array) -> Array:
    """Log evidence of the observations before each one, and of all, shape (series, n + 1)."""
    series, _, n = segments.shape[:3]
    before = np.zeros((series, n + 1))
    for e in range(n):
        before[:, e + 1] = _sum(segments[:, :, : e + 1, e] + (before[:, : e + 1] + begins[:, : e + 1])[:, None])
    return before


def posterior(log: Array, change: Array) -> Changes:
    """Posterior by summing over all segmentations: `log` (series, kinds, n, n), prior `change` (series, n). (105)"""
    segments, begins = _prior_of_segments(log, change)
    series, _, n = segments.shape[:3]
    before = _before(segments, begins)
    after = np.zeros((series, n + 1))  # log evidence of observations from k on, if a segment begins there
    ends = np.zeros((series, n))
    for s in range(n - 1, -1, -1):
        ends[:, s] = 0.0 if s == n - 1 else begins[:, s + 1] + after[:, s + 1]
        after[:, s] = _sum(segments[:, :, s, s:] + ends[:, None, s:])
    joint = segments + (before[:, :n] + begins)[:, None, :, None] + ends[:, None, None, :]
    p = np.exp(joint - before[:, n][:, None, None, None])
    found = p.sum(3).sum(1)
    found[:, 0] = 0.0
    return Changes(found, p)


def _sum(terms: Array) -> Array:
    """Log of the sum of exponentials, over all but the first axis."""
    flat = terms.reshape(len(terms), -1)
    most = flat.max(1)
    return np.asarray(most + np.log(np.exp(flat - most[:, None]).sum(1)))


def most_likely(log: Array, change: Array) -> list[list[tuple[int, int, int]]]:
    """The likeliest segments (kind, first, last) of each series. (105)"""
    segments, begins = _prior_of_segments(log, change)
    series, _, n = segments.shape[:3]
    best = np.zeros((series, n + 1))
    came = np.zeros((series, n), np.int64)
    for e in range(n):
        score = segments[:, :, : e + 1, e] + (best[:, : e + 1] + begins[:, : e + 1])[:, None]
        flat = score.reshape(series, -1)
        came[:, e] = flat.argmax(1)
        best[:, e + 1] = flat.max(1)
    found = []
    for i in range(series):
        path, e = [], n - 1
        while e >= 0:
            kind, s = divmod(int(came[i, e]), e + 1)
            path.append((kind, s, e))
            e = s - 1
        found.append(path[::-1])
    return found
