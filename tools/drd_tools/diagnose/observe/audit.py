"""Events, found by logic before any regression: a stopped counter, a clipped gyro, one-sided jumps of counts.

Events are not regressed: where they occur they are nearly certain, and elsewhere they explain nothing.
"""

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.ndimage import binary_dilation, median_filter
from scipy.special import bdtrc

from drd.arrays import Array, cumulative
from drd.batch.logs import EncoderLog, FogLog
from drd.effects.catalogue import showing
from drd.effects.effect import Symptom
from drd.estimation.uncertainty import UNSEEN_ACCELERATION_M_S2
from drd_tools import robust
from drd_tools.diagnose.observe.events import Event, runs
from drd_tools.diagnose.observe.evidence import LONGEST_FIX_S, Evidence
from drd_tools.diagnose.observe.stops import BELIEVED_TREAD, Tread, stopped
from drd_tools.diagnose.selected import Selected
from drd_tools.recordings.folder import Recording

FEWEST_CLIPPED: Final = 10  # readings: fewer equal ones may be chance
ALIKE_SHARE: Final = 1e-9  # of the limit: the digits of a file
TURNING_SHARE: Final = 0.3  # of the limit, above which a robot is turning
NEAREST: Final = 100  # values below the limit, to determine the usual spacing
# Resolution over the scatter from row to row: a coarser one piles up readings at each constant rate.
FINE_SHARE: Final = 0.3
FASTER_SHARE: Final = 0.05  # of the limit, by which the wheels must turn faster: covers the uncertainty of the tread
PILED_UP: Final = 2.0  # ratio of the readings at the limit to those within nine widths below it
SPIKE_SIGMAS: Final = 5.0  # of slip, in one row: none of 10^5 Gaussian rows exceeds it
MEDIAN_ROWS: Final = 5  # odd; the median ignores a spike of two rows
SURROUNDINGS_ROWS: Final = 9  # odd; wide enough for both flanks of a spike, narrower than a change of speed
FEWEST_FIXES: Final = 20  # fewer do not determine a usual step
JUMP_SIGMAS: Final = 7.0  # of one row: the difference of two, with a turn between, reaches six by chance
TOLD_SIGMAS: Final = 10.0  # of a reported jump: one of 10^6 Gaussian rows may reach it, and 200 reach seven
ONE_SIDED_P: Final = 1e-6  # of jumps ahead and back by chance: an event must be nearly certain


@dataclass(frozen=True)
class Audit:
    """Events, and the evidence with its covariance inflated where sensors carried no useful information.

    `tread`: used to judge counters at rest.
    """

    events: list[Event]
    evidence: Evidence
    tread: Tread


def audit(recording: Recording, e: Evidence, tread: Tread = BELIEVED_TREAD) -> Audit:
    """Find the events of a recording."""
    gyro, left, right = (
        inflation.copy() for inflation in (e.gyro_inflation_rad2, e.left_inflation_m2, e.right_inflation_m2)
    )
    events = clipped(recording.fog, e, gyro)
    if recording.wheels is not None:
        events += stopped(recording, e, left, right, tread)
        events += bumps(recording.wheels, e, left, right)
    e = _with_jumps(e)
    return Audit(events, replace(e, gyro_inflation_rad2=gyro, left_inflation_m2=left, right_inflation_m2=right), tread)


def _with_jumps(e: Evidence) -> Evidence:
    """Inflate the pose's covariance where the reference jumps: by its usual speed, or by the gyro's turn. (71)"""
    if len(e.fix) < FEWEST_FIXES or not e.has_wheels:
        return e
    at = e.fix_time_s
    gap_s, moved = np.diff(at), np.diff(e.fix, axis=0)
    if float(np.median(gap_s)) > LONGEST_FIX_S:
        return e
    speed = moved[:, :2] / gap_s[:, None]
    off_m = np.hypot(*((speed - median_filter(speed, (MEDIAN_ROWS, 1), mode="nearest")) * gap_s[:, None]).T)
    off_rad = np.zeros(len(gap_s))
    if e.gyro_rad is not None:
        edges = e.edges_s
        off_rad = moved[:, 2] - np.diff(np.interp(at, edges, cumulative(e.gyro_rad)))
        off_rad -= np.median(off_rad)
    # The stated noise may be too small.
    position_m = max(e.datasheet.position_m, robust.scatter(e.fix[:, :2]))
    heading_rad = max(e.datasheet.heading_rad, robust.deviation(off_rad) / math.sqrt(2.0))
    # After a longer gap, neither the speed nor the gyro's turn is known as well.
    unseen_s = np.maximum(gap_s - LONGEST_FIX_S, 0.0)
    unseen_m, unseen_rad = 0.5 * UNSEEN_ACCELERATION_M_S2 * unseen_s**2, e.datasheet.bias_rad_s * unseen_s
    off_rad = np.abs(off_rad)
    is_jump = off_m > JUMP_SIGMAS * position_m + unseen_m
    is_jump |= off_rad > JUMP_SIGMAS * (heading_rad + unseen_rad)
    jump_m2, jump_rad2 = e.jump_m2.copy(), e.jump_rad2.copy()
    step, first_after = e.fix_step[1:][is_jump], 1 + np.flatnonzero(is_jump)
    np.add.at(jump_m2, step, off_m[is_jump] ** 2)
    np.add.at(jump_rad2, step, off_rad[is_jump] ** 2)
    # The jump is placed at the start of its step: earlier fixes of the same step would contradict later ones.
    kept = np.ones(len(at), np.bool_)
    for begin, end in zip(np.searchsorted(e.fix_step, step), first_after, strict=True):
        kept[begin:end] = False
    return replace(e, jump_m2=jump_m2, jump_rad2=jump_rad2).with_fixes(kept)


