"""Stuck counters, detected from the other wheel and the gyro or the reference. (68)"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from drd.arrays import Array, cumulative
from drd.batch.logs import EncoderLog
from drd.effects.catalogue import showing
from drd.effects.effect import SIDE, SIDES, Symptom
from drd_tools.calibrate.wheels.lag import held_s
from drd_tools.diagnose.observe.events import Event, runs
from drd_tools.diagnose.observe.evidence import LONGEST_FIX_S, Evidence
from drd_tools.diagnose.selected import Selected
from drd_tools.recordings.folder import Recording

STANDS_M: Final = 1e-6  # travel of a wheel in a row: less is rounding
SHORTEST_STOP_ROWS: Final = 3  # of a counter: two equal rows may be resolution
LONGEST_HOLD_S: Final = 0.75  # a drive that reports speeds may hold them for so long
HOLDS: Final = 2.0  # hold times for which a drive may report the speed of a wheel that has stopped
# Deviations due to slip, tread, time and counts: an event must be nearly certain, since no search tests it again.
STOP_SIGMAS: Final = 8.0
# Error of the wheels' difference, as a share of a turn: 8 sigma are a third; a wheel turning on the spot travels half.
TREAD_SHARE: Final = 0.04
RADIUS_SHARE: Final = 0.003  # of the distance: difference of the wheels' travel with measured radii
COUNTS: Final = 4.0  # total error at the ends of both counters
DELAY_S: Final = 0.05  # error of a lag, or its change in a drive (87)
LAG_S: Final = 0.1  # lag between wheels and a sparse reference, which does not determine it
# Share of the other wheel's travel that must be missing, with a measured tread and without.
MEASURED, BELIEVED = 0.3, 0.5
LEAST_BIAS_RAD_S: Final = math.radians(0.2)  # of any gyro: ageing or warm-up exceeds the datasheet
LIKELY_SHARE: Final = 0.3  # of the other wheel's travel: if missing next to a certain stop, part of it


class Tread(NamedTuple):
    """Effective tread over robot.yaml's, its deviation, and whether it was measured."""

    ratio: float = 1.0
    sigma: float = 0.0
    is_measured: bool = False


BELIEVED_TREAD: Final = Tread()


def stopped(recording: Recording, e: Evidence, left: Array, right: Array, tread: Tread) -> list[Event]:
    """Find counters that stand still while, by the other wheel and the gyro or reference, their wheel turns."""
    log, events = recording.encoders, []
    of_turn = math.hypot(TREAD_SHARE, tread.sigma / tread.ratio)
    least = _Least(
        tread.ratio * e.tread_m,
        of_turn,
        MEASURED if tread.is_measured else BELIEVED,
        max(HOLDS * held_s(recording), LONGEST_HOLD_S if log.left_counts is None else 0.0),
        of_turn if tread.is_measured else math.inf,
    )
    left_m, right_m = (recording.nominal.wheel_radius_m * np.diff(angle) for angle in recording.wheel_angles_rad())
    found: list[tuple[_Stop, str]] = []
    for side, mine, its, sign in ((SIDES[0], left_m, right_m, -1.0), (SIDES[1], right_m, left_m, 1.0)):
        other = np.where(np.abs(its) < STANDS_M, 0.0, its)
        for first, last in runs(np.abs(mine) < STANDS_M):
            if log.time_s[last] - log.time_s[first] < least.rest_s:
                continue
            stop = _stop(log, e, sign, other, first, last, least)
            if stop is not None:
                found.append((stop, side))
    for stop, side in found:
        if any(other.nats > stop.nats and _share_a_turn(e, stop, other) for other, _ in found):
            continue
        # It stopped and resumed within a row, in which the lost travel is unknown.
        inside = (e.time_s > stop.t0 - stop.row_s) & (e.time_s - e.step_s < stop.t1 + stop.row_s)
        (left if side == SIDES[0] else right)[inside] = (stop.fastest_m * 2.0 + 0.01) ** 2
        effect = showing(Symptom.STOPPED)
        selected = Selected(effect, effect.shown(side, stop.t0, stop.t1), ())
        rest_s = stop.t1 - stop.t0
        seen = f"the {side} counter stood still for {rest_s:.2f} s while its wheel travelled {stop.missed_m:.2f} m"
        events.append(Event(selected, ((stop.t0, stop.t1),), stop.nats, seen))
    return events


