"""Smallest error that any estimator can achieve on a recording, and what would lower it most. (61) to (63)"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace

from drd.config.keys import Config
from drd.estimation.state import (
    GYRO_BIAS,
    GYRO_HEADING,
    GYRO_SCALE,
    HEADING,
    SCALE_L,
    SCALE_R,
    SLIP,
    TREAD,
    WHEEL_LAG,
    Matrix,
    N,
    Sigmas,
    X,
    Y,
)
from drd.units import DEG_PER_RAD
from drd_tools.limit import causes
from drd_tools.limit.causes import CAUSES, GROUPS
from drd_tools.limit.drive import Drive, replayed_drive
from drd_tools.limit.known import Known, known_of
from drd_tools.limit.recursion import Case, ErrorModel, Spread, spreads, standing
from drd_tools.recordings.folder import Recording
from drd_tools.replay.nominal import configuration

LONGER_S: Final = 60  # a standstill that an operator would accept
HALF: Final = 0.25  # half the standard deviation, as a weight of the variance
WORTH: Final = 0.02  # a smaller part of the error is not worth a sentence
SHORTEST_M: Final = 0.1  # a shorter path does not count as one
STATES: Final = {
    "wheel scales": (SCALE_R, SCALE_L),
    "tread": (TREAD,),
    "gyro scale": (GYRO_SCALE,),
    "wheel lag": (WHEEL_LAG,),
    "sideways slip": (SLIP,),
    "gyro bias": (GYRO_BIAS,),
}


@dataclass(frozen=True)
class Share:
    """Share of one group of causes in the bound, one standard deviation each; squares sum to the total's.

    The squares of `drift_percent` do not: it is the mean over the segments of the group's own.
    """

    group: str
    position_rms_m: float
    heading_rms_deg: float
    end_m: float
    end_deg: float
    drift_percent: float


@dataclass(frozen=True)
class Change:
    """The bound after one change."""

    what: str
    position_rms_m: float
    heading_rms_deg: float
    drift_percent: float


class Limit(Struct, frozen=True):
    """The bound: one standard deviation of position (both coordinates together) and heading.

    `position_rms_m`, `heading_rms_deg` over time; `end_m`, `end_deg` at the end; `drift_percent` of the path, over the
    segments of KITTI's drift; `by_length_percent` over those of 10, 20 to 80 % of it. `basis` says which noise and
    geometry were assumed true.
    """

    position_rms_m: float
    heading_rms_deg: float
    end_m: float
    end_deg: float
    drift_percent: float
    by_length_percent: list[float]
    distance_m: float = field(name="way_m")  # name in the files
    basis: str
    advice: str
    by_cause: list[Share]
    changes: list[Change]


def limit_of(recording: Recording, config: Config | None = None) -> Limit:
    """The bound on a recording. Raises ConfigError."""
    config = configuration(recording) if config is None else config
    drive = replayed_drive(recording, config)
    return limit_on(drive, known_of(recording, config, drive))


def limit_on(drive: Drive, known: Known) -> Limit:
    """The bound on a drive."""
    model = ErrorModel(drive, known.noise, known.sigmas)
    base = Case(np.ones(len(CAUSES)), start_covariance(known.sigmas))
    altered = dict(_alternatives(model, base, drive))
    whole, shares = spreads(model, drive, [base, *altered.values()], [_share(base, group) for group in GROUPS])
    changes = [
        Change(what, math.sqrt(whole.position_m2[k]), _deg(whole.heading_rad2[k]), 100.0 * float(whole.drift[k]))
        for k, what in enumerate(altered, 1)
    ]
    end_m, end_deg = _end(whole, 0)
    limit = Limit(
        position_rms_m=math.sqrt(whole.position_m2[0]),
        heading_rms_deg=_deg(whole.heading_rad2[0]),
        end_m=end_m,
        end_deg=end_deg,
        drift_percent=100.0 * float(whole.drift[0]),
        by_length_percent=(100.0 * whole.by_length[0]).tolist(),
        distance_m=drive.distance_m,
        basis=known.basis,
        advice="",
        by_cause=[
            share for k, group in enumerate(GROUPS) if (share := _share_row(group, shares, k)).end_deg + share.end_m
        ],
        changes=sorted(changes, key=lambda c: (c.drift_percent, c.heading_rms_deg)),
    )
    return replace(limit, advice=advice(limit))


def start_covariance(s: Sigmas) -> Matrix:
    """Initial P; both headings share their error."""
    P = np.zeros((N, N))
    P[X, X] = P[Y, Y] = s.position_m**2
    P[np.ix_([HEADING, GYRO_HEADING], [HEADING, GYRO_HEADING])] = s.heading_rad**2
    P[SCALE_R, SCALE_R] = P[SCALE_L, SCALE_L] = s.wheel_scale**2
    P[TREAD, TREAD], P[GYRO_SCALE, GYRO_SCALE] = s.tread_m**2, s.gyro_scale**2
    P[GYRO_BIAS, GYRO_BIAS], P[WHEEL_LAG, WHEEL_LAG] = s.gyro_bias_rad_s**2, s.wheel_lag_s**2
    P[SLIP, SLIP] = s.slip_s**2
    return P


def _alternatives(model: ErrorModel, base: Case, drive: Drive) -> Iterator[tuple[str, Case]]:
    """Yield cases with one change each, and its description. (63)"""

    def scaled(*which: int) -> Case:
        weights = base.weights.copy()
        weights[list(which)] = HALF
        return Case(weights, base.P)

    if drive.gyro_hz:
        longer = standing(model, base, drive.gyro_hz, LONGER_S)
        yield f"{LONGER_S} s more standing before the start", Case(base.weights, longer)
        yield "a gyro with half the noise", scaled(causes.GYRO_NOISE)
        yield "a gyro whose bias walks half as much", scaled(causes.BIAS_WALK)
    ground = (causes.SLIP_TRAVEL, causes.SLIP_HEADING, causes.SLIP_POSITION, causes.SLIP_SIDEWAYS, causes.TREAD_WALK)
    yield "wheels that slip half as much", scaled(*ground)
    yield "times of the sensors known twice as well", scaled(causes.TIMING, causes.JITTER)
    yield "encoders with twice the counts", scaled(causes.COUNTS)
    for name, states in STATES.items():
        if name != "gyro bias" and any(base.P[i, i] for i in states):
            P = base.P.copy()
            for i in states:
                P[i], P[:, i] = 0.0, 0.0
            yield f"{name} known exactly", Case(base.weights, P)


def _share(base: Case, group: str) -> Case:
    """Part of the base case due to one group of causes."""
    weights = np.array([w if cause.group == group else 0.0 for w, cause in zip(base.weights, CAUSES, strict=True)])
    states = [X, Y, HEADING, GYRO_HEADING] if group == "start pose" else list(STATES.get(group, ()))
    P = np.zeros((N, N))
    P[np.ix_(states, states)] = base.P[np.ix_(states, states)]
    return Case(weights, P)


def _share_row(group: str, shares: Spread, k: int) -> Share:
    position_m, heading_deg = math.sqrt(max(shares.position_m2[k], 0.0)), _deg(shares.heading_rad2[k])
    return Share(group, position_m, heading_deg, *_end(shares, k), 100.0 * float(shares.drift[k]))


def _end(spread: Spread, k: int) -> tuple[float, float]:
    P = spread.end[k]
    return math.sqrt(max(float(P[0, 0] + P[1, 1]), 0.0)), _deg(P[2, 2])


def _deg(variance_rad2: float) -> float:
    return math.sqrt(max(float(variance_rad2), 0.0)) * DEG_PER_RAD


def advice(limit: Limit) -> str:
    """Sentence on what would lower the bound most."""
    if limit.distance_m < SHORTEST_M:
        return "The path is too short to say what would help."
    best = limit.changes[0]
    gain = 1.0 - best.drift_percent / limit.drift_percent if limit.drift_percent else 0.0
    if gain < WORTH:
        return "No single change would lower it by more than 2 %."
    return (
        f"{best.what[0].upper()}{best.what[1:]} would lower it most: the drift from {limit.drift_percent:.2g} to "
        f"{best.drift_percent:.2g} % of the path ({100.0 * gain:.0f} % less), the position's rms from "
        f"{limit.position_rms_m:.2g} to {best.position_rms_m:.2g} m."
    )
