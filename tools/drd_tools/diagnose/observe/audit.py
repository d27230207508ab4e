"""Events, which are found by logic before any regression: a stopped counter, a clipped gyro, one-sided jumps of counts.

Events are not regressions: what they explain is nearly certain where they are, and nothing elsewhere.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.ndimage import binary_dilation, median_filter
from scipy.special import bdtrc

from drd.batch.logs import EncoderLog
from drd.effects.catalogue import showing
from drd.effects.effect import SIDE, SIDES, Symptom
from drd_tools.calibrate.wheels.lag import held_s
from drd_tools.diagnose.observe.evidence import Evidence
from drd_tools.diagnose.results import Array
from drd_tools.diagnose.selected import Selected
from drd_tools.recordings.folder import Recording

FEWEST_CLIPPED: Final = 10  # readings: fewer at one value are chance
FASTER_SHARE: Final = 0.05  # of the limit, by which the wheels must turn faster: no tread is so well known
PILED_UP: Final = 2.0  # times as many at the limit as in nine times the width below it
STANDS_M: Final = 1e-6  # a wheel's way in a row: less is rounding
SHORTEST_STOP_ROWS: Final = 3  # of a counter: two alike may be resolution
LONGEST_HOLD_S: Final = 0.75  # a drive that tells speeds may hold them so long
HOLDS: Final = 2.0  # for so many times that it holds a speed a drive may tell one of a wheel that stands
# Of slip, tread and counts together: an event must be nearly certain, since no search asks again.
STOP_SIGMAS: Final = 8.0
TREAD_SHARE: Final = 0.05  # of a turn, by which the wheels' difference may be off, beside what follows
# Which share of the other wheel's way must be missing: of a tread that is measured, and of robot.yaml's.
MEASURED, BELIEVED = 0.3, 0.5
USUAL_PERCENT, CREEPING = 95.0, 0.15  # of its usual speed: a gyro's bias makes so much of a wheel that stands
LIKELY_SHARE: Final = 0.3  # of the other wheel's way, missing: this much beside a certain stop is part of it
SPIKE_SIGMAS: Final = 5.0  # of slip, in one row: of 10^5 Gaussian rows none is further
MEDIAN_ROWS: Final = 5  # odd; a spike of two rows is not in the median
SURROUNDINGS_ROWS: Final = 9  # odd; wide enough to hold both flanks of a spike, narrow beside a change of speed
DEVIATION_PER_MAD: Final = 1.4826  # of a Gaussian
FEWEST_FIXES: Final = 20  # fewer have no usual step that a jump could differ from
LONGEST_FIX_S: Final = 0.5  # between sparser ones a robot may turn and stop
JUMP_SIGMAS: Final = 7.0  # of one row: two of them, and a turn between, make six by chance
ONE_SIDED_P: Final = 1e-6  # of jumps ahead and back by chance: an event must be nearly certain


@dataclass(frozen=True)
class Event:
    """A selected effect that was found by logic: `windows` (s), `nats` of evidence, and what was seen."""

    selected: Selected
    windows: tuple[tuple[float, float], ...]
    nats: float
    seen: str


@dataclass(frozen=True)
class Audit:
    """Events, and the evidence with its covariance inflated where sensors said nothing of use."""

    events: list[Event]
    evidence: Evidence


def audit(recording: Recording, e: Evidence) -> Audit:
    """Find the events of a recording."""
    gyro, left, right = (
        inflation.copy() for inflation in (e.gyro_inflation_rad2, e.left_inflation_m2, e.right_inflation_m2)
    )
    events = clipped(e, gyro) if e.has_wheels else []
    if recording.wheels is not None:
        events += stopped(recording, e, left, right)
        events += bumps(recording.wheels, e, left, right)
    e = _with_jumps(e)
    return Audit(events, replace(e, gyro_inflation_rad2=gyro, left_inflation_m2=left, right_inflation_m2=right))


def _with_jumps(e: Evidence) -> Evidence:
    """Inflate the pose's covariance where the reference jumps: as no robot moves, as its gyro does not turn. (71)"""
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
        off_rad = moved[:, 2] - np.diff(np.interp(at, edges, np.concatenate([[0.0], np.cumsum(e.gyro_rad)])))
        off_rad = np.abs(off_rad - np.median(off_rad))
    sheet = e.datasheet
    is_jump = (off_m > JUMP_SIGMAS * sheet.position_m) | (off_rad > JUMP_SIGMAS * sheet.heading_rad)
    jump_m2, jump_rad2 = e.jump_m2.copy(), e.jump_rad2.copy()
    step = e.fix_step[1:][is_jump]
    np.add.at(jump_m2, step, off_m[is_jump] ** 2)
    np.add.at(jump_rad2, step, off_rad[is_jump] ** 2)
    return replace(e, jump_m2=jump_m2, jump_rad2=jump_rad2)