def jumped(e: Evidence) -> npt.NDArray[np.bool_]:
    """Steps (n,) in which the reference's position certainly jumps."""
    return e.jump_m2 > (TOLD_SIGMAS * e.datasheet.position_m) ** 2


def clipped(fog: FogLog | None, e: Evidence, inflation: Array) -> list[Event]:
    """Find readings that pile up at the largest rate: identical ones, or with the wheels turning faster."""
    if fog is None or e.gyro_rad is None:
        return []
    if (found := _alike_at_the_top(fog)) is not None:
        limit, alike, below = found
        begin_s = fog.time_s - np.diff(fog.time_s, prepend=2.0 * fog.time_s[0] - fog.time_s[1])
        # A step is clipped if one of its rows is.
        count = np.concatenate([[0], np.cumsum(alike)])
        first, last = np.searchsorted(fog.time_s, e.time_s - e.step_s), np.searchsorted(begin_s, e.time_s)
        at = count[np.maximum(last, first)] > count[first]
        return [_clipping(e, inflation, at, limit, int(alike.sum()), below)]
    if not e.has_wheels:
        return []
    rate = e.gyro_rad / e.step_s
    limit = float(np.abs(rate).max())
    # Noise and resolution that act after clipping spread the clipped readings.
    step_s = float(np.median(e.step_s))
    width = 6.0 * e.datasheet.walk_rad_per_sqrt_s / step_s**0.5 + 2.0 * e.datasheet.resolution_rad_s + 1e-6 * limit
    at = np.abs(rate) >= limit - width
    below = int(((np.abs(rate) < limit - width) & (np.abs(rate) >= limit - 10.0 * width)).sum())
    if at.sum() < FEWEST_CLIPPED or at.sum() < PILED_UP * below:
        return []
    limit = float(np.median(np.abs(rate[at])))
    if not _wheels_are_faster(e, rate, at, limit):
        return []
    return [_clipping(e, inflation, at, limit, int(at.sum()), below)]


def _alike_at_the_top(fog: FogLog) -> tuple[float, npt.NDArray[np.bool_], int] | None:
    """The largest rate, which rows equal it exactly, (n,), and the number of rows just below it.

    None if this may be chance, or if the gyro's noise is below its resolution.
    """
    rate = np.abs(fog.rate_rad_s)
    limit = float(rate.max())
    alike = rate >= limit * (1.0 - ALIKE_SHARE)
    turning = ~alike & (rate > TURNING_SHARE * limit)
    lower = np.unique(rate[turning])
    if alike.sum() < FEWEST_CLIPPED or len(lower) < FEWEST_CLIPPED:
        return None
    steps = np.diff(lower)
    below = int((~alike & (rate >= limit - 9.0 * float(np.median(steps[-NEAREST:])))).sum())
    resolution = float(steps[steps > ALIKE_SHARE * limit].min(initial=limit))
    scatter = float(np.median(np.abs(np.diff(rate, 2))[turning[1:-1]])) if turning[1:-1].any() else 0.0
    is_fine = resolution < FINE_SHARE * scatter
    return (limit, alike, below) if alike.sum() > PILED_UP * below and is_fine else None


def _wheels_are_faster(e: Evidence, rate: Array, at: npt.NDArray[np.bool_], limit: float) -> bool:
    """Whether the wheels turn faster than the limit at these steps (n,): a turn at a constant rate also piles up."""
    assert e.gyro_rad is not None
    wheels = (e.right_m - e.left_m) / e.tread_m
    turning = (np.abs(rate) > TURNING_SHARE * limit) & (np.abs(rate) < 0.9 * limit)
    usual = 1.0
    if turning.sum() > FEWEST_CLIPPED:
        usual = float(wheels[turning] @ e.gyro_rad[turning] / (e.gyro_rad[turning] @ e.gyro_rad[turning]))
    faster = (np.sign(rate) * wheels - usual * np.abs(e.gyro_rad))[at] / e.step_s[at]
    sure = float(faster.std()) / float(np.sqrt(at.sum()))
    return float(faster.mean()) >= max(5.0 * sure, FASTER_SHARE * limit)