def _share_a_turn(e: Evidence, a: "_Stop", b: "_Stop") -> bool:
    """Whether both rests are inferred from the same turn between sparse fixes."""
    if e.gyro_rad is not None or float(np.median(np.diff(e.fix_time_s))) < LONGEST_FIX_S:
        return False
    (a0, a1), (b0, b1) = (np.searchsorted(e.fix_time_s, (stop.t0, stop.t1)) for stop in (a, b))
    return bool(a0 <= b1 and b0 <= a1)


def repaired(recording: Recording, e: Evidence, events: Sequence[Event], tread: Tread) -> Recording:
    """Reconstruct stopped wheels from the other one and the gyro, or reference, for a calibration."""
    log, r = recording.encoders, recording.nominal.wheel_radius_m
    travel = [r * np.diff(angle, prepend=0.0) for angle in recording.wheel_angles_rad()]
    for event in events:
        if event.selected.effect.symptom is not Symptom.STOPPED:
            continue
        which = SIDES.index(str(event.selected.values[SIDE.name]))
        sign = -1.0 if which == 0 else 1.0
        for t0, t1 in event.windows:
            inside = (log.time_s > t0 + STANDS_M) & (log.time_s <= t1 + STANDS_M)
            told = _headings(e, np.append(t0, log.time_s[inside]), tread.ratio * e.tread_m, TREAD_SHARE)
            turn = 0.0 if told is None else np.diff(told.heading_rad[1])
            travel[which][inside] = travel[1 - which][inside] + sign * tread.ratio * e.tread_m * turn
    rates = [distance / r / np.diff(log.time_s, prepend=2.0 * log.time_s[0] - log.time_s[1]) for distance in travel]
    nominal = replace(recording.nominal, counts_per_revolution=None)
    return replace(
        recording, nominal=nominal, wheels=EncoderLog(log.time_s, None, None, rates[0], rates[1], log.is_lost)
    )


class _Least(NamedTuple):
    """Tread, m; uncertainty as a share of a turn; least missing share of the other wheel's travel; least time of a
    rest, s; and the uncertainty for turns between sparse fixes, infinite if the tread was not measured.
    """

    tread_m: float
    of_turn: float
    of_way: float
    rest_s: float
    of_other_turns: float


class _Stop(NamedTuple):
    """A rest of a counter while its wheel turned: times (s), travel of the wheel, nats of evidence; the longest row
    (s), and the other wheel's largest travel in a row.
    """

    t0: float
    t1: float
    missed_m: float
    nats: float
    row_s: float
    fastest_m: float


class _Missed(NamedTuple):
    """Largest travel of a wheel while its counter rests, its deviation, the other wheel's travel, time and rows."""

    distance_m: float
    sigma_m: float
    other_m: float
    rest_s: float
    rows: int


def _stop(log: EncoderLog, e: Evidence, sign: float, its: Array, first: int, last: int, least: _Least) -> _Stop | None:
    """Test rows `first` to `last` of a counter at rest, where the other one counts; None: the wheel may really rest.

    Intervals that are only likely stops are joined to a certain one: the counter has not counted in between.
    """
    certain: list[tuple[float, float]] = []  # distance and nats
    spans: list[tuple[float, float]] = []
    for begin, end in ((first + i, first + j) for i, j in runs(its[first:last] != 0.0)):
        edges_s = log.time_s[begin : end + 1]
        missed = _missed(e, sign, its[begin:end], edges_s, least)
        if missed is None:
            continue
        t0, t1 = float(edges_s[0]), float(edges_s[-1])
        if missed.distance_m >= LIKELY_SHARE * missed.other_m:
            spans.append((t0, t1))
        least_m = max(STOP_SIGMAS * missed.sigma_m, least.of_way * missed.other_m)
        if missed.rows >= SHORTEST_STOP_ROWS and missed.rest_s >= least.rest_s and missed.distance_m >= least_m:
            certain.append((missed.distance_m, 0.5 * (missed.distance_m / missed.sigma_m) ** 2))
            spans.append((t0, t1))
    if not certain:
        return None
    missed_m, nats = np.sum(certain, axis=0).tolist()
    row_s, fastest_m = float(np.diff(log.time_s[first : last + 1]).max()), float(np.abs(its[first:last]).max())
    return _Stop(min(t0 for t0, _ in spans), max(t1 for _, t1 in spans), missed_m, nats, row_s, fastest_m)