def clipped(e: Evidence, inflation: Array) -> list[Event]:
    """Readings that pile up at the largest rate, with the wheels turning faster."""
    if e.gyro_rad is None:
        return []
    rate = e.gyro_rad / e.step_s
    limit = float(np.abs(rate).max())
    # Noise and resolution spread what is clipped before them.
    step_s = float(np.median(e.step_s))
    width = 6.0 * e.datasheet.walk_rad_per_sqrt_s / step_s**0.5 + 2.0 * e.datasheet.resolution_rad_s + 1e-6 * limit
    at = np.abs(rate) >= limit - width
    below = (np.abs(rate) < limit - width) & (np.abs(rate) >= limit - 10.0 * width)
    if at.sum() < FEWEST_CLIPPED or at.sum() < PILED_UP * below.sum():
        return []
    limit = float(np.median(np.abs(rate[at])))
    wheels = (e.right_m - e.left_m) / e.tread_m
    # A turn at a constant rate piles up as well; then the wheels turn no faster than the gyro says.
    turning = (np.abs(rate) > 0.3 * limit) & (np.abs(rate) < 0.9 * limit)
    usual = 1.0
    if turning.sum() > FEWEST_CLIPPED:
        usual = float(wheels[turning] @ e.gyro_rad[turning] / (e.gyro_rad[turning] @ e.gyro_rad[turning]))
    faster = (np.sign(rate) * wheels - usual * np.abs(e.gyro_rad))[at] / e.step_s[at]
    sure = float(faster.std()) / float(np.sqrt(at.sum()))
    if float(faster.mean()) < max(5.0 * sure, FASTER_SHARE * limit):
        return []
    # A reading at the edge is clipped for a part of its time.
    inflation[binary_dilation(at)] = np.inf
    effect = showing(Symptom.CLIPPED)
    nats = float(at.sum()) * np.log(2.0 * max(1.0, 20.0 * at.sum() / (below.sum() + 1.0)))
    seen = f"{int(at.sum())} readings stand at the limit, {int(below.sum())} just below it"
    return [Event(Selected(effect, effect.shown(size=limit), ()), _spans(e.time_s, e.step_s, at), nats, seen)]


def stopped(recording: Recording, e: Evidence, left: Array, right: Array) -> list[Event]:
    """A counter that stands still while the other wheel and the gyro say that its wheel turns."""
    log, events = recording.encoders, []
    least_s = max(HOLDS * held_s(recording), LONGEST_HOLD_S if log.left_counts is None else 0.0)
    left_m, right_m = (recording.nominal.wheel_radius_m * np.diff(angle) for angle in recording.wheel_angles_rad())
    for side, mine, its, inflation, sign in (
        (SIDES[0], left_m, right_m, left, -1.0),
        (SIDES[1], right_m, left_m, right, 1.0),
    ):
        for first, last in _runs(np.abs(mine) < STANDS_M):
            if log.time_s[last] - log.time_s[first] < least_s:
                continue
            stop = _stop(log, e, sign, np.where(np.abs(its) < STANDS_M, 0.0, its), first, last, least_s)
            if stop is None:
                continue
            # It stopped and went on within a row: what it lost there is not known.
            row_s = float(np.diff(log.time_s[first : last + 1]).max())
            inside = (e.time_s > stop.t0 - row_s) & (e.time_s - e.step_s < stop.t1 + row_s)
            inflation[inside] = (np.abs(its[first:last]).max() * 2.0 + 0.01) ** 2
            effect = showing(Symptom.STOPPED)
            selected = Selected(effect, effect.shown(side, stop.t0, stop.t1), ())
            rest_s = stop.t1 - stop.t0
            seen = f"the {side} counter stood still for {rest_s:.2f} s while its wheel went {stop.missed_m:.2f} m"
            events.append(Event(selected, ((stop.t0, stop.t1),), stop.nats, seen))
    return events