def _clipping(e: Evidence, inflation: Array, at: npt.NDArray[np.bool_], limit: float, count: int, below: int) -> Event:
    """Event of the clipped steps `at` (n,), in which the gyro is not compared; `count`: readings at the limit."""
    for first, last in runs(binary_dilation(at)):  # a reading at the edge is partly clipped
        step_s = e.step_s[first:last]
        # Without wheels the turn is unknown: as much again may be missing in each run of clipped steps.
        inflation[first:last] = np.inf if e.has_wheels else limit**2 * step_s.sum() * step_s
    effect = showing(Symptom.CLIPPED)
    nats = count * float(np.log(2.0 * max(1.0, 20.0 * count / (below + 1.0))))
    seen = f"{count} readings are at the limit, {below} just below it"
    return Event(Selected(effect, effect.shown(size=limit), ()), _spans(e.time_s, e.step_s, at), nats, seen)


def bumps(log: EncoderLog, e: Evidence, left: Array, right: Array) -> list[Event]:
    """Find sudden travel of a wheel that is always too much: stones and cracks. Slip has both signs."""
    if log.left_counts is None or log.right_counts is None:
        return []
    more, less, added, distance = 0, 0, 0.0, 0.0
    doubted: list[tuple[Array, npt.NDArray[np.intp], Array]] = []
    for counts, inflation in ((log.left_counts, left), (log.right_counts, right)):
        travel = np.diff(counts) * e.datasheet.count_m
        usual = _neighbours(travel)
        moving = np.abs(usual) > np.maximum(0.2 * np.percentile(np.abs(travel), 90), 20.0 * e.datasheet.count_m)
        if moving.sum() < 200:
            continue
        # Slip grows with the root of the distance.
        z = np.where(moving, (travel - usual) * np.sign(usual) / np.sqrt(np.abs(usual) + 1e-12), 0.0)
        sigma = robust.deviation(z[moving])
        if sigma <= 0.0:
            continue
        # A peak of the speed is not a spike: it is close to the median of its surroundings.
        alone = np.abs(travel - median_filter(travel, SURROUNDINGS_ROWS, mode="nearest")) / np.sqrt(
            np.abs(usual) + 1e-12
        )
        spike = (np.abs(z) > SPIKE_SIGMAS * sigma) & (alone > SPIKE_SIGMAS * sigma)
        more += int((z[spike] > 0).sum())
        less += int((z[spike] < 0).sum())
        added += float(np.abs(travel - usual)[spike & (z > 0)].sum())
        distance += float(np.abs(travel).sum())
        at = log.time_s[1:][spike]
        size = (travel - usual)[spike]
        index = np.searchsorted(e.time_s, at - 1e-9)
        good = index < len(inflation)
        doubted.append((inflation, index[good], size[good] ** 2))
    total = more + less
    if total == 0 or bdtrc(more - 1, total, 0.5) > ONE_SIDED_P:
        return []
    # Spikes of both signs are a drive's noise, most of it in turns, which variance there would hide.
    for inflation, index, variance_m2 in doubted:
        np.add.at(inflation, index, variance_m2)
    effect = showing(Symptom.JUMPED)
    selected = Selected(effect, effect.shown(size=added / distance), effect.linear())
    nats = (more - less) * float(np.log(2.0))
    seen = f"{more} sudden forward jumps of a counter, {less} backward"
    return [Event(selected, ((float(e.time_s[0]), float(e.time_s[-1])),), nats, seen)]


def _neighbours(values: Array) -> Array:
    """Mean of the medians of the rows before and after each row: it ignores spikes, and slopes cancel."""
    padded = np.concatenate([np.repeat(values[:1], MEDIAN_ROWS), values, np.repeat(values[-1:], MEDIAN_ROWS)])
    medians = np.median(np.lib.stride_tricks.sliding_window_view(padded, MEDIAN_ROWS), axis=1)
    n = len(values)
    result: Array = 0.5 * (medians[:n] + medians[MEDIAN_ROWS + 1 : MEDIAN_ROWS + 1 + n])
    return result


def _spans(time_s: Array, step_s: Array, flags: npt.NDArray[np.bool_]) -> tuple[tuple[float, float], ...]:
    """Times of the runs of True; runs less than 2 s apart are joined."""
    spans: list[tuple[float, float]] = []
    for first, last in runs(flags):
        begin, end = float(time_s[first] - step_s[first]), float(time_s[last - 1])
        if spans and begin - spans[-1][1] < 2.0:
            spans[-1] = (spans[-1][0], end)
        else:
            spans.append((begin, end))
    return tuple(spans)