def _missed(e: Evidence, sign: float, its: Array, edges_s: Array, least: _Least) -> _Missed | None:
    """A wheel's travel from the other one's, `its` (n,), and the heading at the edges (n + 1,); None if unknown."""
    told = _headings(e, edges_s, least.tread_m, least.of_other_turns)
    if told is None:
        return None
    other, headings = cumulative(its), told.heading_rad
    distance = other + sign * least.tread_m * headings[1]
    # A wheel that goes ahead and back may end where it began: use its largest distance.
    a, b = sorted((int(distance.argmin()), int(distance.argmax())))
    early, turn, late = (headings[:, b] - headings[:, a]).tolist()
    other_m = abs(float(other[b] - other[a]))
    gone_m, seconds = abs(float(distance[b] - distance[a])), float(edges_s[b] - edges_s[a])
    # A turn about a wheel at rest does not move it, up to slip and errors of tread, time and heading.
    sigmas = (
        e.datasheet.slip_m_per_sqrt_m * math.sqrt(other_m),
        least.of_turn * least.tread_m * turn,
        least.tread_m * (late - early) / 2.0,
        least.tread_m * math.hypot(told.sigma_rad, told.drift_rad_s * seconds),
        COUNTS * e.datasheet.count_m,
    )
    return _Missed(gone_m, math.hypot(*sigmas), other_m, seconds, b - a)


class _Headings(NamedTuple):
    """Heading at the wheels' times (n,) less DELAY_S, at these, and plus DELAY_S, (3, n); the deviation of its changes,
    and the growth of that in time.
    """

    heading_rad: Array
    sigma_rad: float
    drift_rad_s: float = 0.0


def _headings(e: Evidence, time_s: Array, tread_m: float, of_turn: float) -> _Headings | None:
    """Heading from the gyro, else from the reference, at times (n,) of a counter's rest. None if neither covers them.

    `tread_m`, `of_turn`: tread for the wheels' turns, and its uncertainty as a share of a turn.
    """
    time_s = time_s - e.robot.wheels_lag_s - (e.robot.lag_growth + 1.0 - e.robot.gyro_clock) * time_s
    times_s = time_s + DELAY_S * np.array([[-1.0], [0.0], [1.0]])
    if e.gyro_rad is not None:
        heading = np.interp(times_s, e.edges_s, cumulative(e.gyro_rad))
        return _Headings(heading, 0.0, max(e.datasheet.bias_rad_s, LEAST_BIAS_RAD_S))
    at, sigma = e.fix_time_s, math.sqrt(2.0) * e.datasheet.heading_rad
    first, last = int(np.searchsorted(at, time_s[0], "right")) - 1, int(np.searchsorted(at, time_s[-1]))
    if first < 0 or last >= len(at):
        return None
    if np.diff(at[first : last + 1]).max() < LONGEST_FIX_S:
        return _Headings(np.interp(times_s, at, e.fix[:, 2]), sigma)
    # Between sparse fixes the turn of the rest is the whole turn less the wheels' turns before and after.
    wheels = cumulative(e.apart_m) / tread_m
    edges_s = np.array([at[first], time_s[0], time_s[-1], at[last]])
    before, _, after = np.diff(np.interp(edges_s, e.edges_s, wheels))
    turn = math.remainder(e.fix[last, 2] - e.fix[first, 2] - before - after, math.tau)
    travel_m = float(e.travel_m[(e.time_s > edges_s[0]) & (e.time_s < edges_s[-1])].sum())
    slip_m = math.hypot(e.datasheet.slip_m_per_sqrt_m * math.sqrt(travel_m), RADIUS_SHARE * travel_m)
    early, late = np.interp(edges_s[[0, -1]] + LAG_S * np.array([[-1.0], [1.0]]), e.edges_s, wheels)
    sigma = math.hypot(sigma, slip_m / tread_m, of_turn * (abs(before) + abs(after)), *(0.5 * (late - early)))
    return _Headings(np.interp(times_s, time_s[[0, -1]], [0.0, turn]), sigma)