def repaired(recording: Recording, e: Evidence, events: Sequence[Event]) -> Recording:
    """The recording with stopped wheels turning as the other one and gyro, or reference, say: for a calibration."""
    log, r = recording.encoders, recording.nominal.wheel_radius_m
    travel = [r * np.diff(angle, prepend=0.0) for angle in recording.wheel_angles_rad()]
    for event in events:
        if event.selected.effect.symptom is not Symptom.STOPPED:
            continue
        which = SIDES.index(str(event.selected.values[SIDE.name]))
        sign = -1.0 if which == 0 else 1.0
        for t0, t1 in event.windows:
            inside = (log.time_s > t0 + STANDS_M) & (log.time_s <= t1 + STANDS_M)
            edges_s = np.append(t0, log.time_s[inside]) - e.robot.wheels_lag_s
            turns = (_turned(e, a, b) for a, b in itertools.pairwise(edges_s.tolist()))
            turn = np.array([0.0 if t is None else t for t in turns])
            travel[which][inside] = travel[1 - which][inside] + sign * e.robot.tread * e.tread_m * turn
    rates = [way / r / np.diff(log.time_s, prepend=2.0 * log.time_s[0] - log.time_s[1]) for way in travel]
    nominal = replace(recording.nominal, counts_per_revolution=None)
    return replace(
        recording, nominal=nominal, wheels=EncoderLog(log.time_s, None, None, rates[0], rates[1], log.is_lost)
    )


class _Stop(NamedTuple):
    """A counter's rest, in which its wheel went on: times (s), the way of the wheel, the evidence."""

    t0: float
    t1: float
    missed_m: float
    nats: float


def _stop(log: EncoderLog, e: Evidence, sign: float, its: Array, first: int, last: int, least_s: float) -> _Stop | None:
    """Rows `first` to `last` of a counter at rest, in intervals in which the other one counts; None: it may well rest.

    A interval that is only likely belongs to one that is certain: the counter has not counted between them.
    """
    certain: list[tuple[float, float, float, float]] = []
    usual_m_s = float(np.percentile(np.abs(its) / np.diff(log.time_s), USUAL_PERCENT))
    least_share = MEASURED if e.robot.tread != 1.0 else BELIEVED
    likely: list[tuple[float, float]] = []
    for begin, end in ((first + i, first + j) for i, j in _runs(its[first:last] != 0.0)):
        t0, t1 = float(log.time_s[begin]), float(log.time_s[end])
        turn = _turned(e, t0 - e.robot.wheels_lag_s, t1 - e.robot.wheels_lag_s)
        if turn is None:
            continue
        travel = float(its[begin:end].sum())
        missed = travel + sign * e.robot.tread * e.tread_m * turn
        # A turn about the standing wheel leaves it where it is, up to slip and a wrong tread.
        sigma = (
            e.datasheet.slip_m_per_sqrt_m * np.sqrt(abs(travel))
            + TREAD_SHARE * e.robot.tread * e.tread_m * abs(turn)
            + 4.0 * e.datasheet.count_m
        )
        if abs(missed) >= LIKELY_SHARE * abs(travel):
            likely.append((t0, t1))
        least_m = max(STOP_SIGMAS * sigma, least_share * abs(travel), usual_m_s * CREEPING * (t1 - t0))
        if end - begin >= SHORTEST_STOP_ROWS and t1 - t0 >= least_s and abs(missed) >= least_m:
            certain.append((t0, t1, missed, 0.5 * float(missed / sigma) ** 2))
    if not certain:
        return None
    spans = likely + [(t0, t1) for t0, t1, _, _ in certain]
    return _Stop(
        min(t0 for t0, _ in spans), max(t1 for _, t1 in spans),
        sum(missed for _, _, missed, _ in certain), sum(nats for *_, nats in certain),
    )  # fmt: skip


def _turned(e: Evidence, t0: float, t1: float) -> float | None:
    """Turn between two times by the gyro, else by the reference; None where neither tells."""
    if e.gyro_rad is not None:
        edges = e.edges_s
        total = np.concatenate([[0.0], np.cumsum(e.gyro_rad)])
        return float(np.interp(t1, edges, total) - np.interp(t0, edges, total))
    if len(e.fix) > 1:
        at = e.time_s[e.fix_step]
        if at[0] <= t0 and at[-1] >= t1 and np.diff(at).max() < 0.5:
            return float(np.interp(t1, at, e.fix[:, 2]) - np.interp(t0, at, e.fix[:, 2]))
    return None


def bumps(log: EncoderLog, e: Evidence, left: Array, right: Array) -> list[Event]:
    """Sudden travel of one wheel that is always too much: stones and cracks. Slip goes both ways."""
    if log.left_counts is None or log.right_counts is None:
        return []
    more, less, added, way = 0, 0, 0.0, 0.0
    for counts, inflation in ((log.left_counts, left), (log.right_counts, right)):
        travel = np.diff(counts) * e.datasheet.count_m
        usual = _neighbours(travel)
        moving = np.abs(usual) > np.maximum(0.2 * np.percentile(np.abs(travel), 90), 20.0 * e.datasheet.count_m)
        if moving.sum() < 200:
            continue
        # Slip grows with the root of the way.
        z = np.where(moving, (travel - usual) * np.sign(usual) / np.sqrt(np.abs(usual) + 1e-12), 0.0)
        sigma = DEVIATION_PER_MAD * float(np.median(np.abs(z[moving] - np.median(z[moving]))))
        if sigma <= 0.0:
            continue
        # A peak of the speed is no spike: it is near the median of its surroundings.
        alone = np.abs(travel - median_filter(travel, SURROUNDINGS_ROWS, mode="nearest")) / np.sqrt(
            np.abs(usual) + 1e-12
        )
        spike = (np.abs(z) > SPIKE_SIGMAS * sigma) & (alone > SPIKE_SIGMAS * sigma)
        more += int((z[spike] > 0).sum())
        less += int((z[spike] < 0).sum())
        added += float(np.abs(travel - usual)[spike & (z > 0)].sum())
        way += float(np.abs(travel).sum())
        at = log.time_s[1:][spike]
        size = (travel - usual)[spike]
        index = np.searchsorted(e.time_s, at - 1e-9)
        good = index < len(inflation)
        np.add.at(inflation, index[good], size[good] ** 2)
    total = more + less
    if total == 0 or bdtrc(more - 1, total, 0.5) > ONE_SIDED_P:
        return []
    effect = showing(Symptom.JUMPED)
    selected = Selected(effect, effect.shown(size=added / way), effect.linear())
    nats = (more - less) * float(np.log(2.0))
    seen = f"{more} sudden jumps of a counter ahead, {less} back"
    return [Event(selected, ((float(e.time_s[0]), float(e.time_s[-1])),), nats, seen)]


def _neighbours(values: Array) -> Array:
    """Mean of the medians of the rows before and after each row: a spike is not in it, and a slope cancels."""
    padded = np.concatenate([np.repeat(values[:1], MEDIAN_ROWS), values, np.repeat(values[-1:], MEDIAN_ROWS)])
    medians = np.median(np.lib.stride_tricks.sliding_window_view(padded, MEDIAN_ROWS), axis=1)
    n = len(values)
    result: Array = 0.5 * (medians[:n] + medians[MEDIAN_ROWS + 1 : MEDIAN_ROWS + 1 + n])
    return result


def _runs(flags: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and after-last index of each run of True."""
    edge = np.diff(np.concatenate([[False], flags, [False]]).astype(int))
    return list(zip(np.flatnonzero(edge == 1).tolist(), np.flatnonzero(edge == -1).tolist(), strict=True))


def _spans(time_s: Array, step_s: Array, flags: npt.NDArray[np.bool_]) -> tuple[tuple[float, float], ...]:
    """Times of the runs of True; those that are less than 2 s apart are one."""
    spans: list[tuple[float, float]] = []
    for first, last in _runs(flags):
        begin, end = float(time_s[first] - step_s[first]), float(time_s[last - 1])
        if spans and begin - spans[-1][1] < 2.0:
            spans[-1] = (spans[-1][0], end)
        else:
            spans.append((begin, end))
    return tuple(spans)
